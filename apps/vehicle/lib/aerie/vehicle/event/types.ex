defmodule Aerie.Vehicle.Event.Types do
  @moduledoc """
  All event types of a vehicle, one a row: when each occurs, what shows it, the fields of its data, how severe it is, the text
  that people read, and the alarm that it begins or ends. `docs/telemetry.md` (`mix aerie.telemetry`), NATS and the console are
  made from it. A new event is a row here and a step of a detector (`Aerie.Vehicle.Events.Detector`).

  Any field may be null if nothing is known. An event that the vehicle's state shows may also have `position`: where the vehicle
  was then.
  """

  @typedoc "A field of an event's data; `unit` is nil for a field without one."
  @type field :: %{
          name: String.t(),
          type: :string | :number | :integer | :boolean | :list | :object | :any,
          unit: String.t() | nil,
          meaning: String.t()
        }
  @typedoc """
    * `severity` - MAV_SEVERITY, 6 (information) if the row has none; `:data`: its data has a `severity`
    * `text` - its text for people. `{name}` is a value of its data, `({name})` the same with spaces for underscores; what is in
      square brackets is left out if that value is not known. nil: the type and its data
    * `begins` - the alarm that it raises: it holds as long as the detector has the condition
      (`t:Aerie.Vehicle.Events.Detector.condition/0`), so that a lost end leaves no alarm. `over`: what else
      ends it; `mend`: what to do while it holds
    * `ends` - the alarm whose end it tells; `:all`: it tells the end of all
  """
  @type t :: %{
          type: String.t(),
          when: String.t(),
          source: String.t(),
          fields: [field()],
          severity: 0..7 | :data,
          text: String.t() | nil,
          begins: {kind :: atom(), :warning | :critical, text :: String.t()} | nil,
          over: String.t() | nil,
          mend: String.t() | nil,
          ends: atom()
        }

  @mode {"mode", :string, nil, "the mode at that time"}
  @text {"text", :string, nil, "the vehicle's text"}
  @lasted {"duration", :number, "s", "how long it was lost"}
  @found [
    {"found", :boolean, nil,
     "true: it happened while the gateway was not running, and was noticed afterwards"},
    {"since", :string, nil, "with `found`: the last time at which the old value was known to hold"}
  ]
  @battery [
    {"battery", :integer, nil, "id of the battery; null if the message does not say"},
    {"remaining", :number, "0..1", "remaining charge"},
    {"voltage", :number, "V", "voltage, from the same message"},
    {"charge_state", :string, nil, "MAV_BATTERY_CHARGE_STATE"}
  ]
  @signing [
    {"link", :string, nil, "the link"},
    {"component", :integer, nil, "the vehicle's component"},
    {"by", :string, nil, "who asked for it"}
  ]
  @failsafe_types "`rc`, `gcs`, `battery`, `fence`, `gps`, `position`, `ekf`, `offboard`, `terrain`, `vibration`, `leak`, `crash`, `unknown`"

  table = [
    {"armed", "the vehicle is armed", "HEARTBEAT; for the reason: PX4's report commander_armed_by, texts",
     [
       @mode,
       {"reason", :string, nil, "who or what armed it, if the vehicle says so: command_external, rc_switch …"}
       | @found
     ], severity: 5, text: "armed[ ({reason})]"},
    {"disarmed", "the vehicle is disarmed", "as `armed`",
     [
       @mode,
       {"reason", :string, nil,
        "who or what disarmed it, if the vehicle says so: landing, kill_switch, command_external …"}
       | @found
     ], severity: 5, text: "disarmed[ ({reason})]"},
    {"mode_change", "the flight mode changes, whatever the cause", "HEARTBEAT, HIGH_LATENCY2",
     [{"from", :string, nil, "the old mode"}, {"to", :string, nil, "the new mode"} | @found],
     severity: 5, text: "mode {from} → {to}"},
    {"takeoff", "the vehicle leaves the ground",
     "EXTENDED_SYS_STATE; without it ArduPilot's system status, or the height", [@mode | @found],
     severity: 5, text: "took off"},
    {"landed", "the vehicle is on the ground again; not one that was disarmed in the air, which falls",
     "as `takeoff`", [@mode | @found], severity: 5, text: "landed"},
    {"failsafe", "a failsafe begins, or is active when the vehicle is first heard",
     "whichever comes first: system status (HEARTBEAT), a status text, a report (EVENT), a mode that only the vehicle itself chooses, a broken fence with a change of the mode",
     [
       {"type", :string, nil, "what it is about: " <> @failsafe_types},
       {"reason", :string, nil,
        "the cause as precisely as the vehicle says it, such as critical_battery_level; otherwise the type"},
       {"action", :string, nil,
        "what the vehicle does: rtl, land, descend, hold …; none if the mode stays the same"},
       {"delay", :number, "s", "how long the vehicle waits before it acts, if it says so"},
       {"text", :string, nil, "the text that reported it"},
       {"report", :string, nil, "name of the report (EVENT) that reported it"},
       @mode,
       {"system_status", :string, nil, "MAV_STATE at that time"},
       {"found", :boolean, nil, "true: it was active when the vehicle was first heard"}
     ],
     severity: 2,
     begins: {:failsafe, :critical, "Failsafe"},
     mend: "Let it finish what it does by itself, and clear its way; take over only if that is worse.",
     over: "normal system status; if that never showed it, disarming and arming"},
    {"failsafe.cleared", "a failsafe is over",
     "system status, a text (… Cleared), a report, the end of a breach; disarming, if the system status never showed the failsafe",
     [
       {"type", :string, nil, "type of the failsafe"},
       {"reason", :string, nil, "reason of the failsafe"},
       {"duration", :number, "s", "how long it was active"},
       {"by", :string, nil, "what shows the end: status, text, report, fence, disarmed, reboot"}
     ], severity: 5, ends: :failsafe},
    {"geofence", "the vehicle breaches a fence",
     "FENCE_STATUS, PX4's checks (EVENT); a text if neither comes",
     [
       {"breach", :string, nil, "FENCE_BREACH; for PX4 MAX_HOR_DIST, MAX_ALT, CUSTOM_GF"},
       @text
     ],
     severity: 3,
     text: "outside the fence[ ({breach})][ ({text})]",
     begins: {:fence, :critical, "Fence breached"},
     mend: "Bring it back inside, or let it return.",
     over: "a fence that is whole or off; if only a text told of it, disarming"},
    {"geofence.cleared", "the vehicle is inside its fence again, or the fence is disabled",
     "as `geofence`, but never a text; the parameter FENCE_ENABLE",
     [
       {"breach", :string, nil, "as in `geofence`"},
       {"duration", :number, "s", "how long the breach lasted"}
     ], severity: 5, text: "inside the fence again, or the fence is off", ends: :fence},
    {"battery.low", "a battery is low",
     "BATTERY_STATUS of each battery; without it SYS_STATUS and HIGH_LATENCY2; with the thresholds of the configuration",
     @battery,
     severity: 4,
     text: "battery low",
     begins: {:battery, :warning, "Battery low"},
     mend: "Let it return while the charge lasts.",
     over: "a charge 5 % above the threshold, or a battery that is not there any more"},
    {"battery.critical", "a battery is nearly empty", "as `battery.low`", @battery,
     severity: 2,
     text: "battery critical",
     begins: {:battery, :critical, "Battery nearly empty"},
     mend: "Land it now, or let it return if home is near.",
     over: "as for `battery.low`"},
    {"battery.recovered", "a battery that was low or critical is better: charged, changed or taken out",
     "as `battery.low`; 5 % above the threshold, or no BATTERY_STATUS of it while those of others come",
     @battery ++
       [
         {"level", :string, nil, "what it is now: ok, low (was critical), gone"},
         {"duration", :number, "s", "how long it was low or critical"}
       ], severity: 5, text: "battery recovered[ ({level})]", ends: :battery},
    {"rc.lost", "the remote control is lost", "reports, texts, and the receiver's health in SYS_STATUS",
     [@text],
     severity: 3,
     text: "remote control lost",
     begins: {:rc, :warning, "Remote control lost"},
     mend: "Be ready for its failsafe. Check the transmitter and its distance.",
     over: "a healthy receiver in SYS_STATUS"},
    {"rc.restored", "the remote control is back", "as `rc.lost`", [@text, @lasted],
     text: "remote control restored", ends: :rc},
    {"gps.lost", "an armed vehicle loses its GNSS position", "GPS_RAW_INT: a fix of 3 or more becomes less",
     [{"fix_name", :string, nil, "the present GPS_FIX_TYPE"}],
     severity: 3,
     text: "GNSS position lost[ ({fix_name})]",
     begins: {:gps, :critical, "GNSS position lost"},
     mend: "Have its pilot take over in a mode without a position, or land it.",
     over: "a fix; disarming"},
    {"gps.restored", "the GNSS position is back", "GPS_RAW_INT", [@lasted],
     text: "GNSS position restored", ends: :gps},
    {"position.lost", "in the air, the estimator loses the position",
     "EKF_STATUS_REPORT, ESTIMATOR_STATUS: neither an absolute nor a relative horizontal position", [],
     severity: 2,
     text: "position estimate lost",
     begins: {:position, :critical, "Position estimate lost"},
     mend: "Have its pilot take over in a mode without a position, or land it.",
     over: "a position; landing"},
    {"position.restored", "the estimator knows the position again", "as `position.lost`", [@lasted],
     text: "position estimate restored", ends: :position},
    {"kill_switch.engaged", "the kill switch stops the motors", "PX4's reports, texts of both firmwares",
     [@text],
     severity: 1,
     text: "kill switch engaged",
     begins: {:kill_switch, :critical, "Kill switch engaged"},
     mend: "Keep away from it: it falls, or may start again when the switch is released.",
     over: "arming, take-off; the end of PX4's system status FLIGHT_TERMINATION"},
    {"kill_switch.released", "the kill switch is released", "as `kill_switch.engaged`", [@text],
     text: "kill switch released", ends: :kill_switch},
    {"link.lost", "the vehicle was not heard for timeouts.vehicle_lost_s", "silence",
     [
       {"silent_s", :number, "s", "how long it was silent"},
       {"found", :boolean, nil, "true: it was heard before the gateway was started, and not since"},
       {"since", :string, nil, "with `found`: the last time at which it was not lost"}
     ], severity: 3, text: "contact lost"},
    {"link.restored", "a lost vehicle is heard again", "any frame of its autopilot", [],
     severity: 5, text: "contact restored"},
    {"reboot", "the vehicle was restarted", "`time_boot_ms` starts again",
     [{"time_boot_ms", :integer, "ms", "the vehicle's clock"}],
     severity: 4, text: "the vehicle restarted", ends: :all},
    {"collision", "two vehicles use one system id",
     "boot times, positions, types or unique ids that alternate; or somebody else who sends under the id",
     [
       {"sign", :string, nil,
        "what alternates: time_boot_ms, position, type, uid; claim: others send under its id"},
       {"links", :list, nil,
        "two lists: the links of the vehicle that keeps the id, and those of the other one"}
     ], severity: 2, text: "two vehicles use this system id"},
    {"statustext", "the vehicle or a part of it sends a text", "STATUSTEXT",
     [
       {"severity", :integer, nil, "0 emergency to 7 debug"},
       {"severity_name", :string, nil, "MAV_SEVERITY"},
       {"text", :string, nil, "the whole text"},
       {"component", :integer, nil,
        "the part of the vehicle that sent it (100 camera, 191 companion …), if not the autopilot"}
     ], severity: :data},
    {"report", "the vehicle sends a report that is not also a text", "EVENT",
     [
       {"id", :string, nil, "id of the report, hexadecimal"},
       {"name", :string, nil, "name of the report"},
       {"severity", :integer, nil, "level for users, 0 emergency to 7 debug"},
       {"severity_name", :string, nil, "MAV_SEVERITY"},
       {"internal_severity", :integer, nil, "level for the log"},
       {"arguments", :string, nil, "the bytes of the arguments, hexadecimal"},
       {"values", :list, nil,
        "the arguments, if their layout is known: numbers, enum labels, lists of labels"},
       {"component", :integer, nil, "the component that sent it"},
       {"sequence", :integer, nil, "its number there; a component's reports come in this order"},
       {"late_s", :number, "s",
        "how long after it happened (the event's time) it was received, if that is more than two seconds"}
     ], severity: :data},
    {"events.suppressed", "more events of a type occurred than are published",
     "`Aerie.Vehicle.Events.Detector.Budget`: of each type 60 at once and two a second, texts by their urgency",
     [
       {"of", :string, nil, "the type"},
       {"count", :integer, nil, "how many were suppressed"},
       {"first", :string, nil, "time of the first one"},
       {"last", :string, nil, "time of the last one"},
       {"last_data", :object, nil, "data of the last one: what is true now"},
       {"text", :string, nil, "a summary: 440 more texts"}
     ], severity: 4},
    {"param_changed", "a parameter has a new value", "PARAM_VALUE",
     [
       {"name", :string, nil, "the parameter"},
       {"from", :any, nil, "the old value"},
       {"to", :any, nil, "the new value"},
       {"index", :integer, nil, "index in the parameter list"}
     ], text: "{name}: {from} → {to}"},
    {"system_id.changed", "the vehicle has a new system id, so it counts as another vehicle",
     "PARAM_SET of SYSID_THISMAV, MAV_SYSID or MAV_SYS_ID, and the vehicle that is heard next; at both vehicles",
     [
       {"from", :string, nil, "the vehicle with the old id"},
       {"to", :string, nil, "the vehicle with the new id"},
       {"system", :integer, nil, "the new system id"}
     ], severity: 4, text: "system id changed: {from} is {to} now"},
    {"mission.reached", "the vehicle reaches a mission item", "MISSION_ITEM_REACHED",
     [
       {"seq", :integer, nil, "number of the item"},
       {"total", :integer, nil, "number of items"}
     ], text: "item {seq}[ of {total}] reached"},
    {"mission.completed", "the mission is over", "MISSION_CURRENT, a text, or inferred",
     [
       {"seq", :integer, nil, "number of the last item"},
       {"total", :integer, nil, "number of items"},
       {"before", :string, nil, "the MISSION_STATE before"},
       @text,
       {"inferred", :boolean, nil,
        "true: the vehicle did not say so, but landed and disarmed at its last item"}
     ], severity: 5, text: "mission completed"},
    {"gcs_failsafe", "the vehicle reports that it lost its ground station",
     "PX4's report commander_gcs_lost, a text",
     [@text, {"report", :string, nil, "name of the report (EVENT)"}],
     severity: 4, text: "the vehicle lost its ground station"},
    {"gcs.lost", "the ground station that the vehicle's failsafe listens to falls silent",
     "heartbeats on the vehicle's network, and the vehicle's parameters",
     [
       {"system", :integer, nil, "system id of the ground station"},
       {"timeout_s", :number, "s", "the silence after which the failsafe acts"},
       {"failsafe_enabled", :boolean, nil, "whether the failsafe is enabled"}
     ],
     severity: 4,
     text: "ground station[ {system}] lost",
     begins: {:gcs, :warning, "Ground station lost"},
     mend: "Start the ground station again, or be ready for the vehicle's failsafe.",
     over: "any heartbeat that the failsafe listens to, also the first after a restart"},
    {"gcs.restored", "that ground station is heard again", "as `gcs.lost`",
     [{"system", :integer, nil, "system id of the ground station"}],
     text: "ground station[ {system}] restored", ends: :gcs},
    {"stream.contested", "the message rates that a vehicle reports are not those that the gateway asked for",
     "measured rates, MESSAGE_INTERVAL",
     [
       {"messages", :list, nil,
        "for each message: id, name, asked_hz, found_hz, yielded (whether the gateway leaves the rate to the other program)"}
     ], severity: 4, text: "message rates differ from what was asked"},
    {"displaced", "a lost vehicle makes room for another one", "limits.max_vehicles",
     [
       {"by", :string, nil, "the vehicle that takes its place"},
       {"lost_s", :number, "s", "how long it was lost"}
     ], text: "removed to make room for {by}"},
    {"gateway.started", "a gateway starts; `vehicle` is the gateway's name",
     "the start, and what was stored on disk before it",
     [
       {"version", :string, nil, "version of the gateway"},
       {"previous_epoch", :integer, nil, "the epoch before, null if unknown"},
       {"ended", :string, nil, "how the gateway ended before: orderly, killed"},
       {"vehicles", :list, nil,
        "the vehicles whose state was stored; changes since then are published when they are heard"}
     ], text: "the gateway started"},
    {"operator.changed", "another one is in charge of the vehicle, or nobody any more",
     "`take_control`, `release_control`",
     [
       {"operator", :string, nil, "who alone commands the vehicle through the gateway; null for nobody"},
       {"before", :string, nil, "who was in charge before"},
       {"via", :string, nil, "the way that it was taken: nats, rest, elixir, mavlink"},
       {"reason", :string, nil, "why it was taken over"}
     ], []},
    {"signing.rejected", "frames of the vehicle are rejected", "signatures",
     [
       {"link", :string, nil, "the link that they came by"},
       {"component", :integer, nil, "the component that sent them"},
       {"reasons", :object, nil, "how many for each reason"}
     ], severity: 3, text: "frames without a valid signature rejected[ on {link}]"},
    {"signing.clock", "the vehicle signs with a time that is more than an hour ahead of the gateway's",
     "signatures",
     [
       {"link", :string, nil, "the link that it came by"},
       {"component", :integer, nil, "the component that signs"},
       {"ahead_s", :number, "s", "how far it is ahead"},
       {"ahead", :string, nil, "the same in words"}
     ], severity: 4, text: "signing clock[ {ahead}] ahead of the gateway's[ on {link}]"},
    {"signing.enrolled", "the vehicle was given its signing key", "an operator's request", @signing,
     text: "signing key set[ by {by}]"},
    {"signing.revoked", "the vehicle's signing key was removed", "an operator's request", @signing,
     text: "signing key removed[ by {by}]"},
    {"signing.failed", "the vehicle's signing key could not be set or removed", "an operator's request",
     [
       {"what", :string, nil, "enrolled or revoked"},
       {"reason", :string, nil, "why it failed"}
       | @signing
     ], severity: 3, text: "signing key not changed[ ({reason})][ by {by}]"}
  ]

  all =
    for {type, moment, source, fields, options} <- table do
      fields =
        for {name, kind, unit, meaning} <- fields, do: %{name: name, type: kind, unit: unit, meaning: meaning}

      Map.merge(
        %{
          type: type,
          when: moment,
          source: source,
          fields: fields,
          severity: 6,
          text: nil,
          begins: nil,
          over: nil,
          mend: nil,
          ends: nil
        },
        Map.new(options)
      )
    end

  @all all
  @by_name Map.new(all, &{&1.type, &1})
  @names Enum.map(all, & &1.type)

  @doc "All types, in the order of the documentation."
  @spec all() :: [t()]
  def all, do: @all

  @doc "The names of all types."
  @spec names() :: [String.t()]
  def names, do: @names

  @doc "The row of a type; nil for one that this version does not know."
  @spec get(String.t()) :: t() | nil
  def get(type), do: Map.get(@by_name, type)
end
