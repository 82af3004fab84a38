defmodule Aerie.Fleet.Operations.Server do
  @moduledoc """
  Keeps the operations of a gateway: `Aerie.Fleet.Operations.Core` with tasks and timers. What became of each vehicle
  is in the store, so that it outlives this process, and in a file (`Aerie.Fleet.Operations.Journal`), so that it
  outlives the gateway; an operation that ran then is `interrupted`.

  | what | limit | beyond it |
  |---|---|---|
  | operations that run | 8, and 8 more that only hold, return or land | refused with `busy` |
  | operations that are known | 64 | the oldest ended one is forgotten |
  | vehicles at once, of one operation | its `step`, 100 at most | they wait |
  """
  use GenServer

  require Logger

  alias Aerie.Base.{Names, Store}
  alias Aerie.Fleet.Operations.{Core, Journal, Request, Work}
  alias Aerie.Fleet.Operations.Sequence.{Ending, GivingWay}
  alias Aerie.Control.Policy.{Audit, Roles}
  alias Aerie.Base.PubSub

  @max_running 8
  @max_known 64
  @ending ~w(hold rtl land)
  # So many vehicles of an operation are named in the audit log.
  @noted 100

  @typedoc """
  An operation as it is kept: `:object` is the request as it came, `:doing` the step of each vehicle that is under
  way, `:then` the id of the operation that brings back those that had begun.
  """
  @type entry :: %{
          id: String.t(),
          object: map(),
          request: Request.t(),
          vehicles: [String.t(), ...],
          core: Core.t(),
          source: Roles.source(),
          via: String.t(),
          at: integer(),
          done_at: integer() | nil,
          doing: %{String.t() => String.t()},
          way: GivingWay.t(),
          then: String.t() | nil
        }
  @type answer :: {:ok, entry()} | {:error, {:busy | :conflict | :role | :unknown | :unavailable, String.t()}}

  @doc "Options: `:gateway`; `:dir`, the folder of its files: without one nothing outlives the gateway."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :operations))

  @doc "Begins an operation. The same id again gives the one that is there."
  @spec begin(Names.gateway(), map(), Request.t(), [String.t(), ...], Roles.source(), String.t()) :: answer()
  def begin(gateway, object, request, vehicles, source, via),
    do: call(gateway, {:begin, object, request, vehicles, source, via})

  @doc """
  Pauses, continues or stops an operation, or aborts it: it stops, what is under way is given up, and a second
  operation ends the flight of those that have begun by the command `:type`.
  """
  @spec change(
          Names.gateway(),
          String.t(),
          :pause | :continue | :stop | {:abort, String.t()},
          Roles.source(),
          String.t()
        ) ::
          answer()
  def change(gateway, id, change, source, via), do: call(gateway, {:change, id, change, source, via})

  @doc """
  Aborts all operations that run, and ends the flight of `vehicles` and of those that were under way by the command
  `type`, in one operation; nil if all of them are at rest.
  """
  @spec abort_all(Names.gateway(), [String.t()], type :: String.t(), Roles.source(), String.t()) ::
          answer() | {:ok, nil}
  def abort_all(gateway, vehicles, type, source, via),
    do: call(gateway, {:abort_all, vehicles, type, source, via})

  @doc "An operation that is known; nil for none."
  @spec entry(Names.gateway(), String.t()) :: entry() | nil
  def entry(gateway, id), do: Store.recall(gateway, {:operation, id})

  @doc "All operations that are known, the latest first."
  @spec entries(Names.gateway()) :: [entry()]
  def entries(gateway) do
    entries = for {{:operation, _id}, entry} <- Store.remembered(gateway), do: entry
    Enum.sort_by(entries, & &1.at, :desc)
  end

  defp call(gateway, message) do
    GenServer.call(Names.via(gateway, :operations), message)
  catch
    :exit, _gone -> {:error, {:unavailable, "the gateway's operations are being restarted; try again"}}
  end

  @impl GenServer
  def init(options) do
    gateway = options[:gateway]
    Process.set_label({:operations, gateway})
    {:ok, tasks} = Task.Supervisor.start_link()
    state = %{gateway: gateway, dir: options[:dir], tasks: tasks, running: %{}, work: %{}}
    state = load(state)

    stale = Enum.reject(entries(gateway), &Core.over?(&1.core))
    state = Enum.reduce(stale, state, &go_on(&1, {Core.interrupted(&1.core), []}, &2))
    {:ok, forget(state, @max_known)}
  end

  defp load(%{dir: nil} = state), do: state

  defp load(%{gateway: gateway, dir: dir} = state) do
    case Journal.load(gateway, dir) do
      {:ok, loaded} ->
        for %{id: id} = entry <- loaded,
            entry(gateway, id) == nil,
            do: Store.remember(gateway, {:operation, id}, entry)

        state

      {:error, reason} ->
        Logger.error(
          "operations: #{dir}: #{:file.format_error(reason)}: operations do not outlive the gateway"
        )

        %{state | dir: nil}
    end
  end

  @impl GenServer
  def handle_call({:begin, object, %{id: id} = request, vehicles, source, via}, _from, state) do
    case entry(state.gateway, id) do
      %{request: ^request, source: %{name: name}} = entry when name == source.name ->
        {:reply, {:ok, entry}, state}

      %{} ->
        {:reply, {:error, {:conflict, "the id #{id} is that of another operation"}}, state}

      nil ->
        with :ok <- room(state, request), :ok <- apart(state, request, vehicles) do
          way = GivingWay.new([id], GivingWay.ends?(request.what))
          state = begin_now(state, object, request, vehicles, source, via, way)
          {:reply, {:ok, entry(state.gateway, id)}, state}
        else
          refusal -> {:reply, refusal, state}
        end
    end
  end

  def handle_call({:change, id, change, source, via}, _from, state) do
    case entry(state.gateway, id) do
      nil ->
        {:reply, {:error, {:unknown, "there is no operation #{id}"}}, state}

      entry ->
        {answer, state} = turn(change, entry, source, via, state)
        {:reply, with(:ok <- answer, do: {:ok, entry(state.gateway, id)}), state}
    end
  end

  def handle_call({:abort_all, vehicles, type, source, via}, _from, state) do
    aborted = Map.values(state.running)

    under_way =
      for {_id, entry} <- state.running, vehicle <- entry.core.under_way, into: MapSet.new(), do: vehicle

    state =
      for {_id, entry} <- state.running, reduce: state do
        state -> abort(entry, source, via, state)
      end

    case Ending.request(state.gateway, Enum.uniq(vehicles ++ MapSet.to_list(under_way)), under_way, type) do
      nil ->
        {:reply, {:ok, nil}, state}

      object ->
        {id, state} = begin_own(state, object, source, via, aborted)
        {:reply, {:ok, entry(state.gateway, id)}, state}
    end
  end

  @impl GenServer
  def handle_info({task, %{verdict: _either} = result}, state) when is_map_key(state.work, task) do
    Process.demonitor(task, [:flush])
    {:noreply, ended(state, task, result)}
  end

  def handle_info({:DOWN, task, :process, _pid, _crash}, state) when is_map_key(state.work, task) do
    reason = "a fault of the gateway ended its work on the vehicle; it may have been commanded"
    {:noreply, ended(state, task, %{verdict: :failed, status: "unknown", reason: reason})}
  end

  def handle_info({:doing, id, vehicle, word}, state) do
    case state.running do
      %{^id => entry} ->
        entry = put_in(entry.doing[vehicle], word)
        show(state, entry)
        {:noreply, put_in(state.running[id], entry)}

      _ended ->
        {:noreply, state}
    end
  end

  def handle_info({:timeout, _timer, {:wait, id, n}}, state) do
    case state.running do
      %{^id => entry} -> {:noreply, go_on(entry, Core.waited(entry.core, n), state)}
      _ended -> {:noreply, state}
    end
  end

  def handle_info(_late, state), do: {:noreply, state}

  # --- Beginning

  # What ends a flight is not kept waiting by operations that do something else.
  defp room(state, request) do
    most = if ends?(request), do: 2 * @max_running, else: @max_running

    if map_size(state.running) >= most,
      do: {:error, {:busy, "#{map_size(state.running)} operations run, as many as there may be; try again"}},
      else: :ok
  end

  defp ends?(%{what: {:command, type, _params}}), do: type in @ending
  defp ends?(%{what: _other}), do: false

  # Two sequences of one vehicle would be two hands on it.
  defp apart(state, %{what: {:sequence, _vehicles}}, vehicles) do
    taken =
      for {id, %{request: %{what: {:sequence, _theirs}}, core: core}} <- state.running,
          theirs = MapSet.union(MapSet.new(core.waiting), core.under_way),
          vehicle <- vehicles,
          vehicle in theirs,
          do: "#{vehicle} is part of the operation #{id}, which runs"

    if taken == [], do: :ok, else: {:error, {:conflict, "nothing was begun: " <> hd(taken)}}
  end

  defp apart(_state, _request, _vehicles), do: :ok

  defp begin_now(state, object, request, vehicles, source, via, way) do
    state = forget(state, @max_known - 2 * @max_running - 1)
    {core, actions} = Core.new(vehicles, request.plan)

    entry = %{
      id: request.id,
      object: object,
      request: request,
      vehicles: vehicles,
      core: core,
      source: source,
      via: via,
      at: now(),
      done_at: nil,
      doing: %{},
      way: way,
      then: nil
    }

    note(state, entry, "begin", source, via)
    written(state, entry.id, fn dir -> Journal.begin(dir, entry) end)
    none = %{core | waiting: vehicles, under_way: MapSet.new()}
    go_on(%{entry | core: none}, {core, actions}, state)
  end

  # One that the gateway begins by itself: room is made for it. What those that it follows have commanded is its own.
  defp begin_own(state, object, source, via, followed) do
    {:ok, request} = Request.parse(object, now())
    {:vehicles, vehicles} = request.targets
    ours = Enum.uniq([request.id | Enum.flat_map(followed, & &1.way.ours)])
    way = GivingWay.new(Enum.take(ours, @max_known), true)
    {request.id, begin_now(state, object, request, vehicles, source, via, way)}
  end

  # --- Changes

  defp turn(:pause, %{core: %{state: :running}} = entry, source, via, state),
    do: {:ok, changed("pause", entry, Core.pause(entry.core), source, via, state)}

  defp turn(:continue, %{core: %{state: :paused}, source: %{name: name}}, %{name: other}, _via, state)
       when name != other,
       do: {{:error, {:role, "#{name} has paused it, and may continue it; you may stop or abort it"}}, state}

  defp turn(:continue, %{core: %{state: from, waiting: [_ | _]}} = entry, source, via, state)
       when from in [:paused, :halted, :interrupted] do
    others = Map.delete(state.running, entry.id)

    with :ok <- room(%{state | running: others}, entry.request),
         :ok <- apart(%{state | running: others}, entry.request, entry.core.waiting) do
      entry = %{entry | source: source, via: via}
      {:ok, changed("continue", entry, Core.continue(entry.core), source, via, state)}
    else
      refusal -> {refusal, state}
    end
  end

  defp turn(:stop, %{core: %{state: from}} = entry, source, via, state) when from not in [:stopped, :done],
    do: {:ok, changed("stop", entry, Core.stop(entry.core), source, via, state)}

  defp turn({:abort, type}, %{then: nil} = entry, source, via, state) do
    under_way = entry.core.under_way
    begun = Core.begun(entry.core)
    state = abort(entry, source, via, state)
    {:ok, bring_back(entry(state.gateway, entry.id), begun, under_way, type, source, via, state)}
  end

  # It is so already, or cannot be any more.
  defp turn(change, %{core: %{state: from}, id: id}, _source, _via, state) do
    done? =
      {change, from} in [pause: :paused, continue: :running, stop: :stopped, stop: :done] or
        match?({:abort, _type}, change)

    if done?,
      do: {:ok, state},
      else: {{:error, {:conflict, "the operation #{id} is #{from}: it cannot #{change}"}}, state}
  end

  defp abort(entry, source, via, state),
    do: changed("abort", entry, Core.abort(entry.core), source, via, state)

  defp changed(change, entry, {core, actions}, source, via, state) do
    note(state, entry, change, source, via)
    go_on(entry, {core, actions}, state)
  end

  defp bring_back(entry, begun, under_way, type, source, via, state) do
    case Ending.request(state.gateway, begun, under_way, type) do
      nil ->
        state

      object ->
        {id, state} = begin_own(state, object, source, via, [entry])
        show(state, %{entry | then: id})
        state
    end
  end

  # --- Going on

  defp ended(state, task, result) do
    {{id, vehicle, _pid}, work} = Map.pop!(state.work, task)
    state = %{state | work: work}

    case state.running do
      %{^id => entry} -> go_on(entry, Core.ended(entry.core, vehicle, result), state)
      _aborted -> state
    end
  end

  defp go_on(entry, {core, actions}, state) do
    entry = keep(state, entry, core, for({:begin, vehicle} <- actions, do: vehicle))

    running =
      if Core.over?(core),
        do: Map.delete(state.running, entry.id),
        else: Map.put(state.running, entry.id, entry)

    state = Enum.reduce(actions, %{state | running: running}, &act(&1, entry, &2))

    # The rest stays where it is; those that have begun come back if that was asked for, and nobody else has commanded
    # them meanwhile.
    if core.state in [:halted, :done] and Core.failing?(core) and entry.request.on_halt == :return and
         entry.then == nil do
      begun = Enum.reject(Core.begun(core), &GivingWay.reason(state.gateway, &1, entry.way))
      bring_back(entry, begun, MapSet.new(), "rtl", entry.source, entry.via, state)
    else
      state
    end
  end

  # What is written is written before it is done.
  defp keep(state, entry, core, begun) do
    over? = Core.over?(core)
    written(state, entry.id, fn dir -> Journal.note(dir, entry.id, entry.core, core, begun, now()) end)
    doing = Map.take(entry.doing, MapSet.to_list(core.under_way))
    entry = %{entry | core: core, doing: doing, done_at: if(over?, do: entry.done_at || now())}
    show(state, entry)
    entry
  end

  defp show(state, entry) do
    :ok = Store.remember(state.gateway, {:operation, entry.id}, entry)
    PubSub.publish(state.gateway, {:notice, :operations}, entry.id)
  end

  defp written(%{dir: nil}, _id, _write), do: :ok

  defp written(%{dir: dir}, id, write) do
    with {:error, reason} <- write.(dir) do
      # After a restart, a file without its last lines would have vehicles begin that had begun.
      _ = Journal.forget(dir, id)
      why = "cannot be written to #{dir}: #{:file.format_error(reason)}"
      Logger.error("operation #{id} #{why}: it goes on, and does not outlive the gateway")
    end
  end

  defp act({:begin, vehicle}, entry, state) do
    {server, id} = {self(), entry.id}

    job = %{
      gateway: state.gateway,
      request: entry.request,
      vehicles: entry.vehicles,
      source: entry.source,
      via: entry.via,
      way: entry.way,
      step: &send(server, {:doing, id, vehicle, &1})
    }

    task = Task.Supervisor.async_nolink(state.tasks, Work, :run, [job, vehicle])
    %{state | work: Map.put(state.work, task.ref, {id, vehicle, task.pid})}
  end

  # The command that it waits for goes on; the next step does not come any more.
  defp act({:cancel, vehicle}, %{id: id}, state) do
    {task, {_id, _vehicle, pid}} = Enum.find(state.work, &match?({_task, {^id, ^vehicle, _pid}}, &1))
    Process.demonitor(task, [:flush])
    _ = Task.Supervisor.terminate_child(state.tasks, pid)
    %{state | work: Map.delete(state.work, task)}
  end

  defp act({:wait, ms, n}, entry, state) do
    _timer = :erlang.start_timer(ms, self(), {:wait, entry.id, n})
    state
  end

  defp note(state, entry, change, source, via) do
    Audit.note(state.gateway, %{
      "type" => "operation",
      "change" => change,
      "id" => entry.id,
      "name" => entry.request.name,
      "vehicles" => Enum.take(entry.vehicles, @noted),
      "count" => length(entry.vehicles),
      "waiting" => length(entry.core.waiting),
      "source" => source.name,
      "via" => via
    })
  end

  defp forget(state, keep) do
    state.gateway
    |> entries()
    |> Enum.filter(& &1.done_at)
    |> Enum.drop(keep)
    |> Enum.each(fn %{id: id} ->
      Store.forget(state.gateway, {:operation, id})
      written(state, id, &Journal.forget(&1, id))
    end)

    state
  end

  defp now, do: System.os_time(:microsecond)
end
