defmodule Aerie.Vehicle.EventTypes do
  @moduledoc """
  All types of events of a vehicle, as a table: when each comes, what shows it, and the fields of its data with unit and
  meaning. `Aerie.Vehicle.Event.types/0` and the documentation of what goes to the fleet are made from it.

  Any field may be null where nothing is known. `position` may be in the data of each type that the vehicle's state
  shows: where it was then.
  """

  @typedoc "A field of an event's data; `unit` is nil for what has none."
  @type field :: %{
          name: String.t(),
          type: :string | :number | :integer | :boolean | :list | :object | :any,
          unit: String.t() | nil,
          meaning: String.t()
        }
  @type t :: %{type: String.t(), when: String.t(), source: String.t(), fields: [field()]}

  @mode {"mode", :string, nil, "its mode then"}
  @text {"text", :string, nil, "what the vehicle said"}
  @found [
    {"found", :boolean, nil,
     "true: it happened while the gateway was not there, and was found when it came back"},
    {"since", :string, nil, "of what was found: when the former value still held"}
  ]
  @failsafe_types "`rc`, `gcs`, `battery`, `fence`, `gps`, `position`, `ekf`, `offboard`, `terrain`, `vibration`, `leak`, `crash`, `unknown`"

  table = [
    {"armed", "the vehicle is armed", "HEARTBEAT; PX4: the report commander_armed_by for the reason",
     [
       @mode,
       {"reason", :string, nil,
        "who or what armed it, where the vehicle says so: command_external, rc_switch …"}
       | @found
     ]},
    {"disarmed", "it is disarmed", "as armed",
     [
       @mode,
       {"reason", :string, nil, "as of armed: landing, kill_switch, command_external …"}
       | @found
     ]},
    {"mode_change", "its mode changes, by whomever", "HEARTBEAT, HIGH_LATENCY2",
     [{"from", :string, nil, "the mode before"}, {"to", :string, nil, "the mode now"} | @found]},
    {"takeoff", "it leaves the ground",
     "EXTENDED_SYS_STATE; without it ArduPilot's system status, or its height", [@mode | @found]},
    {"landed", "it is back on the ground", "as takeoff", [@mode | @found]},
    {"failsafe", "the vehicle takes measures of its own, or is found doing so",
     "whichever is first: system status (HEARTBEAT), a status text, a report (EVENT), a mode that only the vehicle chooses",
     [
       {"type", :string, nil, "what it is about: " <> @failsafe_types},
       {"reason", :string, nil,
        "why, as precisely as the vehicle says: critical_battery_level; else as type"},
       {"action", :string, nil,
        "what the vehicle does: rtl, land, descend, hold …; or the mode that it changed to"},
       {"delay", :number, "s", "for how long it waits before it does so, where it says that"},
       {"text", :string, nil, "the text that said it"},
       {"report", :string, nil, "the name of the report that said it"},
       @mode,
       {"system_status", :string, nil, "MAV_STATE then"},
       {"found", :boolean, nil, "true: it was in it when the gateway first heard of it"}
     ]},
    {"failsafe.cleared", "a failsafe is over",
     "system status, a text (… Cleared), a report; disarming where the system status never showed it",
     [
       {"type", :string, nil, "that of the failsafe"},
       {"reason", :string, nil, "that of the failsafe"},
       {"duration", :number, "s", "how long it lasted"},
       {"by", :string, nil, "what shows the end: status, text, report, disarmed, reboot"}
     ]},
    {"geofence", "a fence is broken", "FENCE_STATUS, PX4's checks (EVENT); a text where neither comes",
     [
       {"breach", :string, nil, "FENCE_BREACH, or of PX4 MAX_HOR_DIST, MAX_ALT, CUSTOM_GF"},
       @text
     ]},
    {"geofence.cleared", "it is back within its fence, or the fence is switched off",
     "as geofence, but never a text; the parameter FENCE_ENABLE",
     [
       {"breach", :string, nil, "that of the geofence event"},
       {"duration", :number, "s", "how long it was outside"}
     ]},
    {"battery.low", "a battery is low",
     "BATTERY_STATUS of each battery, SYS_STATUS and HIGH_LATENCY2 where none comes, with the thresholds of the configuration",
     [
       {"battery", :integer, nil, "its id; null where the message does not say"},
       {"remaining", :number, "0..1", "what is left, by the same message"},
       {"voltage", :number, "V", "its voltage, by the same message"},
       {"charge_state", :string, nil, "MAV_BATTERY_CHARGE_STATE"}
     ]},
    {"battery.critical", "a battery is nearly empty", "as battery.low",
     [
       {"battery", :integer, nil, "its id; null where the message does not say"},
       {"remaining", :number, "0..1", "what is left, by the same message"},
       {"voltage", :number, "V", "its voltage, by the same message"},
       {"charge_state", :string, nil, "MAV_BATTERY_CHARGE_STATE"}
     ]},
    {"rc.lost", "the pilot's remote control is lost",
     "reports and texts that say so, SYS_STATUS's receiver that was healthy", [@text]},
    {"rc.restored", "it is there again", "as rc.lost",
     [@text, {"duration", :number, "s", "for how long it was gone"}]},
    {"gps.lost", "an armed vehicle has no position by GNSS any more",
     "GPS_RAW_INT: a fix of 3 or more becomes less",
     [
       {"fix_name", :string, nil, "GPS_FIX_TYPE now"}
     ]},
    {"gps.restored", "it has one again", "GPS_RAW_INT",
     [
       {"duration", :number, "s", "for how long it was gone"}
     ]},
    {"position.lost", "in the air, its estimator does not know where it is any more",
     "EKF_STATUS_REPORT, ESTIMATOR_STATUS: neither an absolute nor a relative horizontal position", []},
    {"position.restored", "it knows again", "as position.lost",
     [
       {"duration", :number, "s", "for how long it did not know"}
     ]},
    {"kill_switch.engaged", "its motors are stopped by the kill switch", "PX4's reports, texts of both",
     [@text]},
    {"kill_switch.released", "they are not any more", "as kill_switch.engaged", [@text]},
    {"link.lost", "nothing of the vehicle was heard for timeouts.vehicle_lost_s", "silence",
     [
       {"silent_s", :number, "s", "for how long"},
       {"found", :boolean, nil, "true: it was heard before the gateway was started, and not since"},
       {"since", :string, nil, "of what was found: when it still was not lost"}
     ]},
    {"link.restored", "it is heard again", "any frame of its autopilot", []},
    {"reboot", "its clock began anew", "time_boot_ms", [{"time_boot_ms", :integer, "ms", "its clock"}]},
    {"collision", "two vehicles use one id", "boot times, places, types or unique ids that take turns",
     [
       {"sign", :string, nil, "by what it was found out: time_boot_ms, position, type, uid"},
       {"links", :list, nil, "the links of the one that keeps the id, and those of the other"}
     ]},
    {"statustext", "the vehicle says something", "STATUSTEXT",
     [
       {"severity", :integer, nil, "0 emergency to 7 debug"},
       {"severity_name", :string, nil, "MAV_SEVERITY"},
       {"text", :string, nil, "the whole text"}
     ]},
    {"report", "the vehicle reports something that no text says too", "EVENT",
     [
       {"id", :string, nil, "the event's id, hexadecimal"},
       {"name", :string, nil, "its name"},
       {"severity", :integer, nil, "level for people, 0 emergency to 7 debug"},
       {"severity_name", :string, nil, "MAV_SEVERITY"},
       {"internal_severity", :integer, nil, "level for the log"},
       {"arguments", :string, nil, "as they came, hexadecimal"},
       {"values", :list, nil,
        "what they mean, where that is known: numbers, labels of enums, lists of labels"},
       {"component", :integer, nil, "who sent it"},
       {"sequence", :integer, nil, "its number there: a component's reports are told in their order"},
       {"late_s", :number, "s",
        "how long after it happened (the event's time) it was received, where that is more than moments"}
     ]},
    {"events.suppressed", "more events of a type came than its budget allows",
     "`Aerie.Vehicle.Detector.Budget`: 60 at once and two a second of a type, texts by how urgent they are",
     [
       {"of", :string, nil, "the type"},
       {"count", :integer, nil, "how many were not told"},
       {"first", :string, nil, "when the first of them happened"},
       {"last", :string, nil, "when the last one did"},
       {"last_data", :object, nil, "the data of the last one: what is true now"},
       {"text", :string, nil, "how many, in words"}
     ]},
    {"param_changed", "a parameter has another value than before", "PARAM_VALUE",
     [
       {"name", :string, nil, "the parameter"},
       {"from", :any, nil, "its value before"},
       {"to", :any, nil, "its value now"},
       {"index", :integer, nil, "its index in the list"}
     ]},
    {"mission.reached", "an item of the mission is reached", "MISSION_ITEM_REACHED",
     [
       {"seq", :integer, nil, "which item"},
       {"total", :integer, nil, "of how many"}
     ]},
    {"mission.completed", "the mission is over", "MISSION_CURRENT, a text, or inferred",
     [
       {"seq", :integer, nil, "the last item"},
       {"total", :integer, nil, "of how many"},
       {"before", :string, nil, "MISSION_STATE before"},
       @text,
       {"inferred", :boolean, nil,
        "true: the vehicle did not say so; it landed and disarmed at its last item"}
     ]},
    {"gcs_failsafe", "the vehicle misses its ground station and says so",
     "PX4's report commander_gcs_lost, a text", [@text, {"report", :string, nil, "the name of the report"}]},
    {"gcs.lost", "the ground station that the vehicle's failsafe listens to fell silent",
     "heartbeats on the vehicle's network, its parameters",
     [
       {"system", :integer, nil, "that ground station's id"},
       {"timeout_s", :number, "s", "after what silence the vehicle acts"},
       {"failsafe_enabled", :boolean, nil, "whether it does"}
     ]},
    {"gcs.restored", "it is heard again", "as gcs.lost",
     [{"system", :integer, nil, "that ground station's id"}]},
    {"stream.contested", "somebody else sets the rates of streams", "rates measured, MESSAGE_INTERVAL",
     [
       {"messages", :list, nil,
        "of each message: id, name, asked_hz, found_hz, yielded (whether it is left to the other)"}
     ]},
    {"displaced", "a lost vehicle made room for another one", "limits.max_vehicles",
     [
       {"by", :string, nil, "the vehicle that has its place"},
       {"lost_s", :number, "s", "for how long it was lost"}
     ]},
    {"gateway.started", "a gateway begins; `vehicle` is the gateway's name",
     "its start; what its last life left on the disk",
     [
       {"version", :string, nil, "of the gateway"},
       {"previous_epoch", :integer, nil, "the epoch of its last life, null where none is known"},
       {"ended", :string, nil, "how that one ended: orderly, killed"},
       {"vehicles", :list, nil,
        "those whose state was kept: what changed of them is told when they are heard"}
     ]},
    {"signing.rejected", "frames of it are refused", "signatures",
     [
       {"link", :string, nil, "by which link they came"},
       {"component", :integer, nil, "who sent them"},
       {"reasons", :object, nil, "how many for which reason"}
     ]},
    {"signing.enrolled", "it was given its key", "an order of an operator",
     [
       {"link", :string, nil, "by which link"},
       {"component", :integer, nil, "which component"},
       {"by", :string, nil, "who asked for it"}
     ]},
    {"signing.revoked", "its key was taken away", "an order of an operator",
     [
       {"link", :string, nil, "by which link"},
       {"component", :integer, nil, "which component"},
       {"by", :string, nil, "who asked for it"}
     ]},
    {"signing.failed", "neither came about", "an order of an operator",
     [
       {"what", :string, nil, "enrolled or revoked"},
       {"reason", :string, nil, "why not"},
       {"link", :string, nil, "by which link"},
       {"component", :integer, nil, "which component"},
       {"by", :string, nil, "who asked for it"}
     ]}
  ]

  all =
    for {type, moment, source, fields} <- table do
      fields =
        for {name, kind, unit, meaning} <- fields, do: %{name: name, type: kind, unit: unit, meaning: meaning}

      %{type: type, when: moment, source: source, fields: fields}
    end

  @all all
  @names Enum.map(all, & &1.type)

  @doc "All types, in an order for people."
  @spec all() :: [t()]
  def all, do: @all

  @doc "Their names."
  @spec names() :: [String.t()]
  def names, do: @names

  @doc "The table as Markdown: what the README of the vehicles shows."
  @spec markdown() :: String.t()
  def markdown do
    rows =
      for t <- @all,
          do: "| `#{t.type}` | #{t.when} | #{Enum.map_join(t.fields, "; ", &field/1)} | #{t.source} |\n"

    IO.iodata_to_binary(["| event | when | data | shown by |\n|---|---|---|---|\n", rows])
  end

  defp field(%{unit: nil} = field), do: "`#{field.name}`: #{field.meaning}"
  defp field(field), do: "`#{field.name}` (#{field.unit}): #{field.meaning}"
end
