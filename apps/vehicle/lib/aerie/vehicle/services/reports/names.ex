defmodule Aerie.Vehicle.Services.Reports.Names do
  @moduledoc """
  Names and arguments of EVENT ids, from `priv/px4_events.json` (facts of PX4's own metadata: names, ids, types of arguments,
  values of enums; see the README beside it).

  The upper 8 bits of an id are the namespace (the component that defines it; 0 for common events). In PX4, the lower 24 bits
  are those of the 32-bit FNV-1a hash of the event's name, so a known name is right for every firmware version that has it.
  Arguments are packed little-endian values without names. What a vehicle says about its events in a file of its own wins
  (`own/1`). An event that is in neither file keeps its number and its bytes.
  """

  import Bitwise

  alias Aerie.Vehicle.Services.Reports.Definitions

  @file_name Path.expand("../../../../../priv/px4_events.json", __DIR__)
  @external_resource @file_name

  {:ok, definitions} =
    @file_name |> File.read!() |> JSON.decode!() |> Map.fetch!("components") |> Definitions.build()

  @known definitions

  @typedoc "A number, the label of an enum's value (its number where it has none), or the labels of a bit field."
  @type value :: integer() | float() | String.t() | [String.t()] | nil

  @doc "The definitions of a vehicle's own file that differ from Aerie's or are missing there: they win in `name/2` and `values/3`."
  @spec own(Definitions.t()) :: Definitions.t()
  def own(definitions), do: Definitions.differing(definitions, @known)

  @doc "The name of an event; nil if unknown."
  @spec name(Definitions.t(), non_neg_integer()) :: String.t() | nil
  def name(own \\ Definitions.none(), id) do
    with {{name, _layout}, _enums} <- event(own, id), do: name
  end

  @doc "An event's arguments from its bytes (trailing zeros may be missing); nil if the layout is unknown."
  @spec values(Definitions.t(), non_neg_integer(), binary()) :: [value()] | nil
  def values(own \\ Definitions.none(), id, bytes) do
    with {{_name, layout}, enums} when layout != nil <- event(own, id) do
      read(Enum.map(layout, &Map.get(enums, &1, &1)), bytes)
    else
      _unknown -> nil
    end
  end

  defp event(%{events: events, enums: enums}, id) when is_map_key(events, id), do: {events[id], enums}

  defp event(_own, id) do
    with %{^id => event} <- @known.events, do: {event, @known.enums}, else: (_none -> nil)
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
