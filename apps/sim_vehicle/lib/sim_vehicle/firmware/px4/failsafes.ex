defmodule SimVehicle.Firmware.Px4.Failsafes do
  @moduledoc """
  PX4's failsafes. Most hold for five seconds first (`COM_FAIL_ACT_T`), so that a pilot can take over, and then return.
  """

  alias SimVehicle.{Params, Vehicle}
  alias SimVehicle.Physics.Battery
  alias SimVehicle.Firmware.Px4.{Events, Modes}

  @hold_us 5_000_000
  # Causes and actions as numbered in commander_failsafe_enter.
  @generic 0
  @emergency 5
  @causes %{rc: 1, gcs: 2, battery_critical: 4}
  @action_hold 5
  @action_rtl 6
  @action_land 7

  @doc "A failsafe begins or ends."
  @spec set(Vehicle.t(), atom, boolean) :: Vehicle.t()
  def set(v, kind, on?) do
    case Vehicle.put_failsafe(v, kind, on?) do
      :unchanged -> v
      v when on? -> begin(v, kind)
      v -> over(v, kind)
    end
  end

  @doc "The ground station is back."
  @spec gcs_heard(Vehicle.t()) :: Vehicle.t()
  def gcs_heard(v), do: set(v, :gcs, false)

  @doc "Checks charge, offboard setpoints, and whether a hold is over."
  @spec tick(Vehicle.t()) :: Vehicle.t()
  def tick(%{armed: false} = v),
    do: if(Vehicle.own(v, :act_at), do: Vehicle.put_own(v, :act_at, nil), else: v)

  def tick(v), do: v |> battery() |> offboard() |> act()

  defp battery(v) do
    left = Battery.remaining(v.battery)

    cond do
      left <= Params.get(v.params, "BAT_CRIT_THR") -> set(v, :battery_critical, true)
      left <= Params.get(v.params, "BAT_LOW_THR") -> set(v, :battery, true)
      true -> v
    end
  end

  defp offboard(%{mode: "OFFBOARD"} = v) do
    case Vehicle.own(v, :setpoints) do
      %{last: last} ->
        if v.now - last > Params.get(v.params, "COM_OF_LOSS_T") * 1.0e6 + 500_000,
          do: hold_then_return(v, @generic),
          else: v

      nil ->
        hold_then_return(v, @generic)
    end
  end

  defp offboard(v), do: v

  defp act(v) do
    at = Vehicle.own(v, :act_at)

    if at && v.now >= at do
      v = Vehicle.put_own(v, :act_at, nil)
      # A pilot who took over in the meantime keeps control.
      if v.mode == "AUTO_LOITER", do: bring_down(v), else: v
    else
      v
    end
  end

  # Too little charge is left to fly home.
  defp bring_down(v) do
    if Battery.remaining(v.battery) <= Params.get(v.params, "BAT_EMERGEN_THR"),
      do: v |> Vehicle.text(0, "Emergency battery level\t") |> enter("AUTO_LAND", @action_land, @emergency),
      else: enter(v, "AUTO_RTL", @action_rtl, Vehicle.own(v, :cause, @generic))
  end

  defp begin(v, :battery) do
    left = min(Battery.remaining(v.battery), Params.get(v.params, "BAT_LOW_THR"))
    v = %{v | battery: Battery.set_remaining(v.battery, left)}
    Events.emit(v, :battery_low, [], {2, "Low battery"})
  end

  defp begin(v, :battery_critical) do
    left = min(Battery.remaining(v.battery), Params.get(v.params, "BAT_CRIT_THR"))
    v = %{v | battery: Battery.set_remaining(v.battery, left)}
    v = Vehicle.text(v, 2, "Critical battery\t")
    if v.armed, do: hold_then_return(v, @causes.battery_critical), else: v
  end

  defp begin(v, kind) when kind in [:gps, :ekf] do
    v = if kind == :gps, do: Vehicle.text(v, 2, "Preflight Fail: GPS fix too low\t"), else: v
    if v.airborne and v.armed, do: enter(v, "AUTO_LAND", @action_land, @generic), else: v
  end

  defp begin(v, :fence),
    do: if(v.airborne and v.armed, do: enter(v, "AUTO_LOITER", @action_hold, @generic), else: v)

  defp begin(v, kind) when kind in [:gcs, :rc] do
    v = lost(v, kind)
    if v.airborne and v.armed, do: hold_then_return(v, @causes[kind]), else: v
  end

  defp lost(v, :gcs), do: Events.emit(v, :gcs_lost, [], {4, "Connection to ground control station lost"})
  defp lost(v, :rc), do: Events.emit(v, :rc_lost, [], {6, "Manual control lost"})

  defp hold_then_return(v, cause) do
    v
    |> Events.emit(
      :failsafe_hold,
      [Modes.number(v.mode), @action_rtl, div(@hold_us, 1_000_000), cause],
      {2, "Failsafe activated: entering Hold for 5 seconds"}
    )
    |> Modes.enter("AUTO_LOITER")
    |> Vehicle.put_own(:cause, cause)
    |> Vehicle.put_own(:act_at, v.now + @hold_us)
  end

  defp enter(v, mode, action, cause) do
    v
    |> Events.emit(:failsafe, [Modes.number(v.mode), action, cause], {2, "Failsafe activated"})
    |> Modes.enter(mode)
  end

  defp over(v, :battery_critical), do: %{v | battery: Battery.set_remaining(v.battery, 1.0)}

  defp over(v, :gcs),
    do: Events.emit(v, :gcs_regained, [], {6, "Connection to ground control station regained"})

  defp over(v, :rc), do: Events.emit(v, :rc_regained, [0.0], {6, "Manual control regained"})
  defp over(v, _kind), do: v
end
