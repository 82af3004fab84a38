defmodule SimVehicle.Firmware.Px4.Reports do
  @moduledoc """
  The messages that only PX4 has, or that have another form in PX4.
  """

  import MavCodec.MessageId

  alias MavCodec.Messages, as: M
  alias SimVehicle.{Plans, Vehicle}
  alias SimVehicle.Services.Telemetry
  alias SimVehicle.Firmware.Px4.{Arming, Events, Missions, Modes}

  # 1.17.0, release; capabilities and flags as in the recordings.
  @version 17_891_583
  @capabilities 59_647
  @no_mission 65_535

  @doc "See `SimVehicle.Firmware.Personality`."
  @spec message(Vehicle.t(), non_neg_integer) :: struct | nil | :common
  def message(v, id(Heartbeat)) do
    %M.Heartbeat{
      type: 2,
      autopilot: 12,
      base_mode: Modes.base_mode(v.mode) + if(v.armed, do: 128, else: 0),
      custom_mode: Modes.number(v.mode),
      system_status: system_status(v),
      mavlink_version: 3
    }
  end

  def message(v, id(Ping)), do: %M.Ping{time_usec: v.now, seq: div(v.now, 10_000_000)}

  def message(v, id(MissionCurrent)) do
    items = length(Plans.items(v.plans, 0))
    base = Telemetry.mission_current(v)

    %{
      base
      | total: if(items == 0, do: @no_mission, else: items),
        mission_mode: if(v.flight == :mission, do: 1, else: 2),
        mission_state: Missions.shown_state(v, base.mission_state),
        mission_id: v.plans.opaque[0],
        fence_id: v.plans.opaque[1],
        rally_points_id: v.plans.opaque[2]
    }
  end

  def message(v, id(AutopilotVersion)) do
    %M.AutopilotVersion{
      capabilities: @capabilities,
      flight_sw_version: @version,
      middleware_sw_version: @version,
      os_sw_version: 101_854_463,
      board_version: 1,
      flight_custom_version: <<0, 0, 0, 196, 209, 42, 241, 214>>,
      middleware_custom_version: <<0, 0, 0, 196, 209, 42, 241, 214>>,
      uid: 5_283_920_058_631_409_000 + v.system
    }
  end

  def message(v, id(EstimatorStatus)) do
    flags = if Vehicle.positioned?(v), do: if(v.airborne, do: 895, else: 1023), else: 0xE5

    %M.EstimatorStatus{
      time_usec: v.now,
      flags: flags,
      tas_ratio: :nan,
      pos_horiz_accuracy: 0.2,
      pos_vert_accuracy: 0.2
    }
  end

  def message(_v, id(ProtocolVersion)),
    do: %M.ProtocolVersion{version: 200, min_version: 100, max_version: 203}

  def message(v, id(ComponentMetadata)) do
    %M.ComponentMetadata{
      time_boot_ms: Telemetry.boot_ms(v),
      file_crc: 0xC78D_DDA4,
      uri: "mftp://etc/extras/component_general.json.xz"
    }
  end

  # Only while it circles.
  def message(%{mode: "ORBIT"} = v, id(OrbitExecutionStatus)) do
    orbit = Vehicle.own(v, :orbit)
    {lat, lon} = SimVehicle.Physics.Geo.to_global(v.origin, orbit.n, orbit.e)
    %M.OrbitExecutionStatus{time_usec: v.now, radius: orbit.radius, x: lat, y: lon, z: v.origin.alt - orbit.d}
  end

  def message(_v, id(OrbitExecutionStatus)), do: nil
  def message(v, id(CurrentEventSequence)), do: Events.current(v)
  def message(v, id(CurrentMode)), do: Modes.current(v)
  def message(_v, _id), do: :common

  # MAV_STATE: 0 when it could not be armed in this mode, 2 calibrating, 3 standby, 4 active (armed), 5 in a failsafe.
  defp system_status(v) do
    cond do
      v.armed and MapSet.size(MapSet.delete(v.failsafes, :battery)) > 0 -> 5
      v.armed -> 4
      Arming.calibrating?(v) -> 2
      Arming.healthy?(v) and Modes.available?(v, v.mode) -> 3
      true -> 0
    end
  end
end
