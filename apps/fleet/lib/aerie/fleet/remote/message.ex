defmodule Aerie.Fleet.Remote.Message do
  @moduledoc """
  A message of another gateway about a vehicle's state (`Aerie.Fleet.Bridge.Message`), checked: it came from outside. Pure.

  Only groups and fields of `Aerie.Vehicle.State.Fields` are taken, and of those only values of the kind that the field has. The group
  `gateway` is what a gateway says of the vehicle: who it is, and whether it is heard.
  """

  alias Aerie.Base.Json.Object
  alias Aerie.Fleet.Bridge
  alias Aerie.Vehicle.{Firmware, Snapshot}
  alias Aerie.Vehicle.State.Fields

  @max_text 256
  @max_list 64
  @fields Map.new(Fields.all(), fn {group, _title, fields} ->
            names =
              for %{path: path, decimals: decimals} <- fields,
                  do:
                    {Atom.to_string(List.last(path)),
                     {List.last(path), decimals != nil and length(path) == 1}}

            {Atom.to_string(group), {group, Map.new(names)}}
          end)
  # Fields of a nested object have a name of their own; the object itself is not a number.
  @statuses %{"online" => :online, "stale" => :stale, "lost" => :lost}

  @typedoc "`time` is the sender's, in unix microseconds."
  @type t :: %{
          vehicle: String.t(),
          gateway: String.t() | nil,
          epoch: integer() | nil,
          time: integer(),
          time_boot_ms: integer() | nil,
          content: {:facts, Snapshot.t()} | {:group, atom(), map()}
        }

  @doc "Vehicle and group of a subject; `:error` for what no vehicle's state has."
  @spec subject(String.t()) :: {:ok, vehicle :: String.t(), group :: String.t()} | :error
  def subject(subject) do
    with ["fleet", _environment, vehicle, "state", group] <- String.split(subject, "."),
         true <- name?(vehicle) and (group == "gateway" or is_map_key(@fields, group)) do
      {:ok, vehicle, group}
    else
      _other -> :error
    end
  end

  @doc "Reads a body; `:error` for what no gateway publishes."
  @spec parse(vehicle :: String.t(), group :: String.t(), body :: binary()) :: {:ok, t()} | :error
  def parse(vehicle, group, body) do
    with true <- byte_size(body) <= Bridge.Message.max_state_bytes(),
         {:ok, %{"vehicle" => ^vehicle, "group" => ^group, "data" => %{} = data, "time" => time} = object} <-
           JSON.decode(body),
         {:ok, time} <- time(time) do
      {:ok,
       %{
         vehicle: vehicle,
         gateway: if(name?(object["gateway"]), do: object["gateway"]),
         epoch: if(is_integer(object["epoch"]), do: object["epoch"]),
         time: time,
         time_boot_ms: if(is_integer(object["time_boot_ms"]), do: object["time_boot_ms"]),
         content: content(group, data, time)
       }}
    else
      _other -> :error
    end
  end

  @shown Enum.filter(
           Snapshot.fields(:whole),
           &(&1.name in [:network, :system_id, :autopilot, :type, :firmware, :status])
         )
  @silent Object.fields([{:silent_s, :number, "s", "how long the vehicle was not heard"}])

  @doc "What a gateway says of a vehicle."
  @spec fields() :: [Object.t()]
  def fields, do: @shown ++ @silent

  @doc "The facts about a vehicle's snapshot, as `parse/3` reads them, at `now` (unix microseconds)."
  @spec facts(Snapshot.t(), now :: integer()) :: map()
  def facts(snapshot, now) do
    silent = if snapshot.last_heard, do: max(now - snapshot.last_heard, 0) / 1_000_000
    @shown |> Object.show(snapshot) |> Map.put(:silent_s, silent)
  end

  defp content("gateway", data, time) do
    {:facts,
     %Snapshot{
       network: text(data["network"]),
       system_id:
         if(is_integer(data["system_id"]) and data["system_id"] in 0..0xFFFFFFFF, do: data["system_id"]),
       autopilot: Map.get(Firmware.by_text(), data["autopilot"], :generic),
       vehicle_type: text(data["type"]),
       firmware: text(data["firmware"]),
       status: Map.get(@statuses, data["status"], :online),
       last_heard: if(is_number(data["silent_s"]), do: time - round(data["silent_s"] * 1_000_000))
     }}
  end

  defp content(group, data, _time) do
    {name, fields} = Map.fetch!(@fields, group)
    {:group, name, object(data, fields)}
  end

  defp object(data, fields) do
    for {key, value} <- data,
        {:ok, {name, number?}} <- [Map.fetch(fields, key)],
        {:ok, value} <- [value(value, number?, fields)],
        into: %{},
        do: {name, value}
  end

  defp value(nil, _number?, _fields), do: {:ok, nil}
  defp value(number, true, _fields) when is_number(number), do: {:ok, number}
  defp value(flag, false, _fields) when is_boolean(flag), do: {:ok, flag}

  defp value(text, false, _fields) when is_binary(text) and byte_size(text) <= @max_text, do: {:ok, text}

  defp value(list, number?, fields) when is_list(list) and length(list) <= @max_list do
    items = Enum.map(list, &item(&1, number?, fields))
    if :error in items, do: :error, else: {:ok, for({:ok, item} <- items, do: item)}
  end

  defp value(%{} = object, _number?, fields), do: {:ok, flat(object, fields)}
  defp value(_other, _number?, _fields), do: :error

  defp item(%{} = object, _number?, fields), do: {:ok, flat(object, fields)}
  defp item(number, _number?, _fields) when is_number(number), do: {:ok, number}
  defp item(list, _number?, _fields) when is_list(list), do: :error
  defp item(scalar, _number?, fields), do: value(scalar, false, fields)

  # An object in an object is the deepest that there is.
  defp flat(object, fields) do
    for {key, value} <- object,
        {:ok, {name, _number?}} <- [Map.fetch(fields, key)],
        is_nil(value) or is_number(value) or is_boolean(value) or
          (is_binary(value) and byte_size(value) <= @max_text),
        into: %{},
        do: {name, value}
  end

  defp name?(text), do: is_binary(text) and text =~ ~r/\A[A-Za-z0-9_-]{1,64}\z/

  defp text(text), do: if(is_binary(text) and byte_size(text) <= @max_text, do: text)

  defp time(text) when is_binary(text) do
    with {:ok, time, _offset} <- DateTime.from_iso8601(text), do: {:ok, DateTime.to_unix(time, :microsecond)}
  end

  defp time(_other), do: :error
end
