defmodule Aerie.Vehicle.State.Groups.Health do
  @moduledoc """
  The health of sensors (SYS_STATUS, which also has a battery), estimator and vibration; and the autopilot's version and
  unique id.
  """
  import Bitwise

  alias Aerie.Vehicle.Firmware
  alias Aerie.Vehicle.State.{Group, Value}
  alias Aerie.Vehicle.State.Groups.{Battery, Mission}
  alias MavCodec.Enums.MavSysStatusSensor
  alias MavCodec.Messages, as: M

  @ekf "EKF_STATUS_REPORT, ESTIMATOR_STATUS"
  @prearm_check MavSysStatusSensor.value(:MAV_SYS_STATUS_PREARM_CHECK)
  @fence MavSysStatusSensor.value(:MAV_SYS_STATUS_GEOFENCE)
  @rc_receiver MavSysStatusSensor.value(:MAV_SYS_STATUS_SENSOR_RC_RECEIVER)

  use Group,
    name: :health,
    title: "The health of sensors and estimator.",
    sampling: {:change, 1.0, %{}, 30.0},
    messages: [
      M.SysStatus,
      M.EkfStatusReport,
      {M.EstimatorStatus, M.EkfStatusReport},
      M.Vibration,
      M.AutopilotVersion
    ],
    fields: [
      {:load, 3, "0..1", "processor load", "SYS_STATUS"},
      {:unhealthy, {:list, :text}, nil,
       "a list of the sensors and functions that are present, enabled and unhealthy",
       "SYS_STATUS, HIGH_LATENCY2"},
      {:ready_to_arm, :boolean, nil, "whether the pre-arm checks pass", "SYS_STATUS"},
      {:arming_checks, {:list, :object}, nil, "PX4, Betaflight, iNav: a list of the failing arming checks:",
       "EVENT, STATUSTEXT"},
      {[:arming_checks, :id], :text, nil, "PX4: id of the report, hexadecimal", "EVENT"},
      {[:arming_checks, :name], :text, nil, "name of the check", "EVENT, STATUSTEXT"},
      {[:arming_checks, :severity], 0, nil, "MAV_SEVERITY", "EVENT, STATUSTEXT"},
      {:rc_receiver, :boolean, nil, "whether the remote control receiver is healthy", "SYS_STATUS"},
      {:fence_enabled, :boolean, nil, "whether the vehicle's fence is on; null for a vehicle without one",
       "SYS_STATUS"},
      {:drop_rate, 4, "0..1", "ratio of frames that the vehicle did not receive", "SYS_STATUS"},
      {:errors, 0, nil, "communication errors", "SYS_STATUS"},
      {:ekf, {:object, 3}, nil, "the estimator; ratios below 1 are good:", @ekf},
      {[:ekf, :flags], 0, nil, "flags of EKF_STATUS_REPORT or ESTIMATOR_STATUS", @ekf},
      {[:ekf, :velocity], 3, nil, "innovation test ratio of the velocity", @ekf},
      {[:ekf, :position_horizontal], 3, nil, "… of the horizontal position", @ekf},
      {[:ekf, :position_vertical], 3, nil, "… of the height", @ekf},
      {[:ekf, :compass], 3, nil, "… of the compass", @ekf},
      {[:ekf, :terrain], 3, nil, "… of the height above the ground", @ekf},
      {:vibration, {:list, 2}, "m/s²", "a list: x, y, z", "VIBRATION"},
      {:clipping, 0, nil, "how often an accelerometer clipped, sum of all", "VIBRATION"}
    ]

  @impl Group
  def read(%M.SysStatus{} = m, state, at) do
    health = m |> health() |> nothing_in_the_way(state)
    {[], Battery.sys_status(m, state, at) ++ [health: health] ++ fence_off(m, Group.data(state, :health))}
  end

  def read(%M.EkfStatusReport{} = m, _state, _at) do
    {[],
     health: %{
       ekf: %{
         flags: m.flags,
         velocity: Value.float(m.velocity_variance),
         position_horizontal: Value.float(m.pos_horiz_variance),
         position_vertical: Value.float(m.pos_vert_variance),
         compass: Value.float(m.compass_variance),
         terrain: Value.float(m.terrain_alt_variance)
       }
     }}
  end

  def read(%M.EstimatorStatus{} = m, _state, _at) do
    {[],
     health: %{
       ekf: %{
         flags: m.flags,
         velocity: Value.float(m.vel_ratio),
         position_horizontal: Value.float(m.pos_horiz_ratio),
         position_vertical: Value.float(m.pos_vert_ratio),
         compass: Value.float(m.mag_ratio),
         terrain: Value.float(m.hagl_ratio)
       }
     }}
  end

  def read(%M.Vibration{} = m, _state, _at) do
    {[],
     health: %{
       vibration: [Value.float(m.vibration_x), Value.float(m.vibration_y), Value.float(m.vibration_z)],
       clipping: m.clipping_0 + m.clipping_1 + m.clipping_2
     }}
  end

  def read(%M.AutopilotVersion{} = m, _state, _at) do
    {[firmware: version(m.flight_sw_version), uid: uid(m), capabilities: m.capabilities], []}
  end

  defp health(m) do
    enabled = m.onboard_control_sensors_enabled
    failing = m.onboard_control_sensors_present &&& enabled &&& bnot(m.onboard_control_sensors_health)

    %{
      load: Value.up_to(m.load, 1000, 1000),
      unhealthy: names(failing &&& bnot(@prearm_check)),
      rc_receiver: rc_receiver(m),
      fence_enabled: fence_enabled(m),
      ready_to_arm: if((enabled &&& @prearm_check) != 0, do: (failing &&& @prearm_check) == 0),
      drop_rate: Value.up_to(m.drop_rate_comm, 10_000, 10_000),
      errors: m.errors_comm
    }
  end

  # What was in the way before it was ready is not any more (`Aerie.Vehicle.Session.Core.Reporting`).
  defp nothing_in_the_way(health, state) do
    if health.ready_to_arm == true and Firmware.telemetry(state.autopilot).arming_texts?,
      do: Map.put(health, :arming_checks, []),
      else: health
  end

  # PX4 shows a lost receiver as not present.
  defp rc_receiver(m) do
    if (m.onboard_control_sensors_enabled &&& @rc_receiver) != 0,
      do: (m.onboard_control_sensors_present &&& m.onboard_control_sensors_health &&& @rc_receiver) != 0
  end

  # ArduPilot sends FENCE_STATUS only of a fence that is on: what the last one said is not known any more.
  defp fence_off(m, %{fence_enabled: true}),
    do: if(fence_enabled(m), do: [], else: [mission: Mission.fence_unknown()])

  defp fence_off(_m, _health), do: []

  # A vehicle without a fence shows it as not present.
  defp fence_enabled(m) do
    if (m.onboard_control_sensors_present &&& @fence) != 0,
      do: (m.onboard_control_sensors_enabled &&& @fence) != 0
  end

  defp names(0), do: []

  defp names(bits) do
    {flags, unknown} = MavSysStatusSensor.flags(bits)
    named = for flag <- flags, do: flag |> Atom.to_string() |> short()
    if unknown == 0, do: named, else: named ++ ["bits 0x#{Integer.to_string(unknown, 16)}"]
  end

  defp short("MAV_SYS_STATUS_SENSOR_" <> name), do: String.downcase(name)
  defp short("MAV_SYS_STATUS_" <> name), do: String.downcase(name)

  # As it is written: 4.6.3, 1.18.0-beta.
  defp version(0), do: nil

  defp version(number) do
    plain = "#{number >>> 24 &&& 0xFF}.#{number >>> 16 &&& 0xFF}.#{number >>> 8 &&& 0xFF}"

    case number &&& 0xFF do
      255 -> plain
      type when type >= 192 -> plain <> "-rc"
      type when type >= 128 -> plain <> "-beta"
      type when type >= 64 -> plain <> "-alpha"
      _type -> plain <> "-dev"
    end
  end

  # The long unique id if there is one, else the short one; a vehicle may have neither.
  defp uid(%{uid2: uid2, uid: uid}) do
    cond do
      String.trim(uid2, <<0>>) != "" -> Base.encode16(uid2, case: :lower)
      uid != 0 -> Integer.to_string(uid, 16)
      true -> nil
    end
  end
end
