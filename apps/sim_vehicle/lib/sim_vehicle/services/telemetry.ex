defmodule SimVehicle.Services.Telemetry do
  @moduledoc """
  Builds the message with a given id from the state of a vehicle. What is special to a firmware comes from its
  personality; the rest, the same for both, from the modules below this one.
  """

  import MavCodec.Command
  import MavCodec.MessageId

  alias MavCodec.Messages, as: M
  alias SimVehicle.{Plans, Vehicle}
  alias SimVehicle.Physics.Geo
  alias SimVehicle.Services.Telemetry

  @doc "The message, nil when the vehicle does not have it (now)."
  @spec message(Vehicle.t(), non_neg_integer) :: struct | nil
  def message(v, id) do
    case v.personality.telemetry(v, id) do
      :common -> common(v, id)
      message_or_nil -> message_or_nil
    end
  end

  @doc "Home as ArduPilot's mission item 0; nil while home is unknown."
  @spec home_item(Vehicle.t()) :: map | nil
  def home_item(%{home: nil}), do: nil

  def home_item(%{home: home}) do
    %{
      seq: 0,
      frame: 0,
      command: cmd(:NAV_WAYPOINT),
      current: 0,
      autocontinue: 1,
      params: {0.0, 0.0, 0.0, 0.0},
      x: home.lat,
      y: home.lon,
      z: home.alt
    }
  end

  @doc "Milliseconds since boot, as telemetry carries it (wraps after 49 days)."
  @spec boot_ms(Vehicle.t()) :: 0..4_294_967_295
  def boot_ms(v), do: rem(div(v.now, 1000), 4_294_967_296)

  @position [
    id(GpsRawInt),
    id(LocalPositionNed),
    id(GlobalPositionInt),
    id(GpsGlobalOrigin),
    id(VfrHud),
    id(PositionTargetLocalNed),
    id(PositionTargetGlobalInt),
    id(Altitude),
    id(HomePosition)
  ]
  @attitude [
    id(RawImu),
    id(ScaledPressure),
    id(Attitude),
    id(AttitudeQuaternion),
    id(ServoOutputRaw),
    id(RcChannels),
    id(HighresImu),
    id(ScaledImu2),
    id(ScaledImu3),
    id(ScaledPressure2),
    id(Vibration)
  ]

  defp common(v, id) when id in @position, do: Telemetry.Position.message(v, id)
  defp common(v, id) when id in @attitude, do: Telemetry.Sensors.message(v, id)
  defp common(v, id(SysStatus)), do: Telemetry.Power.sys_status(v)
  defp common(v, id(BatteryStatus)), do: Telemetry.Power.battery_status(v)
  defp common(v, id(SystemTime)), do: %M.SystemTime{time_unix_usec: unix(v), time_boot_ms: boot_ms(v)}
  defp common(v, id(MissionCurrent)), do: mission_current(v)
  defp common(v, id(PowerStatus)), do: Telemetry.Power.power_status(v)
  defp common(v, id(ExtendedSysState)), do: %M.ExtendedSysState{vtol_state: 0, landed_state: landed_state(v)}
  defp common(_v, _id), do: nil

  @doc "MAV_LANDED_STATE: 1 on the ground, 2 in the air, 3 taking off, 4 landing."
  @spec landed_state(Vehicle.t()) :: 0..4
  def landed_state(%{landed: :on_ground}), do: 1
  def landed_state(%{landed: :in_air}), do: 2
  def landed_state(%{landed: :taking_off}), do: 3
  def landed_state(%{landed: :landing}), do: 4

  # UNIX time in microseconds as the vehicle knows it; 0 before it has GPS time.
  defp unix(%{now: now, epoch: epoch} = v) when is_integer(now) and is_integer(epoch),
    do: if(now * 4 < v.ready_us, do: 0, else: epoch + now)

  @mission_states %{none: 1, not_started: 2, active: 3, paused: 4, complete: 5}

  @doc "MISSION_CURRENT as ArduPilot counts (home is not an item)."
  @spec mission_current(Vehicle.t()) :: struct
  def mission_current(v) do
    flying = if v.flight == :mission, do: 1, else: 0

    %M.MissionCurrent{
      seq: v.mission.current,
      total: max(length(Plans.items(v.plans, 0)) - 1, 0),
      mission_state: Map.fetch!(@mission_states, v.mission.state),
      mission_mode: flying
    }
  end

  @doc "Heading in centidegrees."
  @spec heading(Vehicle.t()) :: 0..35_999
  def heading(v), do: Geo.centidegrees(v.kin.yaw)
end
