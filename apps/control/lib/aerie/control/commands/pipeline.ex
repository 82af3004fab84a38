defmodule Aerie.Control.Commands.Pipeline do
  @moduledoc """
  Runs one command through every check, in a task of its own: does what `Aerie.Control.Commands.Pipeline.Core` says, and
  tells it what came of it. A slow ledger, vehicle or gateway keeps only this command waiting.
  """

  alias Aerie.Base.{Names, Store}
  alias Aerie.Control.{CommandExecutor, Ledger, Policy}
  alias Aerie.Control.Commands.{Change, Gateways, OffboardPrecondition, Record}
  alias Aerie.Control.Commands.Pipeline.{Core, Request}
  alias Aerie.Control.Policy.Mavlink.Writing
  alias Aerie.Control.Policy.Audit
  alias Aerie.Control.Policy.Intent.Context
  alias Aerie.Control.Policy.ControlLease.Holders
  alias Aerie.Control.Policy.Memory.RecentCommands
  alias Aerie.Control.Policy.Rate.Table, as: Rates
  alias Aerie.Vehicle.Command
  alias Aerie.Vehicle.Command.Result

  @typedoc """
  Where it runs.

    * `server` - gets the progress
    * `gateways` - knows the other gateways (`Aerie.Control.Commands.Gateways`); nil if this one is alone
  """
  @type environment :: %{
          gateway: Names.gateway(),
          server: pid(),
          settings: Core.settings(),
          gateways: module() | nil
        }

  @doc "Runs a command to its result, which is then in the ledger, the audit log and the metrics."
  @spec run(Request.t(), environment()) :: Result.t()
  def run(request, environment) do
    Process.set_label({:command, request.command.id})
    environment = Map.put(environment, :since, System.monotonic_time(:microsecond))
    request |> Core.new(environment.settings) |> step(:start, environment)
  end

  defp step(core, event, environment) do
    now = %{us: System.os_time(:microsecond), ms: System.monotonic_time(:millisecond)}
    {core, actions} = Core.handle(core, event, now)

    case Enum.reduce(actions, nil, fn action, _unanswered -> perform(action, core, environment) end) do
      {:done, result} -> result
      event -> step(core, event, environment)
    end
  end

  @doc "Records the end of a command whose task died."
  @spec broken(Request.t(), Names.gateway()) :: :ok
  def broken(%{command: command}, gateway) do
    result = Core.lost(command)
    _ = Ledger.finish(gateway, result)
    Record.done(gateway, command, result, nil)
  end

  defp perform(:look, %{request: request, intent: intent}, %{gateway: gateway}) do
    snapshot = vehicle(request, gateway)
    policy = Policy.Store.get(gateway)
    judged? = snapshot != nil and policy != nil

    {:seen, snapshot,
     if(judged?, do: Policy.admit(policy, intent, context(gateway, snapshot, request)), else: :allow)}
  end

  defp perform(:take_token, core, environment),
    do: {:token, rate(core, environment, &Rates.take/6)}

  defp perform(:put_back_token, core, environment), do: rate(core, environment, &Rates.put_back/6)
  defp perform(:holder, core, environment), do: {:holder, holder(core, environment)}

  defp perform({:wait, ms}, _core, _environment) do
    receive do
    after
      ms -> :waited
    end
  end

  defp perform({:ask, :known}, core, %{gateway: gateway}),
    do: {:known, Ledger.known(gateway, core.request.command, core.patience)}

  defp perform({:ask, :admit}, core, %{gateway: gateway}),
    do: {:known, Ledger.admit(gateway, core.request.command, core.patience)}

  defp perform(:judge, core, environment), do: {:judged, judge(core, environment)}

  defp perform({:audit, required?}, %{request: request} = core, %{gateway: gateway}) do
    recorded = Audit.append(gateway, Record.decision(request), core.patience)
    verdict = Audit.verdict(recorded, core.intent, required?)
    if verdict == :allow, do: Record.allowed(gateway)
    {:judged, verdict}
  end

  defp perform(:setpoints, %{request: %{change: nil, command: command}, snapshot: snapshot}, %{
         gateway: gateway
       })
       when snapshot.via == nil,
       do: {:setpoints, OffboardPrecondition.check(gateway, command, snapshot)}

  defp perform(:setpoints, _core, _environment), do: {:setpoints, :ok}

  defp perform({:claim, timeout_ms}, %{request: %{command: command}}, %{gateway: gateway, gateways: gateways}),
       do: {:claimed, gateways.claim(gateway, command.vehicle, command.id, timeout_ms)}

  defp perform({:sending, retry}, core, %{gateway: gateway}),
    do: {:sending, Ledger.sending(gateway, core.request.command.id, retry, core.patience)}

  # Commands of the shadow do not count as operator activity.
  defp perform(:commanded, %{request: %{via: "shadow"}}, _environment), do: :ok

  defp perform(:commanded, %{request: %{command: command} = request, intent: intent}, environment) do
    %{gateway: gateway, since: since} = environment
    RecentCommands.note(gateway, command.vehicle, request.source.name, intent, command.id, since)

    case command do
      # The executor repeats it for as long as it is held.
      %{type: "setpoint_" <> _what, params: %{hold: hold}} ->
        RecentCommands.setpoint(gateway, command.vehicle, round(hold * 1000))

      _other ->
        :ok
    end
  end

  defp perform(:execute, %{request: %{change: nil} = request} = core, %{gateway: gateway} = environment) do
    options = [progress: environment.server, still?: still?(core, environment)]
    {:result, CommandExecutor.submit(gateway, core.snapshot.key, request.command, options)}
  end

  defp perform(:execute, %{request: %{change: change, command: command}} = core, environment) do
    tell = progress(core, environment)
    {:result, Change.run(change, environment.gateway, core.snapshot, command.id, tell)}
  end

  defp perform(:pass_on, core, environment), do: {:result, pass_on(core.request.change, core, environment)}

  defp perform({:change_lease, change}, %{request: request, snapshot: snapshot}, %{gateway: gateway}) do
    %Policy{lease: rules} = Policy.Store.get(gateway)
    {:lease, Holders.change(gateway, snapshot.key, change, request.source, request.via, rules)}
  end

  defp perform({:announce, result}, core, %{gateway: gateway, gateways: gateways}),
    do: gateways.done(gateway, core.request.command.vehicle, result)

  defp perform({:refuse, denial, stored?}, %{request: request} = core, %{gateway: gateway}) do
    result = Record.refused(gateway, request, denial)
    _ = if stored?, do: Ledger.finish(gateway, result, core.patience)
    {:done, result}
  end

  defp perform({:answer, result}, _core, _environment), do: {:done, result}

  # A failed write does not change what the vehicle did, and the ledger reports it.
  defp perform({:finish, result}, core, %{gateway: gateway, since: since}) do
    _ = Ledger.finish(gateway, result, core.patience)
    Record.done(gateway, core.request.command, result, System.monotonic_time(:microsecond) - since)
    {:done, result}
  end

  # A command from another gateway is not passed on again.
  defp vehicle(%{via: "nats", command: command}, gateway), do: Store.vehicle(gateway, command.vehicle)
  defp vehicle(%{command: command}, gateway), do: Gateways.vehicle(gateway, command.vehicle)

  defp context(gateway, snapshot, request),
    do: Context.of(gateway, snapshot, request.source, System.os_time(:microsecond))

  # Without a policy the rules deny it.
  defp rate(%{request: %{source: source, command: command}}, %{gateway: gateway}, fun) do
    case Policy.Store.get(gateway) do
      nil -> :ok
      policy -> fun.(gateway, policy, :command_rate, source.name, command.vehicle, command.type)
    end
  end

  defp judge(%{request: request, intent: intent, snapshot: snapshot}, %{gateway: gateway}) do
    context = context(gateway, snapshot, request)

    with %Policy{} = policy <- Policy.Store.get(gateway),
         :allow <- Policy.decide(policy, intent, context),
         :allow <- Writing.entered(policy, gateway, snapshot, intent, context),
         :allow <- review(request.change, gateway, snapshot, policy, context),
         :allow <- Holders.steer(gateway, snapshot, intent, request.source, hold_us(request.command)) do
      {:audit, policy.audit_required}
    else
      nil -> :no_policy
      denied -> denied
    end
  end

  # The gateway repeats it for so long.
  defp hold_us(%{params: %{hold: seconds}}) when is_number(seconds), do: round(seconds * 1_000_000)
  defp hold_us(_command), do: 0

  defp review(nil, _gateway, _snapshot, _policy, _context), do: :allow

  defp review(change, gateway, snapshot, policy, context),
    do: change.module.review(change.what, gateway, snapshot, policy, context)

  defp pass_on(nil, %{request: request} = core, %{gateway: gateway} = environment) do
    tell = progress(core, environment)
    environment.gateways.submit(gateway, core.snapshot, request.command, request, tell)
  end

  defp pass_on(%{remote_request: asked} = change, core, %{gateway: gateway} = environment) do
    %{command: command, source: source, via: via} = core.request
    left_ms = if change.timeout_ms, do: max(div(command.deadline - System.os_time(:microsecond), 1000), 1)
    who = Command.passed_on(source.name, via)
    tell = progress(core, environment)

    case environment.gateways.transfer(gateway, core.snapshot, command.id, asked, who, left_ms, tell) do
      {:ok, details} -> Result.new(command.id, :completed, nil, details)
      {:error, result} -> result
    end
  end

  defp progress(%{request: %{command: %{id: id}}}, %{server: server}) do
    fn progress ->
      send(server, {:command_progress, id, progress})
      :ok
    end
  end

  # Whether the vehicle is still held, for the executor of a command that sends more than one message; nil if no other
  # gateway can hold it.
  defp still?(%{promise: promise}, _environment) when promise in [nil, :urgent], do: nil

  # Its shadow may be restarting, so that it knows nothing for a moment.
  defp still?(%{promise: :gateway} = core, environment),
    do: fn -> not match?({:other, _name}, holder(core, environment)) end

  defp still?(core, environment) do
    fn ->
      case holder(core, environment) do
        :alone -> true
        {:mine, until} -> System.monotonic_time(:millisecond) < until
        _other_or_unknown -> false
      end
    end
  end

  defp holder(core, %{gateway: gateway, gateways: gateways}),
    do: gateways.holder(gateway, core.request.command.vehicle)
end
