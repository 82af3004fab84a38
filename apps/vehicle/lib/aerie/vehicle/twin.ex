defmodule Aerie.Vehicle.Twin do
  @moduledoc """
  Notices that two vehicles use one system id. A pure value.

  Two vehicles show as one that jumps to and fro: the moment of its boot (arrival less `time_boot_ms`), its place or its
  kind takes turns between two values. One jump is a reboot, a delayed link or a GPS that woke up; six changes of side
  within ten seconds are two vehicles. A unique id that changes without a reboot is proof at once.

  Each reading comes with its link. Which links brought which value (`links/2`) tells an operator where to look, and a
  router that such links do not carry the same vehicle twice. The moment of the boot is compared within one kind of message
  (`Aerie.Mavlink.BootClock` says why), and only jumps to and fro count: a clock that counts something else than
  milliseconds runs away in one direction. A second link that is late by half a minute or less shows the
  same boot earlier and by itself: links apart and moments near is a delay, no twin, unless its places are where the vehicle
  cannot have been (`Aerie.Vehicle.Core.Intake`).
  """

  defstruct boot: %{}, place: nil, kind: nil, uid: nil

  @window_us 10_000_000
  @flips 6
  @boot_near_us 5_000_000
  @delay_us 30_000_000
  @place_near_m 1_000.0
  @metres_per_degree 111_320.0
  @max_links 8
  @max_clocks 16

  @type t :: %__MODULE__{}
  @type verdict :: :one | :two
  @type sign :: {:boot, id :: non_neg_integer()} | :place | :kind | :uid

  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc "A reading of the vehicle's clock by a kind of message (its id)."
  @spec boot(t(), id :: non_neg_integer(), non_neg_integer(), integer(), link :: term()) :: {t(), verdict()}
  def boot(twin, id, boot_ms, at, link \\ nil)

  def boot(%{boot: boot} = twin, id, boot_ms, at, link)
      when is_map_key(boot, id) or map_size(boot) < @max_clocks do
    {side, verdict} =
      side(boot[id], at - boot_ms * 1000, at, link, &(abs(&1 - &2) < @boot_near_us), &(&2 > &1))

    {%{twin | boot: Map.put(boot, id, side)}, if(verdict == :two and delay?(side), do: :one, else: verdict)}
  end

  def boot(twin, _id, _boot_ms, _at, _link), do: {twin, :one}

  defp delay?(%{a: a, b: b, links: {of_a, of_b}}) do
    abs(a - b) < @delay_us and of_a != of_b and not Enum.any?(of_a, &(&1 in of_b))
  end

  @doc "A position in degrees."
  @spec place(t(), {float(), float()}, integer(), link :: term()) :: {t(), verdict()}
  def place(twin, place, at, link \\ nil) do
    {side, verdict} = side(twin.place, place, at, link, &near?/2)
    {%{twin | place: side}, verdict}
  end

  @doc "What its heartbeat says that it is: MAV_TYPE and MAV_AUTOPILOT."
  @spec kind(t(), {integer(), integer()}, integer(), link :: term()) :: {t(), verdict()}
  def kind(twin, kind, at, link \\ nil) do
    {side, verdict} = side(twin.kind, kind, at, link, &==/2)
    {%{twin | kind: side}, verdict}
  end

  @doc "The autopilot's unique id, nil when it has none."
  @spec uid(t(), String.t() | nil, link :: term()) :: {t(), verdict()}
  def uid(twin, uid, link \\ nil)
  def uid(twin, nil, _link), do: {twin, :one}
  def uid(%{uid: nil} = twin, uid, link), do: {%{twin | uid: {uid, [link], []}}, :one}

  def uid(%{uid: {uid, links, others}} = twin, uid, link),
    do: {%{twin | uid: {uid, with_link(links, link), others}}, :one}

  def uid(%{uid: {_other, links, _others}} = twin, uid, link), do: {%{twin | uid: {uid, [link], links}}, :two}

  @doc "When a value last took turns, but for those of a link that is late; nil for never."
  @spec flipped_at(t()) :: integer() | nil
  def flipped_at(twin) do
    boots = for {_id, %{b: b} = side} <- twin.boot, b != nil, not delay?(side), do: side

    [twin.place, twin.kind | boots]
    |> Enum.flat_map(fn side -> Enum.take((side && side.flips) || [], 1) end)
    |> Enum.max(fn -> nil end)
  end

  @doc "By which links the one and the other value of a sign came; empty lists while there is one value only."
  @spec links(t(), sign()) :: {[term()], [term()]}
  def links(%{uid: {_uid, links, others}}, :uid), do: {Enum.sort(links), Enum.sort(others)}

  def links(twin, {:boot, id}), do: sorted(twin.boot[id])
  def links(twin, sign), do: sorted(Map.fetch!(twin, sign))

  defp sorted(%{links: {of_a, of_b}}), do: {Enum.sort(of_a), Enum.sort(of_b)}
  defp sorted(_nothing), do: {[], []}

  @doc "After a reboot everything may be different, the hardware included."
  @spec rebooted(t()) :: t()
  def rebooted(_twin), do: new()

  @doc "After a change of the gateway's own time, readings before and after cannot be compared."
  @spec rebased(t()) :: t()
  def rebased(twin), do: %__MODULE__{uid: twin.uid}

  # Two values, which of them was last, when that changed, and by which links each came. With an order of values, a change
  # in the direction of the one before is none to and fro.
  defp side(side, value, at, link, near?, up? \\ fn _, _ -> nil end)

  defp side(nil, value, _at, link, _near?, _up?),
    do: {%{a: value, b: nil, on: :a, up: nil, flips: [], links: {[link], []}}, :one}

  defp side(%{a: a, b: b, on: on, links: {of_a, of_b}} = side, value, at, link, near?, up?) do
    last = Map.fetch!(side, on)

    side =
      cond do
        near?.(a, value) -> %{side | a: value, on: :a, links: {with_link(of_a, link), of_b}}
        b != nil and near?.(b, value) -> %{side | b: value, on: :b, links: {of_a, with_link(of_b, link)}}
        # A third value: what it is not on just now is forgotten.
        on == :a -> %{side | b: value, on: :b, links: {of_a, [link]}}
        true -> %{side | a: value, on: :a, links: {[link], of_b}}
      end

    if side.on == on, do: {side, :one}, else: flip(side, up?.(last, value), at)
  end

  defp flip(%{up: up} = side, up, _at) when up != nil, do: {side, :one}

  defp flip(side, up, at) do
    flips = Enum.take([at | side.flips], @flips)
    twins = length(flips) == @flips and at - List.last(flips) <= @window_us
    {%{side | flips: flips, up: up}, if(twins, do: :two, else: :one)}
  end

  defp with_link([link | _] = links, link), do: links

  defp with_link(links, link),
    do: if(link in links, do: links, else: Enum.take([link | links], @max_links))

  defp near?(one, other), do: distance_m(one, other) < @place_near_m

  @doc "How far two places (degrees) are from each other, in metres."
  @spec distance_m({float(), float()}, {float(), float()}) :: float()
  def distance_m({lat_a, lon_a}, {lat_b, lon_b}) do
    north = (lat_a - lat_b) * @metres_per_degree
    # Across the date line the way is the short one.
    turn = abs(lon_a - lon_b)
    east = min(turn, 360 - turn) * @metres_per_degree * :math.cos(lat_a * 0.017453292519943295)
    :math.sqrt(north * north + east * east)
  end
end
