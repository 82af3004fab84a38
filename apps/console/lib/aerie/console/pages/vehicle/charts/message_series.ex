defmodule Aerie.Console.Pages.Vehicle.Charts.MessageSeries do
  @moduledoc """
  Message fields for charts: numbers in the messages that `Aerie.Fleet.Inspector` records while somebody watches. A
  key consists of the message's and the field's name: `ATTITUDE.roll`, `RC_CHANNELS.chan3_raw`, `BATTERY_STATUS.voltages.0`.
  """

  alias Aerie.Base.Names
  alias Aerie.Fleet.Inspector
  alias Aerie.Console.Pages.Vehicle.Charts.Series

  @max_elements 16

  @doc "The sorted names of the messages heard from the vehicle of a snapshot."
  @spec names(Names.gateway(), map()) :: [String.t()]
  def names(gateway, vehicle) do
    # One that no dialect has is a number.
    names = for %{name: name} <- rows(gateway, vehicle), not String.starts_with?(name, "#"), do: name
    names |> Enum.uniq() |> Enum.sort()
  end

  @doc "The series of a message by its name; `[]` for an unknown name."
  @spec of_message(String.t()) :: [Series.t()]
  def of_message(name) do
    for %{type: type} = field <- Inspector.message_fields(name),
        type != :char,
        one <- series(name, field),
        do: one
  end

  @doc "The series of a key from outside, or nil."
  @spec choose(String.t()) :: Series.t() | nil
  def choose(key) do
    [name | _field] = String.split(key, ".")
    Enum.find(of_message(name), &(&1.key == key))
  end

  defp series(name, %{length: nil} = field), do: [one(name, field, nil)]

  defp series(name, %{length: length} = field),
    do: for(i <- 0..(min(length, @max_elements) - 1), do: one(name, field, i))

  defp one(name, field, index) do
    key = Enum.join([name, field.name | List.wrap(index)], ".")

    %{
      key: key,
      label: String.replace(key, ".", " "),
      unit: field.units || "",
      meaning: "as #{name} has it",
      path: {:message, name, field.key, index}
    }
  end

  @doc "The present values by key; null if not heard or too old. Each message is decoded once."
  @spec sample(Names.gateway(), map(), [Series.t()], now :: integer()) :: %{String.t() => number() | nil}
  def sample(_gateway, _vehicle, [], _now), do: %{}

  def sample(gateway, vehicle, series, now) do
    latest = Enum.sort_by(rows(gateway, vehicle), &(&1.at || 0))

    keys = Map.new(latest, &{&1.name, {&1.key, &1.at}})

    messages =
      for name <- series |> Enum.map(&elem(&1.path, 1)) |> Enum.uniq(),
          into: %{},
          do: {name, message(gateway, keys[name], now)}

    Map.new(series, &{&1.key, value(messages, &1.path)})
  end

  # A system id of this gateway's networks says nothing of a vehicle that another one hears.
  defp rows(_gateway, %{via: via}) when via != nil, do: []

  # Several components of a vehicle send the same messages; the charts show the autopilot's.
  defp rows(gateway, vehicle) do
    filter = [system: vehicle.system_id, component: vehicle.component || 1, direction: :in]
    Inspector.rows(gateway, filter)
  end

  defp message(gateway, {key, at}, now) when is_integer(at) do
    with true <- Series.fresh?(at, now),
         {:ok, message} <- Inspector.message(gateway, key),
         do: message,
         else: (_none -> nil)
  end

  defp message(_gateway, _not_heard, _now), do: nil

  defp value(messages, {:message, name, field, index}) do
    with %{} = message <- messages[name],
         number when is_number(number) <- element(Map.get(message, field), index),
         do: number,
         else: (_none -> nil)
  end

  defp element(value, nil), do: value
  defp element(list, index) when is_list(list), do: Enum.at(list, index)
  defp element(bytes, index) when is_binary(bytes) and index < byte_size(bytes), do: :binary.at(bytes, index)
  defp element(_other, _index), do: nil
end
