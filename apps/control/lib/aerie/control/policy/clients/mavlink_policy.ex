defmodule Aerie.Control.Policy.Clients.MavlinkPolicy do
  @moduledoc """
  The policy for raw MAVLink of clients (`MavRouter.Router.Policy`): reads what a message asks for
  (`Aerie.Control.Policy.Mavlink`), decides by the gateway's policy, answers a refusal
  (`Aerie.Control.Policy.Mavlink.Refusal`), and writes it into the audit log.

  It runs in the process that received the message and never blocks; rates, uploads and the times of notices are in a
  table (`Aerie.Control.Policy.Memory.ClientHistory`). A refusal that repeats itself (set-points, sticks) is answered
  each time where its protocol has an answer. The same text comes every 5 s as STATUSTEXT, and says how many were left
  out; another text comes at once. A record is written every 5 s for each type of command and rule.

  Telemetry: `[:aerie, :policy, :refused]` (`count` 1; `gateway`, `vehicle`, `source`, `type`, `rule`), with each
  refusal.
  """

  @behaviour MavRouter.Router.Policy

  alias Aerie.Base.Principal
  alias Aerie.Base.Store
  alias Aerie.Control.Policy

  alias Aerie.Control.Policy.{Audit, Intent, Mavlink}
  alias Aerie.Control.Policy.Memory.ClientHistory
  alias Aerie.Control.Policy.Intent.Context
  alias Aerie.Control.Policy.ControlLease.Holders
  alias Aerie.Control.Policy.Memory.RecentCommands

  alias Aerie.Control.Policy.Rate.Table, as: Rates

  alias MavCodec.Dialects.All
  alias MavCodec.Frame
  alias MavCodec.Messages, as: M

  # Corrections, times and the like, which are not judged one by one.
  @input %Intent{type: "sensor_input", permission: :sensors}
  @told_us 5_000_000
  # How long repeats of a text are counted, and how many texts a client has for each vehicle.
  @kept_us 60_000_000
  @texts 2_048
  # Frames of streams and of uploads are too many for the log; what they begin with is in it.
  @recorded [
    M.CommandLong,
    M.CommandInt,
    M.SetMode,
    M.ParamSet,
    M.ParamExtSet,
    M.MissionCount,
    M.MissionClearAll
  ]

  @impl MavRouter.Router.Policy
  def principal(gateway, path) do
    case Policy.Store.get(gateway) do
      nil ->
        %Principal{kind: :client, name: path.owner, role: :admin, may: if(path.commands, do: :all, else: [])}

      policy ->
        Policy.principal(policy, path)
    end
  end

  @impl MavRouter.Router.Policy
  def permits?(gateway, principal, key) do
    case Policy.Store.get(gateway) do
      nil ->
        true

      policy ->
        now = System.os_time(:microsecond)

        Policy.in_charge?(policy, @input, %Context{
          source: principal,
          lease: Holders.of(gateway, key),
          now: now
        })
    end
  end

  @impl MavRouter.Router.Policy
  def open?(gateway, principal, message) do
    case Policy.Store.get(gateway) do
      nil -> true
      policy -> opened?(policy, message) and Principal.may?(principal, :maintain)
    end
  end

  defp opened?(policy, message), do: policy.unknown == :maintain or {:message, message} in policy.open

  @impl MavRouter.Router.Policy
  def decide(gateway, sender, key, frame) do
    case Policy.Store.get(gateway) do
      nil -> :forward
      policy -> decide_by(policy, gateway, sender, key, frame)
    end
  end

  defp decide_by(policy, gateway, %{principal: source} = sender, key, frame) do
    snapshot = Store.vehicle(gateway, key)
    message = message(frame)

    case facts(message, snapshot) do
      :free ->
        if Principal.may?(source, :telemetry),
          do: :forward,
          else: {:refuse, answers(message, frame, snapshot, key), nil}

      facts ->
        now = System.os_time(:microsecond)
        vehicle = name(snapshot, key)

        entry = %{
          "type" => "raw",
          "source" => source.name,
          "client" => sender.owner,
          "peer" => sender.peer,
          "system" => frame.system,
          "vehicle" => vehicle,
          "message" => All.name(frame.id) || frame.id,
          "command" => facts.type
        }

        context = Context.of(gateway, snapshot, source, now)

        # Nothing is remembered before the role has been asked, nor of a vehicle that does not exist.
        decision =
          with :allow <- Policy.admit(policy, facts, context),
               facts = Mavlink.Writing.on_the_way(facts, message, gateway, sender, snapshot),
               :ok <- rate(policy, gateway, source.name, snapshot, facts),
               :allow <- Policy.decide(policy, facts, context),
               :allow <- Mavlink.Writing.written(policy, gateway, snapshot, message, facts, context),
               :allow <- Mavlink.Writing.entered(policy, gateway, snapshot, facts, context),
               :allow <- Holders.steer(gateway, snapshot, facts, source),
               :allow <- recorded(gateway, facts, policy.audit_required),
               do: in_charge(policy, gateway, key, facts, {source, snapshot})

        count(gateway, decision)
        if decision == :allow and snapshot != nil, do: commanded(gateway, vehicle, source.name, facts)
        conclude(decision, gateway, entry, {message, frame, key, snapshot, source})
    end
  end

  defp commanded(_gateway, _vehicle, _source, %{type: "sensor_input"}), do: :ok

  defp commanded(gateway, vehicle, source, %{type: type} = facts) do
    RecentCommands.note(gateway, vehicle, source, facts)
    if String.starts_with?(type, "setpoint_"), do: RecentCommands.setpoint(gateway, vehicle), else: :ok
  end

  defp count(gateway, :allow), do: Store.count(gateway, {:policy, :allow, nil})
  defp count(gateway, {:deny, rule, _reason}), do: Store.count(gateway, {:policy, :deny, rule})

  defp message(frame) do
    case MavCodec.decode(frame) do
      {:ok, message} -> message
      {:error, _unknown} -> nil
    end
  end

  defp answers(message, frame, snapshot, key),
    do: message |> Mavlink.Refusal.messages(frame, nil) |> encoded(frame, snapshot, key)

  # In the vehicle's name. Nobody answers for those that were not heard yet.
  defp encoded(_messages, _frame, _snapshot, {_network, 0}), do: []

  defp encoded(messages, frame, snapshot, {_network, system}) do
    ids = [system: system, component: component(frame, snapshot), sysid32: true]
    options = [version: Frame.version_for(frame, system)] ++ ids
    Enum.map(messages, &MavCodec.encode(&1, options))
  end

  defp facts(nil, _snapshot), do: Mavlink.unreadable()

  defp facts(message, nil),
    do: Mavlink.facts(message, %{autopilot: :generic, vehicle_type: "unknown", component: :unknown})

  defp facts(message, snapshot),
    do: Mavlink.facts(message, Map.take(snapshot, [:autopilot, :vehicle_type, :component]))

  defp groups(nil), do: %{}
  defp groups(snapshot), do: snapshot.groups

  defp name(nil, {network, system}), do: "#{network}/#{system}"
  defp name(snapshot, _key), do: snapshot.id

  # Vehicles that were not heard yet count as one: their ids cost a sender nothing.
  defp counted(nil), do: "vehicles that were not heard yet"
  defp counted(snapshot), do: snapshot.id

  # Commands that bring a vehicle down are exempt, so that a stuck key cannot exhaust the rate limit.
  defp rate(_policy, _gateway, _source, _vehicle, %{ends_flight?: true}), do: :ok

  defp rate(policy, gateway, source, snapshot, facts),
    do: Rates.take(gateway, policy, :rate, source, counted(snapshot), facts.type)

  # They are many, and keep a vehicle in the air: no disk that is full stops them.
  defp recorded(_gateway, %{type: "sensor_input"}, _required?), do: :allow

  defp recorded(gateway, facts, required?) do
    case Audit.failing(gateway) do
      nil -> :allow
      reason -> Audit.verdict({:error, reason}, facts, required?)
    end
  end

  # The gateway itself keeps who is in charge; a vehicle that also does so is asked in the client's name (X15).
  defp in_charge(_policy, _gateway, _key, %{control: nil}, _whose), do: :allow

  defp in_charge(policy, gateway, key, %{control: change}, {source, snapshot}) do
    heard = if snapshot, do: key
    with {:ok, _lease} <- Holders.change(gateway, heard, change, source, "mavlink", policy.lease), do: :allow
  end

  defp conclude(:allow, gateway, entry, {%module{} = message, frame, key, snapshot, _source})
       when module in @recorded do
    Audit.note(gateway, Map.put(entry, "decision", "allow"))
    Mavlink.sent(gateway, snapshot, message)

    if entry["command"] in ["take_control", "release_control"] and
         get_in(groups(snapshot), [:operator, :data, :system]) == nil do
      {:answer, encoded([Mavlink.Refusal.accepted(message, frame)], frame, snapshot, key)}
    else
      :forward
    end
  end

  defp conclude(:allow, _gateway, _entry, _refused), do: :forward

  defp conclude({:deny, rule, reason}, gateway, entry, {message, frame, key, snapshot, source}) do
    metadata = %{
      gateway: gateway,
      vehicle: entry["vehicle"],
      source: entry["source"],
      type: entry["command"],
      rule: rule
    }

    :telemetry.execute([:aerie, :policy, :refused], %{count: 1}, metadata)

    denied = Map.merge(entry, %{"decision" => "deny", "rule" => rule, "reason" => reason})
    # Each one of a sender who may nothing is counted.
    if Audit.Refusals.nobody?(source) or recorded?(gateway, denied, snapshot),
      do: Audit.refusal(gateway, source, rule, denied)

    texts = gateway |> told(denied, snapshot) |> Mavlink.Refusal.texts(:erlang.phash2(reason, 0xFFFF) + 1)

    current = get_in(groups(snapshot), [:mission, :data, :seq])
    answers = if message, do: Mavlink.Refusal.messages(message, frame, current), else: []
    {:refuse, encoded(answers ++ texts, frame, snapshot, key), instead(message, frame)}
  end

  defp component(frame, snapshot) do
    case Frame.target(frame) do
      {_system, component} when component > 0 -> component
      _all -> (snapshot && snapshot.component) || 1
    end
  end

  # In the sender's name, so that the vehicle answers to it.
  defp instead(nil, _frame), do: nil
  # It has no name.
  defp instead(_message, %{system: 0}), do: nil

  defp instead(message, frame) do
    with %_module{} = question <- Mavlink.Refusal.instead(message) do
      ids = [system: frame.system, component: frame.component, seq: frame.seq, sysid32: true]
      version = Frame.version_for(frame, frame.system)
      bytes = MavCodec.encode(question, [version: version] ++ ids)
      question = Frame.from_bytes(bytes, nil, frame.at)
      %{question | crc_extra: All.crc_extra(question.id)}
    end
  end

  # Without room to remember it, it is recorded each time.
  defp recorded?(gateway, %{"source" => source, "command" => type, "rule" => rule}, snapshot) do
    now = System.monotonic_time(:microsecond)
    noted = fn value -> if value, do: {:keep, false}, else: {:put, true, true, now + @told_us} end

    ClientHistory.update(gateway, {source, :told, {counted(snapshot), type, rule}}, now, noted) in [
      true,
      :full
    ]
  end

  # The text of a refusal, nil for one that was sent just now. It says how often it was not sent since.
  defp told(gateway, %{"source" => source, "reason" => reason} = denied, snapshot) do
    now = System.monotonic_time(:microsecond)

    tell = fn
      nil -> {:put, reason, {now, 0}, now + @kept_us}
      {at, n} when now - at < @told_us -> {:put, nil, {at, n + 1}, now + @kept_us}
      {_at, 0} -> {:put, reason, {now, 0}, now + @kept_us}
      {_at, n} -> {:put, "#{reason} (#{n} more since)", {now, 0}, now + @kept_us}
    end

    with :full <-
           ClientHistory.update(gateway, {source, :text, {counted(snapshot), subject(denied)}}, now, tell),
         do: reason
  end

  # A stream would have another number in each of its refusals. Somebody who sends whatever he likes takes little room.
  defp subject(%{"command" => type, "rule" => rule, "reason" => reason}) do
    if Intent.stream?(type), do: {type, rule}, else: :erlang.phash2(reason, @texts)
  end
end
