defmodule Aerie.Vehicle.Command.Refusal do
  @moduledoc """
  Every reason for which a command or a change is refused before it is sent: the `rule` of a result. The HTTP status,
  the counters, the audit log and the table in `docs/commands.md` are made of this table; the reason itself is a
  sentence that says what was missing.
  """

  # Rule; who says it; HTTP status, nil for that of the result; what it means; what to do.
  @policy "policy"
  @table [
    {:unknown, @policy, 403, "nobody may send this: it has no row among what may pass",
     "send what [the policy](policy.md#raw-mavlink) lists, or set `policy.unknown`"},
    {:number, @policy, 403, "the firmware would read this number as another one",
     "give a number that the firmware has"},
    {:role, @policy, 403, "the source lacks the role or the permission that it needs",
     "give it the [role or permission](policy.md#roles)"},
    {:lease, @policy, 403, "somebody else is in charge of the vehicle, or steers it",
     "take over with a reason, or ask for a hand-over ([who is in charge](policy.md#who-is-in-charge))"},
    {:window, @policy, 403, "the time of day is outside of the windows of the policy",
     "wait, or change `policy.windows`"},
    {:condition, @policy, 403, "the vehicle's state does not fit a condition of the policy",
     "the reason names it"},
    {:battery, @policy, 403, "the battery is too low for a takeoff, or not known",
     "charge or change it, or lower `policy.takeoff_battery`"},
    {:mode, @policy, 403, "this mode is not allowed, or not known",
     "choose another one, or change `policy.modes`"},
    {:altitude, @policy, 403, "it leads above or below the limits of height",
     "change the height, or the limits"},
    {:geofence, @policy, 403, "it leads outside of the fence of the policy, or past it",
     "change the place, or the fence"},
    {:disarmed, @policy, 403, "a disarmed vehicle would store it, and move when it is armed",
     "arm the vehicle first"},
    {:rate, @policy, 429, "this source sends more than the rates allow",
     "send less often, or change `policy.rates`"},
    {:policy, "commands", 503, "the gateway has no policy",
     "correct the section `policy`; the log says what is wrong"},
    {:signature, "NATS, REST", 403, "it has no valid signature of a source that may command",
     "sign it with a key of `policy.sources`"},
    {:malformed, "the interface", 422,
     "it is not a valid command; `errors` names the keys, what was expected and what was given",
     "correct these keys"},
    {:size, "the interface", nil, "it is larger than a message may be", "ask over REST, or in pieces"},
    {:vehicle, "commands", 404, "there is no such vehicle", "see `GET /api/vehicles`"},
    {:id, "ledger", 409, "the id was used for another command", "use another id"},
    {:deadline, "commands", nil, "it came too late", "send it again, with a later deadline"},
    {:busy, "commands", 429,
     "too many commands or transfers are under way (`commands.max_in_flight`, or [over NATS](#floods))",
     "try again"},
    {:setpoints, "commands", 422, "PX4's OFFBOARD needs set-points for a second before, and none come",
     "stream set-points first"},
    {:ledger, "ledger", 503,
     "the ledger cannot be written at the moment, so nothing could keep it from being done twice",
     "make room on the disk; the diagnosis names the folder"},
    {:audit, "audit log", 503, "the audit log cannot be written at the moment",
     "make room on the disk, or see `policy.audit`"},
    {:unavailable, "commands", 503, "the gateway takes no commands at the moment", "try again"},
    {:elsewhere, "commands", 421, "another gateway hears the vehicle, and only that one does this",
     "ask the gateway that `via` names ([fleet](fleet.md))"},
    {:unreachable, "remote", nil, "the gateway that hears the vehicle cannot be reached; nothing was sent",
     "try again"},
    {:holder, "ownership", 503, "another gateway holds the vehicle or may hold it; nothing was sent",
     "see [several gateways](#several-gateways)"},
    {:claim, "ownership", 503,
     "its id could not be claimed where the other gateways see it; nothing was sent",
     "see [several gateways](#several-gateways)"},
    {:file, "the vehicle", 404, "the vehicle has no such file", "list the folder"},
    {:log, "the vehicle", 404, "the vehicle has no such log, or another one with its id", "list the logs"},
    {:metadata, "the vehicle", nil, "what the vehicle says of itself cannot be read",
     "nothing: this firmware says it wrongly"}
  ]
  @http for {rule, _by, http, _means, _fix} <- @table,
            http != nil,
            into: %{},
            do: {Atom.to_string(rule), http}

  @typedoc "One of `table/0`."
  @type rule :: atom()

  @doc "All rules: who says it, the HTTP status (nil: that of the result), what it means, and what to do."
  @spec table() :: [{rule(), by :: String.t(), 400..599 | nil, means :: String.t(), fix :: String.t()}]
  def table, do: @table

  @doc "The HTTP status of a rule by its name; nil if the result decides it."
  @spec http(String.t() | nil) :: 400..599 | nil
  def http(rule), do: @http[rule]
end
