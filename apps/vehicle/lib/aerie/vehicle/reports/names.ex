defmodule Aerie.Vehicle.Reports.Names do
  @moduledoc """
  Names and arguments of EVENT ids, from `priv/px4_events.json` (facts of PX4's own metadata: names, ids, types of arguments,
  values of enums; see the README beside it).

  The upper 8 bits of an id are the namespace (the component that defines it; 0 for common events). In PX4, the lower 24 bits
  are those of the 32-bit FNV-1a hash of the event's name, so a known name is right for every firmware version that has it.
  Arguments are packed little-endian values without names. An event that is not in the file keeps its number and its bytes.
  """

  import Bitwise

  @file_name Path.expand("../../../../priv/px4_events.json", __DIR__)
  @external_resource @file_name

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

  components = @file_name |> File.read!() |> JSON.decode!() |> Map.fetch!("components")

  # Types are written with and without their namespace.
  enums =
    for {_space, component} <- components,
        {name, enum} <- component["enums"],
        key <- [name, component["namespace"] <> "::" <> name],
        into: %{} do
      {:unsigned, bits} = Map.fetch!(@sizes, enum["type"])
      values = Map.new(enum["values"], fn {value, label} -> {String.to_integer(value), label} end)
      {key, {if(enum["bitfield"], do: :flags, else: :enum), bits, values}}
    end

  type = fn name -> if is_map_key(@sizes, name), do: @sizes[name], else: Map.fetch!(enums, name) end

  events =
    for {space, component} <- components, {id, event} <- component["events"], into: %{} do
      layout = if event["arguments"], do: Enum.map(event["arguments"], type)
      {(String.to_integer(space) <<< 24) + String.to_integer(id), {event["name"], layout}}
    end

  @names Map.new(events, fn {id, {name, _layout}} -> {id, name} end)
  @layouts for {id, {_name, layout}} <- events, layout not in [nil, []], into: %{}, do: {id, layout}
  @empty for({id, {_name, []}} <- events, do: id) |> MapSet.new()

  @typedoc "A number, the label of an enum's value (its number where it has none), or the labels of a bit field."
  @type value :: integer() | float() | String.t() | [String.t()] | nil

  @doc "The name of an event; nil if unknown."
  @spec name(non_neg_integer()) :: String.t() | nil
  def name(id), do: Map.get(@names, id)

  @doc "An event's arguments from its bytes (trailing zeros may be missing); nil if the layout is unknown."
  @spec values(non_neg_integer(), binary()) :: [value()] | nil
  def values(id, bytes) do
    case @layouts do
      %{^id => layout} -> read(layout, bytes)
      _none -> if id in @empty, do: []
    end
  end

  defp read([], _bytes), do: []

  defp read([type | layout], bytes) do
    size = type |> elem(1) |> div(8)
    missing = max(size - byte_size(bytes), 0)
    <<value::binary-size(^size), rest::binary>> = bytes <> <<0::size(missing)-unit(8)>>
    [value(type, value) | read(layout, rest)]
  end

  defp value({:unsigned, bits}, bytes) do
    <<number::little-size(^bits)>> = bytes
    number
  end

  defp value({:signed, bits}, bytes) do
    <<number::little-signed-size(^bits)>> = bytes
    number
  end

  defp value({:float, 32}, <<number::little-float-32>>), do: number
  # NaN and the infinities.
  defp value({:float, 32}, _bytes), do: nil

  defp value({:enum, bits, labels}, bytes) do
    number = value({:unsigned, bits}, bytes)
    Map.get(labels, number, number)
  end

  defp value({:flags, bits, labels}, bytes) do
    number = value({:unsigned, bits}, bytes)

    if number == (1 <<< bits) - 1,
      do: ["all"],
      else:
        for(bit <- 0..(bits - 1), (number >>> bit &&& 1) == 1, do: Map.get(labels, 1 <<< bit, "bit #{bit}"))
  end
end
