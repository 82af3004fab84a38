defmodule Aerie.Vehicle.Fields do
  @moduledoc """
  Every field of a vehicle's state with its unit, meaning, source and number of significant decimals. NATS, REST and
  `state.sock` use these names and units, and round by this table when they render (`rounded/2`, `event/1`), never before.
  `docs/telemetry.md` is made from it.

  Units are SI and degrees. A ratio is 0..1, never per cent; a height says above what.
  """

  alias Aerie.Vehicle.Event
  alias Aerie.Vehicle.Fields.Round

  @typedoc """
  A field. `path` is its name, or the names that lead to it. `decimals`: 0 for whole numbers, nil for anything but a number.
  """
  @type t :: %{
          path: [atom()],
          decimals: non_neg_integer() | nil,
          unit: String.t() | nil,
          meaning: String.t(),
          source: String.t()
        }
  @type group :: atom()

  @global "GLOBAL_POSITION_INT"
  @hud "VFR_HUD"
  @gps "GPS_RAW_INT"
  @status "SYS_STATUS"
  @battery "BATTERY_STATUS"
  @satellite ", HIGH_LATENCY2"
  @ekf "EKF_STATUS_REPORT, ESTIMATOR_STATUS"

  # {name or path, decimals, unit, meaning, source}
  table = [
    position:
      {"The vehicle's position.",
       [
         {:lat, 7, "°", "latitude, WGS 84, north is positive", @global <> @satellite},
         {:lon, 7, "°", "longitude, east is positive", @global <> @satellite},
         {:alt_msl, 2, "m", "height above mean sea level", @global <> @satellite},
         {:alt_rel, 2, "m", "height above home, not above the ground", @global},
         {:heading, 2, "°", "direction of the nose, 0..360 from north", @global <> @satellite}
       ]},
    attitude:
      {"The vehicle's attitude.",
       [
         {:roll, 2, "°", "right side down is positive", "ATTITUDE, ATTITUDE_QUATERNION"},
         {:pitch, 2, "°", "nose up is positive", "ATTITUDE, ATTITUDE_QUATERNION"},
         {:yaw, 2, "°", "-180..180 from north", "ATTITUDE, ATTITUDE_QUATERNION"},
         {:rollspeed, 2, "°/s", "body rate", "ATTITUDE, ATTITUDE_QUATERNION"},
         {:pitchspeed, 2, "°/s", "body rate", "ATTITUDE, ATTITUDE_QUATERNION"},
         {:yawspeed, 2, "°/s", "body rate", "ATTITUDE, ATTITUDE_QUATERNION"}
       ]},
    velocity:
      {"The vehicle's velocity.",
       [
         {:vn, 2, "m/s", "to the north", @global <> ", LOCAL_POSITION_NED"},
         {:ve, 2, "m/s", "to the east", @global <> ", LOCAL_POSITION_NED"},
         {:vd, 2, "m/s", "down", @global <> ", LOCAL_POSITION_NED"},
         {:groundspeed, 2, "m/s", "over the ground", @hud <> @satellite},
         {:airspeed, 2, "m/s", "through the air", @hud <> @satellite},
         {:climb, 2, "m/s", "up", @hud <> @satellite},
         {:throttle, 2, "0..1", "ratio of full throttle", @hud <> @satellite}
       ]},
    battery:
      {"The battery with the lowest id, and a list of all. Without BATTERY_STATUS the values are those of SYS_STATUS.",
       [
         {:id, 0, nil, "id of the battery that these values are of; null if the message does not say",
          @battery},
         {:voltage, 2, "V", "voltage", @status <> ", " <> @battery},
         {:current, 2, "A", "discharge current", @status <> ", " <> @battery},
         {:remaining, 2, "0..1", "remaining charge", @status <> ", " <> @battery <> @satellite},
         {:consumed_mah, 0, "mAh", "consumed charge", @battery},
         {:charge_state, nil, nil, "MAV_BATTERY_CHARGE_STATE, the worst of all batteries", @battery},
         {:batteries, nil, nil, "a list of all batteries, each with the fields above and these:", @battery},
         {[:batteries, :id], 0, nil, "id of the battery", @battery},
         {[:batteries, :temperature], 1, "°C", "temperature", @battery}
       ]},
    gps:
      {"The first GNSS receiver.",
       [
         {:fix, 0, nil, "GPS_FIX_TYPE as a number; 3 or more is a position with height", @gps},
         {:fix_name, nil, nil, "GPS_FIX_TYPE: NO_GPS, 2D_FIX, 3D_FIX, RTK_FIXED …", @gps},
         {:satellites, 0, nil, "satellites in view", @gps},
         {:hdop, 2, nil, "horizontal dilution of precision", @gps},
         {:vdop, 2, nil, "vertical dilution of precision", @gps},
         {:lat, 7, "°", "the receiver's latitude", @gps <> @satellite},
         {:lon, 7, "°", "the receiver's longitude", @gps <> @satellite},
         {:alt_msl, 2, "m", "the receiver's height above mean sea level", @gps <> @satellite},
         {:h_acc, 2, "m", "horizontal uncertainty", @gps <> @satellite},
         {:v_acc, 2, "m", "vertical uncertainty", @gps <> @satellite}
       ]},
    mode:
      {"Mode, arming and flight state.",
       [
         {:mode, nil, nil, "name of the flight mode, which depends on firmware and type",
          "HEARTBEAT" <> @satellite},
         {:custom_mode, 0, nil, "the firmware's number of the mode", "HEARTBEAT" <> @satellite},
         {:armed, nil, nil, "true while the motors may turn", "HEARTBEAT, HIGH_LATENCY2 (ArduPilot)"},
         {:in_air, nil, nil, "true while the vehicle flies",
          "EXTENDED_SYS_STATE, HEARTBEAT, else height and speed"},
         {:landed_state, nil, nil, "MAV_LANDED_STATE", "EXTENDED_SYS_STATE"},
         {:vtol_state, nil, nil, "MAV_VTOL_STATE", "EXTENDED_SYS_STATE"},
         {:system_status, nil, nil, "MAV_STATE", "HEARTBEAT"},
         {:failsafe, nil, nil, "true while MAV_STATE is CRITICAL or EMERGENCY", "HEARTBEAT"}
       ]},
    health:
      {"The health of sensors and estimator.",
       [
         {:load, 3, "0..1", "processor load", @status},
         {:unhealthy, nil, nil, "a list of the sensors and functions that are present, enabled and unhealthy",
          @status <> @satellite},
         {:ready_to_arm, nil, nil, "whether the pre-arm checks pass", @status},
         {:arming_checks, nil, nil, "PX4: a list of the failing arming checks", "EVENT"},
         {:rc_receiver, nil, nil, "whether the remote control receiver is healthy", @status},
         {:fence_enabled, nil, nil, "whether the vehicle's fence is on; null for a vehicle without one",
          @status},
         {:drop_rate, 4, "0..1", "ratio of frames that the vehicle did not receive", @status},
         {:errors, 0, nil, "communication errors", @status},
         {:ekf, 3, nil, "the estimator; ratios below 1 are good:", @ekf},
         {[:ekf, :flags], 0, nil, "flags of EKF_STATUS_REPORT or ESTIMATOR_STATUS", @ekf},
         {[:ekf, :velocity], 3, nil, "innovation test ratio of the velocity", @ekf},
         {[:ekf, :position_horizontal], 3, nil, "… of the horizontal position", @ekf},
         {[:ekf, :position_vertical], 3, nil, "… of the height", @ekf},
         {[:ekf, :compass], 3, nil, "… of the compass", @ekf},
         {[:ekf, :terrain], 3, nil, "… of the height above the ground", @ekf},
         {:vibration, 2, "m/s²", "a list: x, y, z", "VIBRATION"},
         {:clipping, 0, nil, "how often an accelerometer clipped, sum of all", "VIBRATION"}
       ]},
    home:
      {"The home position.",
       [
         {:lat, 7, "°", "latitude", "HOME_POSITION"},
         {:lon, 7, "°", "longitude", "HOME_POSITION"},
         {:alt_msl, 2, "m", "height above mean sea level", "HOME_POSITION"}
       ]},
    mission:
      {"Mission progress and fence.",
       [
         {:seq, 0, nil, "the current item", "MISSION_CURRENT" <> @satellite},
         {:total, 0, nil, "number of items", "MISSION_CURRENT"},
         {:state, nil, nil, "MISSION_STATE", "MISSION_CURRENT"},
         {:reached, 0, nil, "the last item that was reached", "MISSION_ITEM_REACHED"},
         {:wp_distance, 0, "m", "distance to the current item", "NAV_CONTROLLER_OUTPUT" <> @satellite},
         {:fence_breach, nil, nil, "true while the vehicle breaches its fence", "FENCE_STATUS" <> @satellite},
         {:fence_breach_type, nil, nil, "FENCE_BREACH", "FENCE_STATUS"}
       ]},
    rc:
      {"The remote control.",
       [
         {:channels, 0, "µs", "a list of pulse widths, null for an unused channel",
          "RC_CHANNELS, RC_CHANNELS_RAW"},
         {:rssi, 2, "0..1", "signal strength; PX4 sends percent, others 0 to 254",
          "RC_CHANNELS, RC_CHANNELS_RAW"}
       ]},
    operator:
      {"Who is in charge of the vehicle.",
       [
         {:name, nil, nil, "who alone commands it through the gateway; null for nobody", "`take_control`"},
         {:via, nil, nil, "by which way: nats, rest, elixir, mavlink", "`take_control`"},
         {:since, nil, nil, "since when", "`take_control`"},
         {:reason, nil, nil, "why it was taken over", "`take_control`"},
         {:offered_to, nil, nil, "who may take it without a reason; `*` for anybody", "`hand_over_control`"},
         {:system, 0, nil, "the ground station in control as the vehicle tells; 0 for none",
          "CONTROL_STATUS"},
         {:takeover_allowed, nil, nil, "whether the vehicle gives control to whoever asks", "CONTROL_STATUS"}
       ]},
    link:
      {"How the vehicle is heard.",
       [
         {:status, nil, nil, "online, stale, lost", "all frames of the autopilot"},
         {:frames_per_s, 1, "1/s", "received frames", "all frames of the vehicle"},
         {:bytes_per_s, 0, "B/s", "received bytes", "all frames of the vehicle"},
         {:links, nil, nil, "a list of the links that hear the vehicle, the latest first",
          "all frames of the vehicle"}
       ]}
  ]

  all =
    for {group, {title, fields}} <- table do
      {group, title,
       for {path, decimals, unit, meaning, source} <- fields do
         %{path: List.wrap(path), decimals: decimals, unit: unit, meaning: meaning, source: source}
       end}
    end

  # By atoms and strings, because the position in an event has string keys.
  decimals =
    for {group, _title, fields} <- all, into: %{} do
      named = for %{path: path, decimals: n} when n != nil <- fields, do: {List.last(path), n}
      {group, Map.new(named ++ Enum.map(named, fn {name, n} -> {Atom.to_string(name), n} end))}
    end

  @all all
  @keys for {group, _title, fields} <- all, do: {group, for(%{path: [name]} <- fields, do: name)}
  @decimals Map.merge(decimals, Map.new(decimals, fn {group, names} -> {Atom.to_string(group), names} end))

  # Seconds, volts and ratios have two decimals; a number without a unit is as the vehicle sent it.
  @event (for %{fields: fields} <- Event.Types.all(),
              %{name: name, unit: unit} when unit in ["s", "0..1", "V"] <- fields,
              into: %{} do
            {name, 2}
          end)

  @doc "All groups with a title and their fields, in the order of the documentation."
  @spec all() :: [{group(), String.t(), [t()]}]
  def all, do: @all

  @doc "The groups and the keys of their data."
  @spec keys() :: [{group(), [atom()]}]
  def keys, do: @keys

  @doc "A group's data with rounded numbers. The group is an atom or a string."
  @spec rounded(group() | String.t(), map()) :: map()
  def rounded(group, data), do: Round.object(data, Map.get(@decimals, group, %{}))

  @doc "An event's data with rounded numbers."
  @spec event(map()) :: map()
  def event(%{"position" => %{} = position} = data),
    do: %{Round.object(data, @event) | "position" => rounded(:position, position)}

  def event(data), do: Round.object(data, @event)
end
