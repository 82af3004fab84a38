defmodule Aerie.Vehicle.Collision.Detector do
  @moduledoc """
  Notices that two vehicles use one system id. A pure value.

  Seen as one, two vehicles jump to and fro: the boot time (arrival less `time_boot_ms`), the position or the type
  alternates between two values. A single jump is a reboot, a delayed link or a GPS that woke up; six changes within ten
  seconds are two vehicles. A unique id that changes without a reboot is proof at once.

  Each reading comes with its path (`t:Aerie.Vehicle.Collision.Owner.path/0`). `paths/2` says which paths brought which
  value: it tells an operator where to look, and the router that these paths do not carry the same vehicle.

  Boot times are compared within one kind of message (`MavCodec.Message.BootClock` says why), and only jumps to and fro
  count: a clock that does not count milliseconds drifts in one direction. A second link with a delay of up to half a
  minute shows the same boot time earlier, and on its own paths. So boot times that are close and come by separate paths
  are taken for a delay, unless the positions are too far apart for one vehicle (`Aerie.Vehicle.Session.Core.Frames`).
  """

  alias Aerie.Vehicle.Collision.Owner
  alias MavCodec.Message.BootClock

  defstruct boot_times: %{}, position: nil, type: nil, uid: nil

  @window_us 10_000_000
  @flips 6
  @same_boot_us 5_000_000
  @delay_us 30_000_000
  @same_place_m 1_000.0
  @metres_per_degree 111_320.0
  @max_paths 8
  @max_clocks 16

  @type t :: %__MODULE__{}
  @type verdict :: :one | :two
  @typedoc "By which reading two vehicles were noticed. `id` is the message that carried the clock."
  @type sign :: {:boot_time, id :: non_neg_integer()} | :position | :type | :uid

  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc "A reading of the vehicle's clock, by the id of the message that carried it."
  @spec boot_time(t(), id :: non_neg_integer(), non_neg_integer(), integer(), Owner.path()) ::
          {t(), verdict()}
  def boot_time(detector, id, boot_ms, at, path \\ nil)

  def boot_time(%{boot_times: times} = detector, id, boot_ms, at, path)
      when is_map_key(times, id) or map_size(times) < @max_clocks do
    near? = &(BootClock.apart(&1, &2) < @same_boot_us)
    {side, verdict} = side(times[id], at - boot_ms * 1000, at, path, near?, &(&2 > &1))
    detector = %{detector | boot_times: Map.put(times, id, side)}
    {detector, if(verdict == :two and delay?(side), do: :one, else: verdict)}
  end

  def boot_time(detector, _id, _boot_ms, _at, _path), do: {detector, :one}

  defp delay?(%{a: a, b: b, paths: {of_a, of_b}}) do
    abs(a - b) < @delay_us and of_a != of_b and not Enum.any?(of_a, &(&1 in of_b))
  end

  @doc "A position in degrees."
  @spec position(t(), {float(), float()}, integer(), Owner.path()) :: {t(), verdict()}
  def position(detector, position, at, path \\ nil) do
    {side, verdict} = side(detector.position, position, at, path, &near?/2)
    {%{detector | position: side}, verdict}
  end

  @doc "MAV_TYPE and MAV_AUTOPILOT of a heartbeat."
  @spec type(t(), {integer(), integer()}, integer(), Owner.path()) :: {t(), verdict()}
  def type(detector, type, at, path \\ nil) do
    {side, verdict} = side(detector.type, type, at, path, &==/2)
    {%{detector | type: side}, verdict}
  end

  @doc "The autopilot's unique id; nil if it has none."
  @spec uid(t(), String.t() | nil, Owner.path()) :: {t(), verdict()}
  def uid(detector, uid, path \\ nil)
  def uid(detector, nil, _path), do: {detector, :one}
  def uid(%{uid: nil} = detector, uid, path), do: {%{detector | uid: {uid, [path], []}}, :one}

  def uid(%{uid: {uid, paths, others}} = detector, uid, path),
    do: {%{detector | uid: {uid, with_path(paths, path), others}}, :one}

  def uid(%{uid: {_other, paths, _others}} = detector, uid, path),
    do: {%{detector | uid: {uid, [path], paths}}, :two}

  @doc "When a reading last changed sides, changes by a delayed link excluded; nil for never."
  @spec last_flip(t()) :: integer() | nil
  def last_flip(detector) do
    boot_times = for {_id, %{b: b} = side} <- detector.boot_times, b != nil, not delay?(side), do: side

    [detector.position, detector.type | boot_times]
    |> Enum.flat_map(fn side -> Enum.take((side && side.flips) || [], 1) end)
    |> Enum.max(fn -> nil end)
  end

  @doc "The paths that brought the one and the other value of a sign; empty lists while there is only one value."
  @spec paths(t(), sign()) :: {[Owner.path()], [Owner.path()]}
  def paths(%{uid: {_uid, paths, others}}, :uid), do: {Enum.sort(paths), Enum.sort(others)}

  def paths(detector, {:boot_time, id}), do: sorted(detector.boot_times[id])
  def paths(detector, sign), do: sorted(Map.fetch!(detector, sign))

  defp sorted(%{paths: {of_a, of_b}}), do: {Enum.sort(of_a), Enum.sort(of_b)}
  defp sorted(nil), do: {[], []}

  @doc "After a change of the gateway's clock, earlier and later readings cannot be compared."
  @spec rebased(t()) :: t()
  def rebased(detector), do: %__MODULE__{uid: detector.uid}

  # Two values `a` and `b`, which of them was last (`on`), when that changed, and the paths that brought each. If values
  # have an order, a second change in the same direction is not a change to and fro.
  defp side(side, value, at, path, near?, up? \\ fn _, _ -> nil end)

  defp side(nil, value, _at, path, _near?, _up?),
    do: {%{a: value, b: nil, on: :a, up: nil, flips: [], paths: {[path], []}}, :one}

  defp side(%{a: a, b: b, on: on, paths: {of_a, of_b}} = side, value, at, path, near?, up?) do
    last = Map.fetch!(side, on)

    side =
      cond do
        near?.(a, value) -> %{side | a: value, on: :a, paths: {with_path(of_a, path), of_b}}
        b != nil and near?.(b, value) -> %{side | b: value, on: :b, paths: {of_a, with_path(of_b, path)}}
        # A third value replaces the one that was not seen last.
        on == :a -> %{side | b: value, on: :b, paths: {of_a, [path]}}
        true -> %{side | a: value, on: :a, paths: {[path], of_b}}
      end

    if side.on == on, do: {side, :one}, else: flip(side, up?.(last, value), at)
  end

  defp flip(%{up: up} = side, up, _at) when up != nil, do: {side, :one}

  defp flip(side, up, at) do
    flips = Enum.take([at | side.flips], @flips)
    two? = length(flips) == @flips and at - List.last(flips) <= @window_us
    {%{side | flips: flips, up: up}, if(two?, do: :two, else: :one)}
  end

  defp with_path([path | _] = paths, path), do: paths

  defp with_path(paths, path),
    do: if(path in paths, do: paths, else: Enum.take([path | paths], @max_paths))

  defp near?(one, other), do: distance_m(one, other) < @same_place_m

  @doc "The distance of two positions (degrees) in metres."
  @spec distance_m({float(), float()}, {float(), float()}) :: float()
  def distance_m({lat_a, lon_a}, {lat_b, lon_b}) do
    north = (lat_a - lat_b) * @metres_per_degree
    # Across the date line, the shorter of the two distances counts.
    turn = abs(lon_a - lon_b)
    east = min(turn, 360 - turn) * @metres_per_degree * :math.cos(lat_a * 0.017453292519943295)
    :math.sqrt(north * north + east * east)
  end
end
