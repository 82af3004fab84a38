defmodule Aerie.Control.Commands.Pipeline do
  @moduledoc """
  The way of one command through the door: known id, rate, vehicle, who holds it, ledger, policy, audit log, claim of the id, ledger
  again, executor, ledger, audit log. Runs in a task of its own; the deadline is checked between steps.

  `unrecorded/3` decides what happens if ledger or audit log cannot be written: the command is denied, unless it holds the
  vehicle or brings it down, or the configuration says otherwise. Such a command waits only `commands.urgent_s` for either of them.
  """

  alias Aerie.Base.{Names, Store}
  alias Aerie.Control.{CommandExecutor, Ledger, Policy}
  alias Aerie.Vehicle.Command
  alias Aerie.Vehicle.Command.Result
  alias Aerie.Control.Commands.{OffboardPrecondition, Record, RemoteGateway, SharedVehicle}
  alias Aerie.Control.Policy.{Audit, Context, Intent, Leases, RecentCommands}

  @typedoc """
  Where it runs. `rate` takes a token of the source. `ledger_required?`: nothing is commanded while the ledger cannot be written. `urgent_ms`: how long what holds a
  vehicle or brings it down waits for the ledger and the audit log, `record_ms`: how long others do. `elsewhere`: the way to
  vehicles of other gateways; `holder`: how it is known which gateway holds a vehicle, nil if this one is alone.
  """
  @type environment :: %{
          gateway: Names.gateway(),
          desk: pid(),
          rate: (Command.t() -> :ok | {:deny, :rate, String.t()}),
          ledger_required?: boolean(),
          urgent_ms: pos_integer(),
          record_ms: pos_integer(),
          elsewhere: module() | nil,
          holder: module() | nil
        }

  @doc "Brings a command to its result, which is in ledger, audit log and metrics then."
  @spec run(Aerie.Control.Commands.Server.request(), environment()) :: Result.t()
  def run(%{command: command} = request, environment) do
    facts = facts(request)
    patience = if facts.ends_flight?, do: environment.urgent_ms, else: environment.record_ms

    way =
      Map.merge(environment, %{
        request: request,
        command: command,
        facts: facts,
        patience: patience,
        started: System.monotonic_time(:microsecond)
      })

    with :new <- known(way),
         :ok <- rate(way),
         {:ok, snapshot} <- vehicle(way),
         {:ok, snapshot, holding} <- SharedVehicle.evaluate(way, snapshot),
         {:ok, snapshot} <- reachable(way, snapshot),
         :ok <- in_time(way),
         :ok <- admit(way),
         {:admitted, {:ok, promise}} <- {:admitted, allowed(way, snapshot, holding)} do
      commanded(way)

      way
      |> Map.put(:promise, promise)
      |> carry_out(snapshot)
      |> SharedVehicle.done(way, promise)
      |> finish(way)
    else
      {:stored, result} -> result
      {:stop, status, rule, reason} -> Record.refused(way.gateway, request, status, rule, reason)
      {:admitted, {:known, result}} -> finish(result, way)
      {:admitted, {:stop, status, rule, reason}} -> stop(way, status, rule, reason)
    end
  end

  # The shadow waits for everybody else, and not for itself.
  defp commanded(%{request: %{via: "shadow"}}), do: :ok

  defp commanded(%{gateway: gateway, command: command} = way) do
    RecentCommands.note(gateway, command.vehicle, way.request.source.name, way.facts)

    case command do
      # It is repeated for as long as it is held.
      %{type: "setpoint_" <> _what, params: %{hold: hold}} ->
        RecentCommands.setpoint(gateway, command.vehicle, round(hold * 1000))

      _other ->
        :ok
    end
  end

  @doc "What the rules judge a request by."
  @spec facts(Aerie.Control.Commands.Server.request()) :: Intent.t()
  def facts(%{work: nil, command: command}), do: Intent.of(command)
  def facts(%{work: work}), do: work.facts

  @doc "The result of a command whose task died."
  @spec lost(Command.t()) :: Result.t()
  def lost(command),
    do:
      complete(
        Result.new(command.id, :unknown, "a fault in the gateway interrupted the command"),
        command
      )

  @doc "Writes down the end of a command whose task died."
  @spec broken(Aerie.Control.Commands.Server.request(), Names.gateway()) :: :ok
  def broken(%{command: command}, gateway) do
    result = lost(command)
    _ = Ledger.finish(gateway, result)
    Record.done(gateway, command, result, nil)
  end

  defp known(way) do
    case Ledger.known(way.gateway, way.command, way.patience) do
      :in_flight -> {:stored, lost(way.command)}
      {:refused, reason} -> {:stop, :rejected, :id, reason}
      # Whether it can be admitted is asked in its turn.
      {:error, _reason} -> :new
      answer -> answer
    end
  end

  # What brings a vehicle down is not counted: a stuck key must not use it up.
  defp rate(%{facts: %{ends_flight?: true}}), do: :ok

  defp rate(way) do
    with {:deny, :rate, reason} <- way.rate.(way.command), do: {:stop, :denied, :rate, reason}
  end

  defp vehicle(way) do
    case known_vehicle(way) do
      nil -> {:stop, :rejected, :vehicle, "there is no vehicle #{way.command.vehicle}"}
      snapshot -> {:ok, snapshot}
    end
  end

  defp reachable(%{request: %{work: %{elsewhere: nil}}}, %{via: via}) when via != nil,
    do: {:stop, :rejected, :elsewhere, RemoteGateway.only(via)}

  defp reachable(_way, snapshot), do: {:ok, snapshot}

  # What another gateway passed on is not passed on again.
  defp known_vehicle(%{elsewhere: elsewhere, request: %{via: via}} = way)
       when elsewhere == nil or via == "nats",
       do: Store.vehicle(way.gateway, way.command.vehicle)

  defp known_vehicle(way), do: RemoteGateway.vehicle(way.gateway, way.command.vehicle)

  defp in_time(way) do
    if Command.expired?(way.command, System.os_time(:microsecond)),
      do: {:stop, :expired, :deadline, "its deadline passed before it was sent"},
      else: :ok
  end

  defp admit(way) do
    case Ledger.admit(way.gateway, way.command, way.patience) do
      :new -> :ok
      :in_flight -> {:stored, lost(way.command)}
      {:stored, result} -> {:stored, result}
      {_refused_or_error, reason} -> unrecorded(way, :ledger, reason)
    end
  end

  defp allowed(way, snapshot, holding) do
    with :ok <- decide(way, snapshot),
         :ok <- setpoints(way, snapshot),
         :ok <- in_time(way),
         {:ok, holding} <- SharedVehicle.claim(way, holding),
         :ok <- sending(way),
         do: SharedVehicle.send?(way, holding)
  end

  defp setpoints(_way, %{via: via}) when via != nil, do: :ok

  defp setpoints(%{request: %{work: nil}} = way, snapshot) do
    with {:error, reason} <- OffboardPrecondition.check(way.gateway, way.command, snapshot),
         do: {:stop, :rejected, :setpoints, reason}
  end

  defp setpoints(_work, _snapshot), do: :ok

  defp decide(%{gateway: gateway, request: request, facts: facts} = way, snapshot) do
    context = Context.of(gateway, snapshot, request.source, System.os_time(:microsecond))

    with %Policy{} = policy <- Policy.Store.get(gateway),
         :allow <- Policy.decide(policy, facts, context),
         :allow <- review(request.work, policy, context, snapshot),
         recorded = Audit.append(gateway, Record.decision(request, :allow), way.patience),
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

  defp review(%{review: review}, policy, context, snapshot) when review != nil,
    do: review.(policy, context, snapshot)

  defp review(_none, _policy, _context, _snapshot), do: :allow

  defp carry_out(way, %{via: via} = snapshot) when via != nil do
    progress = fn told -> send(way.desk, {:command_progress, way.command.id, told}) end
    pass_on(way.request.work, way, snapshot, progress)
  end

  defp carry_out(%{facts: %{control: nil}} = way, snapshot), do: execute(way, snapshot)

  # A vehicle that has an operator of its own (X15) is asked first. Who lets go of one that does not answer is not kept.
  defp carry_out(%{facts: %{control: change}} = way, snapshot) do
    result = if asked?(snapshot), do: execute(way, snapshot), else: Result.new(way.command.id, :completed)

    if result.status in [:accepted, :completed] or change == :release do
      %Policy{lease: rules} = Policy.Store.get(way.gateway)

      case Leases.change(way.gateway, snapshot.key, change, way.request.source, way.request.via, rules) do
        {:ok, _lease} -> result
        {:deny, reason} -> Result.new(way.command.id, :denied, reason, %{"rule" => "lease"})
      end
    else
      result
    end
  end

  defp asked?(%{status: :lost}), do: false
  defp asked?(snapshot), do: get_in(snapshot.groups, [:operator, :data, :system]) != nil

  defp execute(%{request: %{work: nil}} = way, snapshot),
    do:
      CommandExecutor.submit(way.gateway, snapshot.key, way.command,
        progress: way.desk,
        still?: SharedVehicle.still?(way)
      )

  defp execute(%{request: %{work: work}, desk: desk, command: command}, snapshot) do
    work.run.(snapshot, fn progress ->
      send(desk, {:command_progress, command.id, progress})
      :ok
    end)
  end

  defp pass_on(nil, way, snapshot, progress),
    do: way.elsewhere.submit(way.gateway, snapshot, way.command, way.request, progress)

  defp pass_on(%{elsewhere: request}, %{command: command} = way, snapshot, progress) do
    left_ms = max(div(command.deadline - System.os_time(:microsecond), 1000), 1)
    who = "#{way.request.source.name} by #{way.request.via}"

    case way.elsewhere.transfer(way.gateway, snapshot, command.id, request, who, left_ms, progress) do
      {:ok, details} -> Result.new(command.id, :completed, nil, details)
      {:error, result} -> result
    end
  end

  # Sent twice, a value, a plan or a file is the same as sent once.
  defp retry(%{work: nil, command: command}), do: Command.type(command).retry
  defp retry(_work), do: :safe

  defp sending(way) do
    retry = retry(way.request)

    case Ledger.sending(way.gateway, way.command.id, retry, way.patience) do
      :ok -> :ok
      # Whether it was done before, nobody knows.
      {:refused, reason} when retry == :never -> {:stop, :denied, :ledger, reason}
      {_refused_or_error, reason} -> unrecorded(way, :ledger, reason)
    end
  end

  defp unrecorded(%{facts: %{ends_flight?: true}}, _where, _reason), do: :ok
  defp unrecorded(%{ledger_required?: false}, _where, _reason), do: :ok

  defp unrecorded(way, where, reason) do
    {:stop, :denied, where,
     "#{way.command.type} must be kept from being done twice, and the ledger cannot be written (#{reason})"}
  end

  # It is in the ledger, so its refusal is, too: who asks again gets the same.
  defp stop(way, status, rule, reason) do
    result = Record.refused(way.gateway, way.request, status, rule, reason)
    _ = Ledger.finish(way.gateway, result, way.patience)
    result
  end

  defp finish(result, way) do
    result = complete(result, way.command)

    # A vehicle has done it, or not; that it could not be written down changes nothing, and the ledger tells it by itself.
    _ = Ledger.finish(way.gateway, result, way.patience)
    Record.done(way.gateway, way.command, result, System.monotonic_time(:microsecond) - way.started)
    result
  end

  defp complete(result, command),
    do: %{
      result
      | details: Map.merge(result.details, %{"vehicle" => command.vehicle, "type" => command.type})
    }
end
