defmodule Aerie.Control.Commands.Pipeline do
  @moduledoc """
  Runs one command through every check, in this order: known id, vehicle, role, rate, who holds it, ledger, policy, audit log, claim of the id,
  ledger again, executor, ledger, audit log. It is a task of its own; the deadline is checked between steps.

  `unrecorded/3` decides what happens if ledger or audit log cannot be written: the command is denied, unless it holds the
  vehicle or brings it down, or the configuration allows it. A command that holds the vehicle or brings it down waits only
  `commands.urgent_s` for either of them.
  """

  alias Aerie.Base.{Names, Store}
  alias Aerie.Control.{CommandExecutor, Ledger, Policy}
  alias Aerie.Vehicle.Command
  alias Aerie.Vehicle.Command.Result
  alias Aerie.Control.Commands.{OffboardPrecondition, Record, RemoteGateway, SharedVehicle}
  alias Aerie.Control.Policy.Mavlink.Writing
  alias Aerie.Control.Policy.{Audit, Context, Intent, Leases, RecentCommands}

  @typedoc """
  Where it runs.

    * `rate` - takes a token of the source
    * `ledger_required?` - nothing is sent while the ledger cannot be written
    * `urgent_ms` - how long a command that holds a vehicle or brings it down waits for the ledger and the audit log
    * `record_ms` - how long other commands wait for them
    * `remote_gateway` - passes commands on to the gateways of other vehicles (`Aerie.Control.Commands.RemoteGateway`)
    * `holder` - knows which gateway holds a vehicle (`Aerie.Control.Commands.Ownership`); nil if this one is alone
  """
  @type environment :: %{
          gateway: Names.gateway(),
          server: pid(),
          rate: (Command.t() -> :ok | {:deny, :rate, String.t()}),
          ledger_required?: boolean(),
          urgent_ms: pos_integer(),
          record_ms: pos_integer(),
          remote_gateway: module() | nil,
          holder: module() | nil
        }

  @doc "Runs a command to its result, which is then in the ledger, the audit log and the metrics."
  @spec run(Aerie.Control.Commands.Server.request(), environment()) :: Result.t()
  def run(%{command: command} = request, environment) do
    facts = facts(request)
    patience = if facts.ends_flight?, do: environment.urgent_ms, else: environment.record_ms

    ctx =
      Map.merge(environment, %{
        request: request,
        command: command,
        facts: facts,
        patience: patience,
        started: System.monotonic_time(:microsecond)
      })

    with :new <- known(ctx),
         {:ok, snapshot} <- vehicle(ctx),
         :ok <- role(ctx, snapshot),
         :ok <- rate(ctx),
         {:ok, snapshot, holding} <- SharedVehicle.evaluate(ctx, snapshot),
         {:ok, snapshot} <- reachable(ctx, snapshot),
         :ok <- in_time(ctx),
         :ok <- admit(ctx),
         {:admitted, {:ok, promise}} <- {:admitted, allowed(ctx, snapshot, holding)} do
      commanded(ctx)

      ctx
      |> Map.put(:promise, promise)
      |> carry_out(snapshot)
      |> SharedVehicle.done(ctx, promise)
      |> finish(ctx)
    else
      {:stored, result} -> result
      {:stop, status, rule, reason} -> Record.refused(ctx.gateway, request, status, rule, reason)
      {:admitted, {:known, result}} -> finish(result, ctx)
      {:admitted, {:stop, status, rule, reason}} -> stop(ctx, status, rule, reason)
    end
  end

  # Commands of the shadow do not count as operator activity.
  defp commanded(%{request: %{via: "shadow"}}), do: :ok

  defp commanded(%{gateway: gateway, command: command} = ctx) do
    RecentCommands.note(gateway, command.vehicle, ctx.request.source.name, ctx.facts)

    case command do
      # The executor repeats it for as long as it is held.
      %{type: "setpoint_" <> _what, params: %{hold: hold}} ->
        RecentCommands.setpoint(gateway, command.vehicle, round(hold * 1000))

      _other ->
        :ok
    end
  end

  @doc "The intent by which the rules judge a request."
  @spec facts(Aerie.Control.Commands.Server.request()) :: Intent.t()
  def facts(%{change: nil, command: command}), do: Intent.of(command)
  def facts(%{change: change}), do: change.facts

  @doc "The result of a command whose task died."
  @spec lost(Command.t()) :: Result.t()
  def lost(command),
    do:
      complete(
        Result.new(command.id, :unknown, "a fault in the gateway interrupted the command"),
        command
      )

  @doc "Records the end of a command whose task died."
  @spec broken(Aerie.Control.Commands.Server.request(), Names.gateway()) :: :ok
  def broken(%{command: command}, gateway) do
    result = lost(command)
    _ = Ledger.finish(gateway, result)
    Record.done(gateway, command, result, nil)
  end

  defp known(ctx) do
    case Ledger.known(ctx.gateway, ctx.command, ctx.patience) do
      :in_flight -> {:stored, lost(ctx.command)}
      {:refused, reason} -> {:stop, :rejected, :id, reason}
      # `admit/1` handles the error.
      {:error, _reason} -> :new
      answer -> answer
    end
  end

  # Before anything is remembered of it, so that one who may nothing fills neither rates nor the ledger.
  defp role(%{gateway: gateway, request: request, facts: facts}, snapshot) do
    context = Context.of(gateway, snapshot, request.source, System.os_time(:microsecond))

    with %Policy{} = policy <- Policy.Store.get(gateway),
         {:deny, rule, reason} <- Policy.admit(policy, facts, context) do
      Record.decided(gateway, :deny, rule)
      {:stop, :denied, rule, reason}
    else
      # Without a policy `decide/2` denies it.
      _none_or_allow -> :ok
    end
  end

  # Commands that bring a vehicle down are exempt, so that a stuck key cannot exhaust the rate limit.
  defp rate(%{facts: %{ends_flight?: true}}), do: :ok

  defp rate(ctx) do
    with {:deny, :rate, reason} <- ctx.rate.(ctx.command), do: {:stop, :denied, :rate, reason}
  end

  defp vehicle(ctx) do
    case known_vehicle(ctx) do
      nil -> {:stop, :rejected, :vehicle, "there is no vehicle #{ctx.command.vehicle}"}
      snapshot -> {:ok, snapshot}
    end
  end

  defp reachable(%{request: %{change: %{remote_request: nil}}}, %{via: via}) when via != nil,
    do: {:stop, :rejected, :elsewhere, RemoteGateway.only(via)}

  defp reachable(_ctx, snapshot), do: {:ok, snapshot}

  # A command from another gateway is not passed on again.
  defp known_vehicle(%{remote_gateway: remote_gateway, request: %{via: via}} = ctx)
       when remote_gateway == nil or via == "nats",
       do: Store.vehicle(ctx.gateway, ctx.command.vehicle)

  defp known_vehicle(ctx), do: RemoteGateway.vehicle(ctx.gateway, ctx.command.vehicle)

  defp in_time(ctx) do
    if Command.expired?(ctx.command, System.os_time(:microsecond)),
      do: {:stop, :expired, :deadline, "its deadline passed before it was sent"},
      else: :ok
  end

  defp admit(ctx) do
    case Ledger.admit(ctx.gateway, ctx.command, ctx.patience) do
      :new -> :ok
      :in_flight -> {:stored, lost(ctx.command)}
      {:stored, result} -> {:stored, result}
      {_refused_or_error, reason} -> unrecorded(ctx, :ledger, reason)
    end
  end

  defp allowed(ctx, snapshot, holding) do
    with :ok <- decide(ctx, snapshot),
         :ok <- setpoints(ctx, snapshot),
         :ok <- in_time(ctx),
         {:ok, holding} <- SharedVehicle.claim(ctx, holding),
         :ok <- sending(ctx),
         do: SharedVehicle.send?(ctx, holding)
  end

  defp setpoints(_ctx, %{via: via}) when via != nil, do: :ok

  defp setpoints(%{request: %{change: nil}} = ctx, snapshot) do
    with {:error, reason} <- OffboardPrecondition.check(ctx.gateway, ctx.command, snapshot),
         do: {:stop, :rejected, :setpoints, reason}
  end

  defp setpoints(_change, _snapshot), do: :ok

  defp decide(%{gateway: gateway, request: request, facts: facts} = ctx, snapshot) do
    context = Context.of(gateway, snapshot, request.source, System.os_time(:microsecond))

    with %Policy{} = policy <- Policy.Store.get(gateway),
         :allow <- Policy.decide(policy, facts, context),
         :allow <- Writing.entered(policy, gateway, snapshot, facts, context),
         :allow <- review(request.change, policy, context, snapshot),
         :allow <- Leases.steer(gateway, snapshot, facts, request.source, hold_us(ctx.command)),
         recorded = Audit.append(gateway, Record.decision(request, :allow), ctx.patience),
         :allow <- Audit.verdict(recorded, facts, policy.audit_required) do
      Record.decided(gateway, :allow, nil)
    else
      nil ->
        {:stop, :denied, :policy, "the gateway has no policy, so nobody may command anything"}

      {:deny, rule, reason} ->
        Record.decided(gateway, :deny, rule)
        {:stop, :denied, rule, reason}
    end
  end

  # The gateway repeats it for so long.
  defp hold_us(%{params: %{hold: seconds}}) when is_number(seconds), do: round(seconds * 1_000_000)
  defp hold_us(_command), do: 0

  defp review(%{review: review}, policy, context, snapshot) when review != nil,
    do: review.(policy, context, snapshot)

  defp review(_none, _policy, _context, _snapshot), do: :allow

  defp carry_out(ctx, %{via: via} = snapshot) when via != nil do
    progress = fn told -> send(ctx.server, {:command_progress, ctx.command.id, told}) end
    result = pass_on(ctx.request.change, ctx, snapshot, progress)

    if SharedVehicle.again?(ctx, snapshot, result),
      do: carry_out(ctx, Map.drop(snapshot, [:via, :holds?])),
      else: result
  end

  defp carry_out(%{facts: %{control: nil}} = ctx, snapshot), do: execute(ctx, snapshot)

  # A vehicle that has an operator of its own (X15) is asked first. A release succeeds even if the vehicle does not answer.
  defp carry_out(%{facts: %{control: change}} = ctx, snapshot) do
    result = if asked?(snapshot), do: execute(ctx, snapshot), else: Result.new(ctx.command.id, :completed)

    if result.status in [:accepted, :completed] or change == :release do
      %Policy{lease: rules} = Policy.Store.get(ctx.gateway)

      case Leases.change(ctx.gateway, snapshot.key, change, ctx.request.source, ctx.request.via, rules) do
        {:ok, _lease} -> result
        {:deny, reason} -> Result.new(ctx.command.id, :denied, reason, %{"rule" => "lease"})
      end
    else
      result
    end
  end

  defp asked?(%{status: :lost}), do: false
  defp asked?(snapshot), do: get_in(snapshot.groups, [:operator, :data, :system]) != nil

  defp execute(%{request: %{change: nil}} = ctx, snapshot),
    do:
      CommandExecutor.submit(ctx.gateway, snapshot.key, ctx.command,
        progress: ctx.server,
        still?: SharedVehicle.still?(ctx)
      )

  defp execute(%{request: %{change: change}, server: server, command: command}, snapshot) do
    change.run.(snapshot, fn progress ->
      send(server, {:command_progress, command.id, progress})
      :ok
    end)
  end

  defp pass_on(nil, ctx, snapshot, progress),
    do: ctx.remote_gateway.submit(ctx.gateway, snapshot, ctx.command, ctx.request, progress)

  defp pass_on(%{remote_request: request} = change, %{command: command} = ctx, snapshot, progress) do
    left_ms = if change.timeout_ms, do: max(div(command.deadline - System.os_time(:microsecond), 1000), 1)
    who = Command.passed_on(ctx.request.source.name, ctx.request.via)

    case ctx.remote_gateway.transfer(ctx.gateway, snapshot, command.id, request, who, left_ms, progress) do
      {:ok, details} -> Result.new(command.id, :completed, nil, details)
      {:error, result} -> result
    end
  end

  # A value, a plan or a file may be sent twice.
  defp retry(%{change: nil, command: command}), do: Command.type(command).retry
  defp retry(_change), do: :safe

  defp sending(ctx) do
    retry = retry(ctx.request)

    case Ledger.sending(ctx.gateway, ctx.command.id, retry, ctx.patience) do
      :ok -> :ok
      # It is unknown whether it was done before.
      {:refused, reason} when retry == :never -> {:stop, :denied, :ledger, reason}
      {_refused_or_error, reason} -> unrecorded(ctx, :ledger, reason)
    end
  end

  defp unrecorded(%{facts: %{ends_flight?: true}}, _where, _reason), do: :ok
  defp unrecorded(%{ledger_required?: false}, _where, _reason), do: :ok

  defp unrecorded(ctx, where, reason) do
    {:stop, :denied, where,
     "#{ctx.command.type} must be kept from being done twice, and the ledger cannot be written (#{reason})"}
  end

  # The command is in the ledger, so the refusal is stored and a retry gets the same result.
  defp stop(ctx, status, rule, reason) do
    result = Record.refused(ctx.gateway, ctx.request, status, rule, reason)
    _ = Ledger.finish(ctx.gateway, result, ctx.patience)
    result
  end

  defp finish(result, ctx) do
    result = complete(result, ctx.command)

    # A failed write does not change what the vehicle did, and the ledger reports it.
    _ = Ledger.finish(ctx.gateway, result, ctx.patience)
    Record.done(ctx.gateway, ctx.command, result, System.monotonic_time(:microsecond) - ctx.started)
    result
  end

  defp complete(result, command),
    do: %{
      result
      | details: Map.merge(result.details, %{"vehicle" => command.vehicle, "type" => command.type})
    }
end
