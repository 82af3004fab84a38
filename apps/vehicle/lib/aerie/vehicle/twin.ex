defmodule Aerie.Vehicle.Twin do
  @moduledoc """
  Notices that two vehicles use one system id. A pure value.

  Two vehicles show as one that jumps to and fro: the moment of its boot (arrival less `time_boot_ms`) or its place takes
  turns between two values. One jump is a reboot, a delayed link or a GPS that woke up; six changes of side within ten
  seconds are two vehicles. A unique id that changes without a reboot is proof at once.
  """

  defstruct boot: nil, place: nil, uid: nil

  @window_us 10_000_000
  @flips 6
  @boot_near_us 5_000_000
  @place_near_m 1_000.0
  @metres_per_degree 111_320.0

  @type t :: %__MODULE__{}
  @type verdict :: :one | :two

  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc "A reading of the vehicle's clock."
  @spec boot(t(), non_neg_integer(), integer()) :: {t(), verdict()}
  def boot(twin, boot_ms, at) do
    {sides, verdict} = side(twin.boot, at - boot_ms * 1000, at, &(abs(&1 - &2) < @boot_near_us))
    {%{twin | boot: sides}, verdict}
  end

  @doc "A position in degrees."
  @spec place(t(), {float(), float()}, integer()) :: {t(), verdict()}
  def place(twin, place, at) do
    {sides, verdict} = side(twin.place, place, at, &near?/2)
    {%{twin | place: sides}, verdict}
  end

  @doc "The autopilot's unique id, nil when it has none."
  @spec uid(t(), String.t() | nil) :: {t(), verdict()}
  def uid(twin, nil), do: {twin, :one}
  def uid(%{uid: nil} = twin, uid), do: {%{twin | uid: uid}, :one}
  def uid(%{uid: uid} = twin, uid), do: {twin, :one}
  def uid(twin, other), do: {%{twin | uid: other}, :two}

  @doc "After a reboot everything may be different, the hardware included."
  @spec rebooted(t()) :: t()
  def rebooted(_twin), do: new()

  @doc "After a change of the gateway's own time, readings before and after cannot be compared."
  @spec rebased(t()) :: t()
  def rebased(twin), do: %__MODULE__{uid: twin.uid}

  # {a, b, the side it is on, when it changed sides}
  defp side(nil, value, _at, _near?), do: {{value, nil, :a, []}, :one}

  defp side({a, b, on, flips}, value, at, near?) do
    {a, b, now_on} =
      cond do
        near?.(a, value) -> {value, b, :a}
        b != nil and near?.(b, value) -> {a, value, :b}
        # A third value: what it is not on just now is forgotten.
        on == :a -> {a, value, :b}
        true -> {value, b, :a}
      end

    flips = if now_on == on, do: flips, else: Enum.take([at | flips], @flips)
    twins = length(flips) == @flips and at - List.last(flips) <= @window_us
    {{a, b, now_on, flips}, if(twins and now_on != on, do: :two, else: :one)}
  end

  defp near?({lat_a, lon_a}, {lat_b, lon_b}) do
    north = (lat_a - lat_b) * @metres_per_degree
    # Across the date line the way is the short one.
    turn = abs(lon_a - lon_b)
    east = min(turn, 360 - turn) * @metres_per_degree * :math.cos(lat_a * 0.017453292519943295)
    north * north + east * east < @place_near_m * @place_near_m
  end
end
