defmodule Aerie.Vehicle.Firmware.Ardupilot.Adapter do
  @moduledoc """
  ArduPilot (copter, plane, rover, sub and its other vehicles), as of 4.6.

  Heights are above home unless the frame says otherwise; in COMMAND_LONG they always are. A refusal is FAILED more
  often than DENIED, and its reason comes as a STATUSTEXT. Vehicles fly to positions in GUIDED, and item 0 of a mission
  is home (W8).
  """

  # Heights in COMMAND_LONG are above home.
  use Aerie.Vehicle.Firmware.Adapter

  use Aerie.Vehicle.Protocol.Mavlink.Commands,
    calibration: Aerie.Vehicle.Firmware.Ardupilot.Calibration,
    long_frames: [3, 6]

  import Aerie.Vehicle.Protocol.Vehicle, only: [airborne: 2]

  alias Aerie.Vehicle.Firmware.{Ardupilot, GroundStation, Modes, Reading, Telemetry, Traits}
  alias Aerie.Vehicle.Firmware.Ardupilot.{Calibration, Steering, StoredItem}
  alias Aerie.Vehicle.Protocol.{Mavlink, Vehicle}
  alias Aerie.Vehicle.Protocol.Mavlink.{Commands, Streams}
  alias MavCodec.Enums.MavAutopilot

  @copter "copter"
  @winged ["plane", "vtol"]
  @grounded ["rover", "boat"]

  # Each kind has its own firmware with its own modes.
  @hold %{
    "copter" => "BRAKE",
    "plane" => "LOITER",
    "vtol" => "LOITER",
    "rover" => "HOLD",
    "boat" => "HOLD",
    "sub" => "POSHOLD",
    "blimp" => "HOLD"
  }
  @returning ~w(copter plane vtol rover boat blimp)
  @missions ~w(copter plane vtol rover boat sub)

  @impl true
  def traits do
    %Traits{
      title: "ArduPilot",
      mav_autopilot: MavAutopilot.value(:MAV_AUTOPILOT_ARDUPILOTMEGA),
      modes: Ardupilot.Modes,
      inputs: Ardupilot.Inputs,
      room: Ardupilot.Room,
      param_file?: true,
      fences?: true,
      # AP_Logger::should_handle_log_message.
      logs_armed?: false
    }
  end

  @impl true
  def telemetry do
    %Telemetry{
      high_latency_armed?: true,
      # QSTABILIZE to QACRO.
      rotor_modes: 17..23,
      status_flies?: true,
      detects_landing?: true
    }
  end

  @impl true
  def reading do
    %Reading{
      zero_place: :here,
      guided_items: :obeyed,
      setpoints: %{
        "plane" => [:height],
        "vtol" => [:height],
        "rover" => [:driven],
        "boat" => [:driven],
        # In its modes that keep a depth it takes the height alone.
        "sub" => [:whole, :depth],
        any: [:whole]
      },
      stays_at_setpoint?: false,
      kill_gesture?: false,
      steered_by: :commands
    }
  end

  @impl true
  def ground_station(kind) do
    failsafe =
      if kind in @winged, do: ~w(FS_GCS_ENABL FS_LONG_TIMEOUT), else: ~w(FS_GCS_ENABLE FS_GCS_TIMEOUT)

    %GroundStation{
      listens_to: :ids,
      # Since 4.7, and before.
      ids: [{"MAV_GCS_SYSID", "MAV_GCS_SYSID_HI"}, {"SYSID_MYGCS", nil}],
      asks: ~w(SYSID_MYGCS MAV_GCS_SYSID MAV_GCS_SYSID_HI) ++ failsafe
    }
  end

  @impl true
  def gap("takeoff", "plane"),
    do:
      "ArduPlane takes off by its mode TAKEOFF, to TKOFF_ALT, or by a mission: use set_mode or mission_start"

  def gap("takeoff", kind) when kind not in ["copter", "vtol"], do: "it does not take off"

  def gap("land", "plane"),
    do: "ArduPlane lands by the landing of its mission: use land_start"

  def gap("land", kind) when kind not in ["copter", "vtol", "blimp"], do: "it does not land"

  def gap("rtl", kind) when kind not in @returning, do: "this firmware has no mode for returning"

  def gap("hold", kind) when not is_map_key(@hold, kind),
    do: "this firmware has no mode for holding"

  def gap(type, kind)
      when type in ["mission_start", "mission_pause", "resume"] and kind not in @missions,
      do: "this firmware has no missions"

  def gap("mission_pause", kind) when kind in ["rover", "boat", "sub"],
    do: "this firmware does not pause a mission: use hold, and then resume"

  def gap("set_altitude", kind) when kind in @grounded, do: "it has no height to change"

  def gap(type, kind)
      when type in ["setpoint_position", "setpoint_local", "setpoint_velocity"] and kind in @winged,
      do: "ArduPlane takes only the height of a set-point: use goto or set_altitude"

  def gap("orbit", kind) when kind not in @winged,
    do: "only ArduPlane circles around a given place; set_mode CIRCLE does so in front of a copter"

  def gap("set_yaw", kind) when kind in @winged, do: "ArduPlane steers its nose itself"

  def gap("vtol_transition", kind) when kind not in @winged,
    do: "it has no wings and rotors to change between"

  def gap("land_start", kind) when kind not in ["copter" | @winged],
    do: "its missions have no landing"

  def gap("actuator", _kind), do: "ArduPilot has no DO_SET_ACTUATOR: use servo"
  def gap("save_params", _kind), do: "ArduPilot stores each parameter when it is set"
  def gap(_type, _kind), do: nil

  @impl true
  def steps(%{type: type, params: params}, vehicle) do
    case special(type, params, vehicle) do
      :common -> {:ok, Commands.steps(type, params, vehicle)}
      {why_not, reason} -> {why_not, reason}
      steps -> {:ok, steps}
    end
  end

  # Each of these it refuses after the mode was changed, which may have ended a return.
  defp special("takeoff", _params, %{in_air: true}), do: {:error, "it is in the air"}
  defp special("takeoff", _params, %{armed: false}), do: {:error, "it is not armed"}

  # It takes off in GUIDED only.
  defp special("takeoff", params, vehicle) do
    takeoff =
      Mavlink.long(:MAV_CMD_NAV_TAKEOFF, %{7 => params.altitude}, confirm: {:in_air, true}, within_ms: 30_000)

    guided(vehicle) ++ [takeoff]
  end

  defp special("land", _params, %{kind: "vtol"} = vehicle), do: mode("QLAND", vehicle)

  defp special("land", _params, _vehicle),
    do: [Mavlink.long(:MAV_CMD_NAV_LAND, %{}, confirm: {:any, [{:mode, ["LAND"]}, {:in_air, false}]})]

  defp special("rtl", _params, _vehicle),
    do: [
      Mavlink.long(:MAV_CMD_NAV_RETURN_TO_LAUNCH, %{},
        confirm: {:mode, ["RTL", "SMART_RTL", "QRTL", "AUTO_RTL"]}
      )
    ]

  defp special("hold", _params, vehicle), do: mode(Map.fetch!(@hold, vehicle.kind), vehicle)

  # A mission that is paused stays in AUTO.
  defp special("resume", _params, %{mode: "AUTO", kind: kind}) when kind in ["rover", "boat", "sub"],
    do: {:error, "its mission is not paused: it is in AUTO"}

  defp special("resume", _params, %{mode: "AUTO", kind: kind}) when kind not in @winged,
    do: [Mavlink.long(:MAV_CMD_DO_PAUSE_CONTINUE, %{1 => 1})]

  defp special("resume", _params, vehicle), do: mode("AUTO", vehicle)

  defp special("mission_start", _params, _vehicle),
    do: [Mavlink.long(:MAV_CMD_MISSION_START, %{}, confirm: {:mode, ["AUTO"]})]

  defp special("mission_pause", _params, %{kind: kind} = vehicle) when kind in @winged,
    do: mode("LOITER", vehicle)

  defp special("mission_pause", _params, _vehicle), do: [Mavlink.long(:MAV_CMD_DO_PAUSE_CONTINUE, %{1 => 0})]

  defp special("mission_set_current", params, _vehicle),
    do: [
      Mavlink.long(:MAV_CMD_DO_SET_MISSION_CURRENT, %{1 => params.seq}, confirm: {:mission_seq, params.seq})
    ]

  defp special("jump", params, _vehicle),
    do: [Mavlink.long(:MAV_CMD_DO_JUMP_TAG, %{1 => params.tag, 2 => params.repeat})]

  defp special("set_geofence", params, _vehicle),
    do: [Mavlink.long(:MAV_CMD_DO_FENCE_ENABLE, %{1 => bit(params.enabled)})]

  defp special("set_mode", %{mode: name}, vehicle), do: mode(name, vehicle)

  defp special("set_mode", %{standard_mode: name}, vehicle) do
    case Modes.standard(vehicle) do
      %{^name => mode} -> mode(mode, vehicle)
      _none -> {:error, "ArduPilot has no mode for #{name} on a #{vehicle.kind}"}
    end
  end

  defp special("goto", params, vehicle) do
    steps = reposition(params, vehicle, %{1 => params[:speed] || -1}) ++ turn(params, vehicle)
    airborne(vehicle, steps)
  end

  # An ArduPlane that is sent to a position circles around it; a radius and a direction make it an orbit.
  defp special("orbit", params, vehicle) do
    place = Map.merge(%{lat: vehicle.lat, lon: vehicle.lon, altitude: vehicle.alt_rel}, params)
    direction = if params.direction == "counterclockwise", do: 1, else: 0
    more = %{1 => params[:speed] || -1, 3 => params.radius, 4 => direction}
    airborne(vehicle, placed(place, fn -> reposition(place, vehicle, more) end))
  end

  defp special("set_altitude", params, %{kind: "plane"} = vehicle) do
    airborne(
      vehicle,
      guided(vehicle) ++ [Mavlink.int(:MAV_CMD_GUIDED_CHANGE_ALTITUDE, frames(params, vehicle), nil, %{})]
    )
  end

  defp special("set_altitude", params, vehicle) do
    place = Map.merge(params, %{lat: vehicle.lat, lon: vehicle.lon})
    airborne(vehicle, placed(place, fn -> reposition(place, vehicle, %{1 => -1}) end))
  end

  defp special("set_yaw", params, _vehicle), do: [yaw(params.yaw, params.rate, params.relative)]

  defp special("set_roi", params, vehicle),
    do: [Mavlink.int(:MAV_CMD_DO_SET_ROI_LOCATION, frames(params, vehicle), {params.lat, params.lon})]

  defp special("parachute", params, _vehicle) do
    action = Map.fetch!(%{"disable" => 0, "enable" => 1, "release" => 2}, params.action)
    [Mavlink.long(:MAV_CMD_DO_PARACHUTE, %{1 => action})]
  end

  defp special("servo", params, _vehicle),
    do: [Mavlink.long(:MAV_CMD_DO_SET_SERVO, %{1 => params.channel, 2 => params.pwm})]

  defp special("relay", params, _vehicle),
    do: [Mavlink.long(:MAV_CMD_DO_SET_RELAY, %{1 => params.relay, 2 => bit(params.on)})]

  # In per cent.
  defp special("motor_test", params, _vehicle),
    do: [
      Mavlink.long(:MAV_CMD_DO_MOTOR_TEST, %{
        1 => params.motor,
        3 => params.throttle * 100,
        4 => params.duration
      })
    ]

  defp special("calibrate" <> _what = type, params, vehicle), do: Calibration.steps(type, params, vehicle)

  defp special("setpoint_" <> _what = type, params, vehicle) do
    with :ok <- Steering.setpoint(type, vehicle),
         do: type |> setpoint(params, vehicle) |> noted(Steering.note(vehicle))
  end

  defp special(type, params, vehicle) when type in ["rc_override", "manual_control"] do
    with {:ok, note} <- Steering.sticks(vehicle), do: type |> Streams.steps(params, vehicle) |> noted(note)
  end

  defp special(_type, _params, _vehicle), do: :common

  defp setpoint("setpoint_position", params, _vehicle),
    do: Streams.position(params, Streams.frame(params.altitude_reference), params.altitude)

  defp setpoint(type, params, vehicle), do: Streams.steps(type, params, vehicle)

  defp noted(steps, note), do: Enum.map(steps, &%{&1 | note: note})

  defp guided(%{mode: "GUIDED"}), do: []
  defp guided(vehicle), do: mode("GUIDED", vehicle)

  defp mode(name, vehicle) do
    case Modes.find(vehicle, name) do
      {:ok, number, name} ->
        [Mavlink.long(:MAV_CMD_DO_SET_MODE, %{1 => 1, 2 => number}, confirm: {:mode, [name]})]

      :error ->
        {:error, "ArduPilot has no mode #{inspect(name)} on a #{vehicle.kind}"}
    end
  end

  # DO_REPOSITION that changes to GUIDED by itself. On the ground ArduPilot accepts it, but nothing moves.
  defp reposition(params, vehicle, more) do
    numbers = Map.merge(%{2 => 1, 4 => :nan}, more)

    [
      Mavlink.int(:MAV_CMD_DO_REPOSITION, frames(params, vehicle), {params.lat, params.lon}, numbers,
        confirm: {:mode, ["GUIDED"]}
      )
    ]
  end

  # The requested frame, and the other one if the height can be converted.
  defp frames(%{altitude_reference: "home"} = params, vehicle) do
    case Vehicle.msl(vehicle, params.altitude, "home") do
      {:ok, msl} -> [{6, params.altitude}, {5, msl}]
      {:error, _unknown} -> [{6, params.altitude}]
    end
  end

  defp frames(params, _vehicle), do: [{Streams.frame(params.altitude_reference), params.altitude}]

  defp turn(%{yaw: yaw}, %{kind: @copter}), do: [yaw(yaw, 0, false)]
  defp turn(_params, _vehicle), do: []

  # CONDITION_YAW: how far, how fast, to which side, from where. 0 is the shorter side.
  defp yaw(angle, rate, true),
    do: Mavlink.long(:MAV_CMD_CONDITION_YAW, %{1 => abs(angle), 2 => rate, 3 => sign(angle), 4 => 1})

  defp yaw(angle, rate, false),
    do:
      Mavlink.long(:MAV_CMD_CONDITION_YAW, %{1 => :math.fmod(angle + 720.0, 360.0), 2 => rate, 3 => 0, 4 => 0})

  defp sign(angle), do: if(angle < 0, do: -1, else: 1)
  defp bit(on?), do: if(on?, do: 1, else: 0)

  defp placed(%{lat: lat, lon: lon, altitude: altitude}, steps) do
    if lat && lon && altitude, do: steps.(), else: {:error, "its position is not known yet"}
  end

  @impl true
  def home_is_item_0?, do: true

  @impl true
  def item_offset, do: 0

  @impl true
  defdelegate kept(item, mission_type, kind), to: StoredItem, as: :item
end
