defmodule Aerie.Vehicle.Command.Refusal.Commands do
  @moduledoc """
  What the interfaces, the path of a command, its ledger and the other gateways refuse
  (`Aerie.Vehicle.Command.Refusal`).
  """

  @unsent "; nothing was sent"
  @unreachable "the vehicle cannot be reached, nothing was sent: "

  @rules [
    {:policy, "commands", :denied, 503, "the gateway has no policy",
     "correct the section `policy`; the log says what is wrong",
     no_policy: "the gateway has no policy, so nobody may command anything",
     no_policy_for_plans: "the gateway has no policy, so nobody may send a plan",
     no_policy_to_arm: "the gateway has no policy"},
    {:signature, "NATS, REST", :denied, 403, "it has no valid signature of a source that may command",
     "sign it with a key of `policy.sources`",
     unsigned: "the command is not signed, and unsigned commands may do nothing here (policy.unsigned)",
     signature:
       "the signature does not fit: the command, its subject or its time was changed, or another key signed it",
     signature_malformed:
       "the header Aerie-Signature is not a public nkey of a user (U…), a time and a signature in base64url",
     signature_long: "the header Aerie-Signature is longer than %{most} bytes",
     signature_old: "the signature is %{seconds} s old; it counts for %{most} s",
     signature_ahead: "the signature's time is %{seconds} s ahead of the gateway's clock",
     signature_without_id: "a signed command needs an id",
     key_unlisted: "the key %{key} is not one of policy.sources",
     key_expired: "the key of %{name} was good until %{day}",
     nobody_called: "policy.sources has nobody called %{name}"},
    {:malformed, "the interface", :rejected, 422,
     "it is not a valid command; `errors` names the keys, what was expected and what was given",
     "correct these keys",
     no_object: "the body is not a JSON object",
     no_action: "the last word of the subject must be one of %{actions}",
     another_subject: "%{key}: the subject names another one than the body",
     deadline_unsigned: "Aerie-Deadline is not signed: the deadline of a signed command is in its body"},
    {:size, "the interface", :rejected, nil, "it is larger than a message may be",
     "ask over REST, or in pieces",
     body_large: "the body has more than %{most} bytes",
     reply_large: "the reply has %{bytes} bytes, more than the %{most} that NATS carries; ask over REST",
     request_large: "it is larger than what NATS carries: ask its gateway"},
    {:vehicle, "commands", :rejected, 404, "there is no such vehicle", "see `GET /api/vehicles`",
     no_vehicle: "there is no vehicle %{id}"},
    {:id, "ledger", :rejected, 409, "the id was used for another command", "use another id",
     transfer_under_way: "a transfer with this id is under way",
     id_under_way: "the id %{id} belongs to another command",
     id_used: "the id %{id} was used for another command; every command needs an id of its own",
     ledger_blind:
       "the ledger was damaged after %{id} was issued, so the command may have been executed already; " <>
         "look at the vehicle, and give a new command with a new id"},
    {:deadline, "commands", :expired, nil, "it came too late", "send it again, with a later deadline",
     late: "its deadline passed before it was sent"},
    {:busy, "commands", :denied, 429,
     "too many commands or transfers are under way (`commands.max_in_flight`, or [over NATS](#floods))",
     "try again",
     transfers_many: "as many transfers wait for this vehicle as may; try again",
     busy_nats: "%{n} commands over NATS are under way, which is the limit; try again",
     busy_requests: "%{n} requests are under way, as many as there may be; try again",
     busy: "%{n} commands are under way, as many as there may be; try again",
     busy_source: "%{n} commands of %{source} are under way, as many as one may have; try again"},
    {:setpoints, "commands", :rejected, 422,
     "PX4's OFFBOARD needs set-points for a second before, and none come", "stream set-points first",
     setpoints:
       "the mode needs set-points at 2 Hz or more for a second before, and %{since}: send setpoint_velocity or " <>
         "another one first, or say setpoints_elsewhere if they do not come through this gateway"},
    {:ledger, "ledger", :denied, 503,
     "the ledger cannot be written at the moment, so nothing could keep it from being done twice",
     "make room on the disk; the diagnosis names the folder",
     unrecorded: "%{command} must be kept from being done twice, and the ledger cannot be written (%{error})",
     sent_already: "%{id} was sent already and must not be sent twice",
     ended_already: "%{id} has its result already",
     not_in_ledger: "%{id} is not in the ledger"},
    {:audit, "audit log", :denied, 503, "the audit log cannot be written at the moment",
     "make room on the disk, or see `policy.audit`",
     unaudited:
       "%{command} must be recorded, and the audit log cannot be written (%{error}). Make room or mend the folder; " <>
         "policy.audit.required: false lets commands pass unrecorded"},
    {:unavailable, "commands", :denied, 503, "the gateway takes no commands at the moment", "try again",
     stopping: "the gateway is stopping" <> @unsent,
     takes_none: "the gateway takes no commands just now" <> @unsent,
     request_broken: "a fault of the gateway ended its work on the request"},
    {:elsewhere, "commands", :rejected, 421, "another gateway hears the vehicle, and only that one does this",
     "ask the gateway that `via` names ([fleet](fleet.md))",
     elsewhere:
       "not available for a remote vehicle: it is heard by the gateway %{via}; ask that one (docs/fleet.md)"},
    {:unreachable, "remote", :failed, nil,
     "the gateway that hears the vehicle cannot be reached; nothing was sent", "try again",
     unheard_over_nats:
       @unreachable <> "nothing was heard of it over NATS for a while; its gateway was %{via}",
     nats_away: @unreachable <> "NATS is away, and the vehicle is heard by the gateway %{via}",
     nats_lost: @unreachable <> "the connection to NATS is lost",
     nobody_listens: @unreachable <> "no gateway listens for it; it was heard by %{via}"},
    {:holder, "ownership", :denied, 503, "another gateway holds the vehicle or may hold it; nothing was sent",
     "see [several gateways](#several-gateways)",
     holder_unknown: "%{unknown}" <> @unsent,
     holder_lost: "this gateway lost the vehicle's lease before it was sent" <> @unsent,
     taken_over: "the gateway %{name} has taken the vehicle over" <> @unsent,
     held: "the gateway %{name} holds the vehicle now; ask again" <> @unsent},
    {:claim, "ownership", :denied, 503,
     "its id could not be claimed where the other gateways see it; nothing was sent",
     "see [several gateways](#several-gateways)",
     unclaimed: "its id could not be claimed where other gateways see it (%{error})" <> @unsent},
    {:file, "the vehicle", :rejected, 404, "the vehicle has no such file", "list the folder",
     no_file: "the vehicle has no such file"},
    {:log, "the vehicle", :rejected, 404, "the vehicle has no such log, or another one with its id",
     "list the logs",
     no_log: "the vehicle has no log %{id}",
     another_log: "log %{id} is another one than before; list the logs again"},
    {:metadata, "the vehicle", :failed, nil, "what the vehicle says of itself cannot be read",
     "nothing: this firmware says it wrongly", []}
  ]

  @doc "Their rules."
  @spec rules() :: [tuple()]
  def rules, do: @rules
end
