defmodule Aerie.Vehicle.Services.Reports.Definitions do
  @moduledoc """
  What EVENT ids mean: names, types of the arguments, labels of enums. Read from the file that a vehicle serves
  (MAVLink's component metadata, COMP_METADATA_TYPE_EVENTS), or built from Aerie's own
  (`Aerie.Vehicle.Services.Reports.Names`). Pure.

  The texts of the file are left out. Everything has a bound; an event that cannot be read is left out, and one with
  an argument of an unknown type, or with more arguments than a message has room for, keeps its bytes.
  """

  import Bitwise

  @max_components 256
  @max_events 2_000
  @max_enum_values 4_000
  @max_name 100
  # EVENT has 40 bytes for them.
  @max_bits 320
  @versions [1, 2]

  @sizes %{
    "int8_t" => {:signed, 8},
    "uint8_t" => {:unsigned, 8},
    "int16_t" => {:signed, 16},
    "uint16_t" => {:unsigned, 16},
    "int32_t" => {:signed, 32},
    "uint32_t" => {:unsigned, 32},
    "int64_t" => {:signed, 64},
    "uint64_t" => {:unsigned, 64},
    "float" => {:float, 32}
  }

  @typedoc "A type of an argument, or the name of an enum with its namespace."
  @type type :: {:signed | :unsigned | :float, pos_integer()} | String.t()
  @type enum :: {:enum | :flags, bits :: pos_integer(), labels :: %{non_neg_integer() => String.t()}}

  @typedoc "`events`: id => its name and the types of its arguments, nil if they are unknown."
  @type t :: %{
          events: %{non_neg_integer() => {String.t(), [type()] | nil}},
          enums: %{String.t() => enum()}
        }

  @doc "Nothing is known."
  @spec none() :: t()
  def none, do: %{events: %{}, enums: %{}}

  @doc "Reads the file that a vehicle serves."
  @spec decode(binary()) :: {:ok, t()} | {:error, String.t()}
  def decode(text) do
    case JSON.decode(text) do
      {:ok, %{"version" => version, "components" => components}}
      when version in @versions and is_map(components) and map_size(components) <= @max_components ->
        components |> Map.new(fn {space, component} -> {space, plain(component)} end) |> build()

      {:ok, %{"version" => version, "components" => %{}}} when version not in @versions ->
        {:error,
         "the events' metadata has version #{inspect(version, limit: 5, printable_limit: 20)}, not 1 or 2"}

      _other ->
        {:error, "the events' metadata is not as MAVLink has it"}
    end
  end

  # As Aerie's own file has it.
  defp plain(component) do
    groups = component |> map("event_groups") |> Map.values()

    %{
      "namespace" => is_map(component) && component["namespace"],
      "enums" => component |> map("enums") |> Map.new(fn {name, enum} -> {name, plain_enum(enum)} end),
      "events" =>
        for(group <- groups, {id, event} <- map(group, "events"), into: %{}, do: {id, plain_event(event)})
    }
  end

  defp plain_enum(%{"type" => type} = enum) do
    labels = for {value, %{"name" => label}} <- map(enum, "entries"), do: {value, label}
    %{"type" => type, "bitfield" => enum["is_bitfield"] == true, "values" => labels}
  end

  defp plain_enum(_other), do: %{}

  defp plain_event(%{"arguments" => arguments} = event) when is_list(arguments),
    do: %{event | "arguments" => Enum.map(arguments, &(is_map(&1) && &1["type"]))}

  defp plain_event(%{} = event), do: Map.put(event, "arguments", [])
  defp plain_event(_other), do: %{}

  @doc """
  Builds it from components as Aerie's own file has them: namespace, `enums` (type, bitfield, values) and `events`
  (name, types of arguments). Too much of it is an error.
  """
  @spec build(%{String.t() => map()}) :: {:ok, t()} | {:error, String.t()}
  def build(components) do
    enums =
      for {_space, component} <- components,
          {name, enum} <- component["enums"],
          name?(name),
          {:ok, read} <- [enum(enum)],
          into: %{},
          do: {full(component["namespace"], name), read}

    events =
      for {space, component} <- components,
          {:ok, space} <- [number(space, 0xFF)],
          {id, event} <- component["events"],
          {:ok, id} <- [number(id, 0xFFFFFF)],
          name?(event["name"]),
          into: %{},
          do:
            {(space <<< 24) + id,
             {own(event["name"]), layout(event["arguments"], component["namespace"], enums)}}

    values = enums |> Enum.map(fn {_name, {_kind, _bits, labels}} -> map_size(labels) end) |> Enum.sum()

    cond do
      map_size(events) > @max_events ->
        {:error, "the metadata describes #{map_size(events)} events, more than #{@max_events}"}

      values > @max_enum_values ->
        {:error, "the events' enums have #{values} values, more than #{@max_enum_values}"}

      true ->
        {:ok, %{events: events, enums: enums}}
    end
  end

  @doc "The definitions of the first that differ from the second or are missing there."
  @spec differing(t(), t()) :: t()
  def differing(definitions, known) do
    events =
      Map.reject(definitions.events, fn {id, event} ->
        resolved(event, definitions) == resolved(known.events[id], known)
      end)

    used = for {_id, {_name, layout}} <- events, type <- layout || [], is_binary(type), uniq: true, do: type
    %{events: events, enums: Map.take(definitions.enums, used)}
  end

  defp resolved({name, layout}, definitions) when is_list(layout),
    do: {name, Enum.map(layout, &Map.get(definitions.enums, &1, &1))}

  defp resolved(event, _definitions), do: event

  defp enum(%{"type" => type, "values" => values} = enum) do
    case @sizes do
      %{^type => {:unsigned, bits}} ->
        labels =
          for {value, label} <- values,
              {:ok, value} <- [number(value, (1 <<< bits) - 1)],
              name?(label),
              into: %{} do
            {value, own(label)}
          end

        {:ok, {if(enum["bitfield"], do: :flags, else: :enum), bits, labels}}

      _other ->
        :error
    end
  end

  defp enum(_other), do: :error

  defp layout(types, space, enums) when is_list(types) do
    layout = Enum.map(types, &type(&1, space, enums))
    if nil in layout or Enum.sum_by(layout, &bits(&1, enums)) > @max_bits, do: nil, else: layout
  end

  defp layout(_unknown, _space, _enums), do: nil

  # Types are written with and without their namespace.
  defp type(name, _space, _enums) when is_map_key(@sizes, name), do: @sizes[name]

  defp type(name, space, enums) when is_binary(name),
    do: Enum.find([own(name), full(space, name), "common::" <> name], &is_map_key(enums, &1))

  defp type(_other, _space, _enums), do: nil

  defp bits({_kind, bits}, _enums), do: bits
  defp bits(enum, enums), do: elem(enums[enum], 1)

  defp full(space, name) when is_binary(space), do: space <> "::" <> name
  defp full(_none, name), do: own(name)

  defp number(text, max) do
    case Integer.parse(text) do
      {number, ""} when number in 0..max//1 -> {:ok, number}
      _other -> :error
    end
  end

  defp name?(name), do: is_binary(name) and byte_size(name) in 1..@max_name
  # A part of the file's text would keep all of it in memory.
  defp own(text), do: :binary.copy(text)

  defp map(%{} = map, key), do: with(%{} = value <- map[key], do: value, else: (_other -> %{}))
  defp map(_other, _key), do: %{}
end
