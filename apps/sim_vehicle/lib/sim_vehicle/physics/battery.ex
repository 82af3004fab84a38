defmodule SimVehicle.Physics.Battery do
  @moduledoc """
  A lithium-polymer pack: the charge drains with the load; the voltage falls with the charge and sags with the current.
  """

  @hover_a 28.0
  @idle_a 3.0
  @off_a 0.4
  @resistance_per_cell 0.004

  defstruct capacity_mah: 3300.0, cells: 3, used_mah: 0.0, current_a: 0.0

  @typedoc "Charge in mAh, current in A."
  @type t :: %__MODULE__{}

  @doc "A full pack."
  @spec new(keyword) :: t
  def new(opts), do: struct!(__MODULE__, opts)

  @doc "Drains for `dt` seconds; the load follows from `armed` and the throttle (0..1, 0.36 = hover)."
  @spec step(t, boolean, float, float) :: t
  def step(battery, armed, throttle, dt) do
    current = load(armed, throttle)
    used = min(battery.used_mah + current * dt / 3.6, battery.capacity_mah)
    %{battery | current_a: current, used_mah: used}
  end

  @doc "Charge left, 0.0..1.0."
  @spec remaining(t) :: float
  def remaining(battery), do: 1.0 - battery.used_mah / battery.capacity_mah

  @doc "Charge left in whole percent."
  @spec percent(t) :: 0..100
  def percent(battery), do: round(remaining(battery) * 100)

  @doc "Voltage at the terminals under the present load, V."
  @spec voltage(t) :: float
  def voltage(battery) do
    left = remaining(battery)
    cell = 3.4 + 0.7 * left + 0.1 * :math.sqrt(left) - @resistance_per_cell * battery.current_a
    battery.cells * max(cell, 0.0)
  end

  @doc """
  The same pack with `left` of its charge: a swap (1.0) or a failure on demand. It is kept within 0.0..1.0, because a
  threshold that `left` comes from may be set to anything.
  """
  @spec set_remaining(t, float) :: t
  def set_remaining(battery, left),
    do: %{battery | used_mah: (1.0 - (left |> max(0.0) |> min(1.0))) * battery.capacity_mah}

  defp load(false, _throttle), do: @off_a
  defp load(true, throttle) when throttle <= 0.1, do: @idle_a
  defp load(true, throttle), do: @hover_a * :math.pow(throttle / 0.36, 1.5)
end
