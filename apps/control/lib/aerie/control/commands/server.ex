defmodule Aerie.Control.Commands.Server do
  @moduledoc """
  Receives commands: keeps those under way, their waiting callers, and the limit on their number.

  This process never blocks. A task (`Aerie.Control.Commands.Pipeline`) takes each command through ledger, policy and
  executor, and continues if its sender is gone. It ends with this process.
  """
  use GenServer

  alias Aerie.Vehicle.Command
  alias Aerie.Vehicle.Command.{Refusal, Result}
  alias Aerie.Control.Commands.{Pipeline, Recent, Record, Settings}
  alias Aerie.Control.Commands.Pipeline.{Core, Request}
  alias Aerie.Base.Names

  # Places beyond `max_in_flight` for commands that hold a vehicle or bring it down.
  @reserve 64
  # For one command; beyond that the first caller hears that it is under way, and may ask again.
  @max_waiting 8
  # Extra time for the answer after the grace time: a late answer on a busy machine must not read as "no command is
  # left".
  @drained_ms 30_000

  @typedoc """
  A command under way; `progress` is the vehicle's last word about it, `permission` what is needed to cancel it.
  `change?`: it is not a command of the table.
  """
  @type under_way :: %{
          vehicle: String.t(),
          type: String.t(),
          source: String.t(),
          progress: map() | nil,
          permission: Command.Type.permission(),
          change?: boolean()
        }

  @doc """
  `:gateways` knows the other gateways (`Aerie.Control.Commands.Gateways`); nil if this one is alone.
  """
  @spec start_link(
          gateway: Names.gateway(),
          settings: Settings.t(),
          gateways: module() | nil
        ) :: GenServer.on_start()
  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :command_server))

  @doc "Submits a command and waits `wait_ms` for its result; `:pending`: it continues without the caller."
  @spec submit(Names.gateway(), Request.t(), timeout()) :: {:ok, Result.t()} | {:pending, String.t()}
  def submit(gateway, %{command: %{id: id}} = request, wait_ms) do
    GenServer.call(Names.via(gateway, :command_server), {:submit, request}, wait_ms)
  catch
    :exit, {:timeout, _call} ->
      {:pending, id}

    :exit, {:noproc, _call} ->
      {:ok, Refusal.result(id, Refusal.deny(:takes_none))}

    :exit, _gone ->
      {:ok, Refusal.result(id, Refusal.ended(:commands_restarted))}
  end

  @doc """
  Takes no more commands and waits for those under way, `grace_ms` at most. Callers of the commands that are left then
  get the result `unknown`. Returns the ids of those commands.
  """
  @spec drain(Names.gateway(), grace_ms :: non_neg_integer()) :: [String.t()]
  def drain(gateway, grace_ms) do
    GenServer.call(Names.via(gateway, :command_server), {:drain, grace_ms}, grace_ms + @drained_ms)
  catch
    :exit, _gone -> []
  end

  @doc "A command under way; nil for one that is not."
  @spec under_way(Names.gateway(), String.t()) :: under_way() | nil
  def under_way(gateway, id), do: call(gateway, {:under_way, id}, nil)

  defp call(gateway, message, absent) do
    GenServer.call(Names.via(gateway, :command_server), message)
  catch
    :exit, _gone -> absent
  end

  @impl GenServer
  def init(options) do
    Process.flag(:trap_exit, true)
    %{gateway: gateway, settings: settings, gateways: gateways} = Map.new(options)
    Process.set_label({:command_server, gateway})
    Recent.abandoned(gateway)

    Names.put_value(gateway, :command_server, %{gateways: gateways, grace_ms: settings.grace_ms})

    environment = %{
      gateway: gateway,
      server: self(),
      gateways: gateways,
      settings: %{
        ledger_required?: settings.ledger.required,
        urgent_ms: settings.urgent_ms,
        record_ms: settings.record_ms,
        shared?: gateways != nil
      }
    }

    {:ok,
     %{
       gateway: gateway,
       environment: environment,
       max_in_flight: settings.max_in_flight,
       jobs: %{},
       tasks: %{},
       draining: nil
     }}
  end

  @impl GenServer
  def handle_call({:submit, %{command: %{id: id} = command} = request}, from, state) do
    Record.received(state.gateway, command.type)
    digest = Command.digest(command)

    case state.jobs do
      %{^id => %{digest: ^digest} = job} ->
        {:noreply, join(state, job, request, from)}

      %{^id => _other} ->
        refuse(request, Refusal.deny(:id_under_way, id: id), state)

      _new when state.draining != nil ->
        refuse(request, Refusal.deny(:stopping), state)

      _new ->
        admit(request, digest, from, state)
    end
  end

  def handle_call({:drain, grace_ms}, from, state) do
    Process.send_after(self(), :drained, grace_ms)
    {:noreply, drained(%{state | draining: from})}
  end

  def handle_call({:under_way, id}, _from, state) do
    answer =
      with %{request: %{command: command} = request, progress: progress} <- state.jobs[id] do
        %{
          vehicle: command.vehicle,
          type: command.type,
          source: command.source,
          progress: progress,
          permission: Request.intent(request).permission,
          change?: request.change != nil
        }
      end

    {:reply, answer, state}
  end

  @impl GenServer
  def handle_info({:command_progress, id, progress}, state) do
    case state.jobs do
      %{^id => job} ->
        for {pid, tag} <- job.watchers, do: send(pid, {:command_progress, tag, id, progress})
        Recent.progress(state.gateway, id, progress)
        {:noreply, put_in(state.jobs[id].progress, progress)}

      _done ->
        {:noreply, state}
    end
  end

  def handle_info({task, %Result{} = result}, state) when is_map_key(state.tasks, task) do
    Process.demonitor(task, [:flush])
    {:noreply, ended(state, task, result)}
  end

  # A fault of ours. Whether the vehicle did it, nobody knows; the ledger keeps it from being sent again.
  def handle_info({:DOWN, task, :process, _pid, _crash}, state) when is_map_key(state.tasks, task) do
    %{request: request} = state.jobs[state.tasks[task]]
    {:ok, _pid} = Task.start_link(Pipeline, :broken, [request, state.gateway])
    {:noreply, ended(state, task, Core.lost(request.command))}
  end

  # The grace time is over.
  def handle_info(:drained, %{draining: {_pid, _tag} = from} = state) do
    for {_id, job} <- state.jobs, caller <- job.waiting, do: GenServer.reply(caller, {:ok, unknown(job)})
    GenServer.reply(from, Enum.sort(Map.keys(state.jobs)))
    jobs = Map.new(state.jobs, fn {id, job} -> {id, %{job | waiting: []}} end)
    {:noreply, %{state | jobs: jobs, draining: :told}}
  end

  # The exit of a task, or what comes late.
  def handle_info(_other, state), do: {:noreply, state}

  # The ledger knows that it was sent; the next life looks after it.
  defp unknown(%{request: %{command: %{id: id}}}),
    do: Refusal.result(id, Refusal.ended(:gateway_ended))

  defp drained(%{draining: {_pid, _tag} = from, jobs: jobs} = state) when jobs == %{} do
    GenServer.reply(from, [])
    %{state | draining: :told}
  end

  defp drained(state), do: state

  defp admit(%{command: command} = request, digest, from, state) do
    reserve = if Request.intent(request).ends_flight?, do: @reserve, else: 0
    most = state.max_in_flight + reserve
    own = Enum.count(state.jobs, fn {_id, job} -> job.request.source.name == request.source.name end)

    if map_size(state.jobs) < most and own < max(div(most * 3, 4), 1) do
      task = Task.async(Pipeline, :run, [request, state.environment])
      job = %{request: request, digest: digest, waiting: [], watchers: [], progress: nil}
      Recent.begun(state.gateway, command, request.via)
      state = %{state | tasks: Map.put(state.tasks, task.ref, command.id)}
      {:noreply, join(state, job, request, from)}
    else
      if map_size(state.jobs) < most,
        do: refuse(request, Refusal.deny(:busy_source, n: own, source: request.source.name), state),
        else: refuse(request, Refusal.deny(:busy, n: map_size(state.jobs)), state)
    end
  end

  defp join(state, job, request, from) do
    id = request.command.id
    job = %{job | watchers: Enum.take(List.wrap(request.progress) ++ job.watchers, @max_waiting)}

    {waiting, dismissed} =
      Enum.split(if(request.wait?, do: [from | job.waiting], else: job.waiting), @max_waiting)

    dismissed = if request.wait?, do: dismissed, else: [from | dismissed]
    for caller <- dismissed, do: GenServer.reply(caller, {:pending, id})
    put_in(state.jobs[id], %{job | waiting: waiting})
  end

  defp refuse(request, denial, state),
    do: {:reply, {:ok, Record.refused(state.gateway, request, denial)}, state}

  defp ended(state, task, result) do
    {id, tasks} = Map.pop!(state.tasks, task)
    {job, jobs} = Map.pop!(state.jobs, id)
    # A caller that has the result finds the command among the finished ones.
    Recent.done(state.gateway, result)
    for caller <- job.waiting, do: GenServer.reply(caller, {:ok, result})
    drained(%{state | tasks: tasks, jobs: jobs})
  end
end
