defmodule SimVehicle.Firmware.Ardupilot.Failsafes do
  @moduledoc """
  ArduCopter's failsafes: on demand, and by themselves for the battery and a lost ground station.
  """

  import MavCodec.Command

  alias SimVehicle.{Params, Plans, Vehicle}
  alias SimVehicle.Physics.{Battery, Geo}
  alias SimVehicle.Firmware.Ardupilot.{Arming, Modes}

  @doc "A failsafe begins or ends."
  @spec set(Vehicle.t(), atom, boolean) :: Vehicle.t()
  def set(v, kind, on?) do
    case Vehicle.put_failsafe(v, kind, on?) do
      :unchanged -> v
      v when on? -> v |> deplete(kind) |> begin(kind)
      v -> over(v, kind)
    end
  end

  @doc "A heartbeat of the vehicle's own ground station ends the ground station failsafe (rule H5)."
  @spec gcs_heard(Vehicle.t(), integer) :: Vehicle.t()
  def gcs_heard(v, system) do
    if system == Params.get(v.params, "SYSID_MYGCS"),
      do: v |> Vehicle.put_own(:my_gcs_at, v.now) |> set(:gcs, false),
      else: v
  end

  @doc "Checks charge, fence and ground station."
  @spec tick(Vehicle.t()) :: Vehicle.t()
  def tick(%{armed: false} = v), do: v
  def tick(v), do: v |> battery() |> fence() |> gcs()

  defp battery(v) do
    left = Battery.remaining(v.battery) * v.battery.capacity_mah

    cond do
      left <= Params.get(v.params, "BATT_CRT_MAH") -> set(v, :battery_critical, true)
      left <= Params.get(v.params, "BATT_LOW_MAH") -> set(v, :battery, true)
      true -> v
    end
  end

  # Only after a ground station was seen.
  defp gcs(v) do
    seen = Vehicle.own(v, :my_gcs_at)
    timeout = Params.get(v.params, "FS_GCS_TIMEOUT") * 1.0e6

    if seen && Params.get(v.params, "FS_GCS_ENABLE") != 0 && v.now - seen > timeout,
      do: set(v, :gcs, true),
      else: v
  end

  defp fence(v) do
    if Params.get(v.params, "FENCE_ENABLE") != 0 and v.airborne and outside?(v),
      do: set(v, :fence, true),
      else: v
  end

  defp outside?(v) do
    type = round(Params.get(v.params, "FENCE_TYPE"))
    height = Vehicle.relative_altitude(v)
    away = :math.sqrt(v.kin.n ** 2 + v.kin.e ** 2)

    (Bitwise.band(type, 1) != 0 and height > Params.get(v.params, "FENCE_ALT_MAX")) or
      (Bitwise.band(type, 2) != 0 and away > Params.get(v.params, "FENCE_RADIUS")) or
      (Bitwise.band(type, 4) != 0 and outside_polygon?(v))
  end

  # Only the first inclusion polygon of the plan counts.
  defp outside_polygon?(v) do
    corners =
      for %{command: cmd(:NAV_FENCE_POLYGON_VERTEX_INCLUSION)} = item <- Plans.items(v.plans, 1),
          do: Geo.to_local(v.origin, item.x, item.y)

    length(corners) >= 3 and not Geo.inside?(corners, {v.kin.n, v.kin.e})
  end

  # On demand the failsafe comes with its cause.
  defp deplete(v, :battery), do: drain_to(v, Params.get(v.params, "BATT_LOW_MAH"))
  defp deplete(v, :battery_critical), do: drain_to(v, Params.get(v.params, "BATT_CRT_MAH"))
  defp deplete(v, _kind), do: v

  defp drain_to(v, mah) do
    left = min(Battery.remaining(v.battery), mah / v.battery.capacity_mah)
    %{v | battery: Battery.set_remaining(v.battery, left)}
  end

  defp begin(v, :battery),
    do: v |> say_battery("low") |> act("Battery", Params.get(v.params, "BATT_FS_LOW_ACT"))

  defp begin(v, :battery_critical),
    do: v |> say_battery("critical") |> act("Battery", Params.get(v.params, "BATT_FS_CRT_ACT"))

  defp begin(v, :gcs), do: act(v, "GCS", 2)
  defp begin(v, :rc), do: act(v, "Radio", 2)

  defp begin(v, :fence) do
    v = Vehicle.text(v, 5, "Fence Breached")
    if v.armed and v.airborne, do: return_or_land(v), else: v
  end

  defp begin(v, :ekf) do
    v = Vehicle.text(v, 2, "EKF variance")

    if v.armed and Modes.requires_position?(v.mode),
      do: v |> Vehicle.text(2, "EKF Failsafe: changed to LAND Mode") |> Modes.enter("LAND"),
      else: v
  end

  defp begin(v, :gps) do
    v = v |> Vehicle.text(2, "GPS Glitch or Compass error") |> Vehicle.text(6, "EKF3 IMU0 stopped aiding")

    if v.armed and Modes.requires_position?(v.mode),
      do: v |> Vehicle.text(2, "EKF Failsafe: changed to LAND Mode") |> Modes.enter("LAND"),
      else: v
  end

  defp over(v, :gcs), do: Vehicle.text(v, 4, "GCS Failsafe Cleared")
  defp over(v, :rc), do: Vehicle.text(v, 4, "Radio Failsafe Cleared")
  defp over(v, :ekf), do: Vehicle.text(v, 2, "EKF Failsafe Cleared")
  defp over(v, :gps), do: v |> Vehicle.text(2, "Glitch cleared") |> Vehicle.text(6, "EKF3 IMU0 is using GPS")
  defp over(v, _kind), do: v

  defp say_battery(v, what) do
    volts = :erlang.float_to_binary(Battery.voltage(v.battery) * 1.0, decimals: 2)
    Vehicle.text(v, 4, "Battery 1 is #{what} #{volts}V used #{round(v.battery.used_mah)} mAh")
  end

  # Actions are those of BATT_FS_LOW_ACT: 0 none, 1 land, 2 RTL, 5 terminate.
  defp act(%{armed: false} = v, _type, _action), do: v

  defp act(%{airborne: false} = v, type, _action),
    do: v |> Vehicle.text(4, "#{type} Failsafe - Disarming") |> Arming.stop()

  defp act(v, type, action) do
    v = Vehicle.text(v, 4, "#{type} Failsafe")

    case action do
      1 -> Modes.enter(v, "LAND")
      2 -> return_or_land(v)
      5 -> Arming.stop(v)
      _none -> v
    end
  end

  # Landing is not interrupted by going home.
  defp return_or_land(%{mode: "LAND"} = v), do: v
  defp return_or_land(%{mode: "RTL"} = v), do: v

  defp return_or_land(v) do
    case Modes.change(v, "RTL") do
      {0, v} -> v
      {_failed, v} -> Modes.enter(v, "LAND")
    end
  end
end
