defmodule Aerie.Vehicle.Fields do
  @moduledoc """
  The vocabulary: every field of a vehicle's state with its unit, its meaning, what it comes from, and how many decimals
  mean something. NATS, REST and `state.sock` have these names and units, and round by this table when they render
  (`rounded/2`, `event/1`), never before: what is computed inside stays exact. `docs/telemetry.md` is made from it.

  Units are SI and degrees. A share is 0..1, never per cent; a height says above what.
  """

  alias Aerie.Vehicle.EventTypes
  alias Aerie.Vehicle.Fields.Round

  @typedoc """
  A field. `path` is its name, or the names down to it. `decimals` is for numbers, of which 0 are whole; nil for what is no
  number.
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
      {"Where it is.",
       [
         {:lat, 7, "°", "latitude, WGS 84, north is positive", @global <> @satellite},
         {:lon, 7, "°", "longitude, east is positive", @global <> @satellite},
         {:alt_msl, 2, "m", "height above mean sea level", @global <> @satellite},
         {:alt_rel, 2, "m", "height above home, which is not that above the ground", @global},
         {:heading, 2, "°", "where its nose points, 0..360 from north", @global <> @satellite}
       ]},
    attitude:
      {"How it lies.",
       [
         {:roll, 2, "°", "right side down is positive", "ATTITUDE, ATTITUDE_QUATERNION"},
         {:pitch, 2, "°", "nose up is positive", "ATTITUDE, ATTITUDE_QUATERNION"},
         {:yaw, 2, "°", "-180..180 from north", "ATTITUDE, ATTITUDE_QUATERNION"},
         {:rollspeed, 2, "°/s", "body rate", "ATTITUDE, ATTITUDE_QUATERNION"},
         {:pitchspeed, 2, "°/s", "body rate", "ATTITUDE, ATTITUDE_QUATERNION"},
         {:yawspeed, 2, "°/s", "body rate", "ATTITUDE, ATTITUDE_QUATERNION"}
       ]},
    velocity:
      {"How it moves.",
       [
         {:vn, 2, "m/s", "to the north", @global <> ", LOCAL_POSITION_NED"},
         {:ve, 2, "m/s", "to the east", @global <> ", LOCAL_POSITION_NED"},
         {:vd, 2, "m/s", "down", @global <> ", LOCAL_POSITION_NED"},
         {:groundspeed, 2, "m/s", "over the ground", @hud <> @satellite},
         {:airspeed, 2, "m/s", "through the air", @hud <> @satellite},
         {:climb, 2, "m/s", "up", @hud <> @satellite},
         {:throttle, 2, "0..1", "share of full throttle", @hud <> @satellite}
       ]},
    battery:
      {"The battery with the lowest id, and each of them. Without BATTERY_STATUS the values are those of SYS_STATUS.",
       [
         {:id, 0, nil, "whose values these are; null where the message does not say", @battery},
         {:voltage, 2, "V", "voltage", @status <> ", " <> @battery},
         {:current, 2, "A", "current out of it", @status <> ", " <> @battery},
         {:remaining, 2, "0..1", "share of its charge that is left",
          @status <> ", " <> @battery <> @satellite},
         {:consumed_mah, 0, "mAh", "charge taken out of it", @battery},
         {:charge_state, nil, nil, "MAV_BATTERY_CHARGE_STATE, the worst of all batteries", @battery},
         {:batteries, nil, nil, "a list of all, each with the fields above and these:", @battery},
         {[:batteries, :id], 0, nil, "its id", @battery},
         {[:batteries, :temperature], 1, "°C", "its temperature", @battery}
       ]},
    gps:
      {"The first receiver.",
       [
         {:fix, 0, nil, "GPS_FIX_TYPE as a number; 3 and more is a position with height", @gps},
         {:fix_name, nil, nil, "GPS_FIX_TYPE: NO_GPS, 2D_FIX, 3D_FIX, RTK_FIXED …", @gps},
         {:satellites, 0, nil, "satellites in view", @gps},
         {:hdop, 2, nil, "horizontal dilution of precision", @gps},
         {:vdop, 2, nil, "vertical dilution of precision", @gps},
         {:lat, 7, "°", "latitude as the receiver says it", @gps <> @satellite},
         {:lon, 7, "°", "longitude as the receiver says it", @gps <> @satellite},
         {:alt_msl, 2, "m", "height above mean sea level as the receiver says it", @gps <> @satellite},
         {:h_acc, 2, "m", "horizontal uncertainty", @gps <> @satellite},
         {:v_acc, 2, "m", "vertical uncertainty", @gps <> @satellite}
       ]},
    mode:
      {"What it is doing.",
       [
         {:mode, nil, nil, "flight mode by its name, which depends on firmware and type",
          "HEARTBEAT" <> @satellite},
         {:custom_mode, 0, nil, "the firmware's number for it", "HEARTBEAT" <> @satellite},
         {:armed, nil, nil, "true while its motors may turn", "HEARTBEAT, HIGH_LATENCY2 (ArduPilot)"},
         {:in_air, nil, nil, "true while it flies", "EXTENDED_SYS_STATE, HEARTBEAT, else height and speed"},
         {:landed_state, nil, nil, "MAV_LANDED_STATE", "EXTENDED_SYS_STATE"},
         {:vtol_state, nil, nil, "MAV_VTOL_STATE", "EXTENDED_SYS_STATE"},
         {:system_status, nil, nil, "MAV_STATE", "HEARTBEAT"},
         {:failsafe, nil, nil, "true while its state is critical or an emergency", "HEARTBEAT"}
       ]},
    health:
      {"How well it is.",
       [
         {:load, 3, "0..1", "share of its processor that is used", @status},
         {:unhealthy, nil, nil, "a list of sensors and functions that are there, in use, and not well",
          @status <> @satellite},
         {:ready_to_arm, nil, nil, "whether its checks let it be armed", @status},
         {:arming_checks, nil, nil, "PX4: which checks keep it from what", "EVENT"},
         {:rc_receiver, nil, nil, "whether its remote control receiver is heard", @status},
         {:drop_rate, 4, "0..1", "share of the frames to it that it lost", @status},
         {:errors, 0, nil, "errors of its communication", @status},
         {:ekf, 3, nil, "the estimator; below 1 is good:", @ekf},
         {[:ekf, :flags], 0, nil, "its flags", @ekf},
         {[:ekf, :velocity], 3, nil, "innovation test ratio of the velocity", @ekf},
         {[:ekf, :position_horizontal], 3, nil, "… of the horizontal position", @ekf},
         {[:ekf, :position_vertical], 3, nil, "… of the height", @ekf},
         {[:ekf, :compass], 3, nil, "… of the compass", @ekf},
         {[:ekf, :terrain], 3, nil, "… of the height above the ground", @ekf},
         {:vibration, 2, "m/s²", "a list: x, y, z", "VIBRATION"},
         {:clipping, 0, nil, "how often an accelerometer was at its limit, all together", "VIBRATION"}
       ]},
    home:
      {"Where it returns to.",
       [
         {:lat, 7, "°", "latitude", "HOME_POSITION"},
         {:lon, 7, "°", "longitude", "HOME_POSITION"},
         {:alt_msl, 2, "m", "height above mean sea level", "HOME_POSITION"}
       ]},
    mission:
      {"Its plan and its fence.",
       [
         {:seq, 0, nil, "the item that it is on its way to", "MISSION_CURRENT" <> @satellite},
         {:total, 0, nil, "how many items there are", "MISSION_CURRENT"},
         {:state, nil, nil, "MISSION_STATE", "MISSION_CURRENT"},
         {:reached, 0, nil, "the last item that it reached", "MISSION_ITEM_REACHED"},
         {:wp_distance, 0, "m", "how far the item is", "NAV_CONTROLLER_OUTPUT" <> @satellite},
         {:fence_breach, nil, nil, "true while it is outside its fence", "FENCE_STATUS" <> @satellite},
         {:fence_breach_type, nil, nil, "FENCE_BREACH", "FENCE_STATUS"}
       ]},
    rc:
      {"The pilot's remote control.",
       [
         {:channels, 0, "µs", "a list of pulse widths, null for one that is not used",
          "RC_CHANNELS, RC_CHANNELS_RAW"},
         {:rssi, 2, "0..1", "strength of its signal", "RC_CHANNELS, RC_CHANNELS_RAW"}
       ]},
    link:
      {"How it is heard.",
       [
         {:status, nil, nil, "online, stale, lost", "all frames of its autopilot"},
         {:frames_per_s, 1, "1/s", "frames of it that come", "all its frames"},
         {:bytes_per_s, 0, "B/s", "bytes of it that come", "all its frames"},
         {:links, nil, nil, "a list of the links that it is heard on, the latest first", "all its frames"}
       ]}
  ]

  all =
    for {group, {title, fields}} <- table do
      {group, title,
       for {path, decimals, unit, meaning, source} <- fields do
         %{path: List.wrap(path), decimals: decimals, unit: unit, meaning: meaning, source: source}
       end}
    end

  # By names of both kinds, because events have their position in text already.
  decimals =
    for {group, _title, fields} <- all, into: %{} do
      named = for %{path: path, decimals: n} when n != nil <- fields, do: {List.last(path), n}
      {group, Map.new(named ++ Enum.map(named, fn {name, n} -> {Atom.to_string(name), n} end))}
    end

  @all all
  @keys for {group, _title, fields} <- all, do: {group, for(%{path: [name]} <- fields, do: name)}
  @decimals Map.merge(decimals, Map.new(decimals, fn {group, names} -> {Atom.to_string(group), names} end))

  # Seconds and volts to hundredths, shares to per cent; a number without a unit is what the vehicle said.
  @event (for %{fields: fields} <- EventTypes.all(),
              %{name: name, unit: unit} when unit in ["s", "0..1", "V"] <- fields,
              into: %{} do
            {name, 2}
          end)

  @doc "All groups with a title and their fields, in an order for people."
  @spec all() :: [{group(), String.t(), [t()]}]
  def all, do: @all

  @doc "The groups and the keys of their data."
  @spec keys() :: [{group(), [atom()]}]
  def keys, do: @keys

  @doc "A group's data as it is shown: numbers to the decimals that mean something. The group by either kind of name."
  @spec rounded(group() | String.t(), map()) :: map()
  def rounded(group, data), do: Round.object(data, Map.get(@decimals, group, %{}))

  @doc "An event's data as it is shown."
  @spec event(map()) :: map()
  def event(%{"position" => %{} = position} = data),
    do: %{Round.object(data, @event) | "position" => rounded(:position, position)}

  def event(data), do: Round.object(data, @event)
end
