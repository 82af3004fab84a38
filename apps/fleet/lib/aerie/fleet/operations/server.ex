defmodule Aerie.Fleet.Operations.Server do
  @moduledoc """
  Keeps the operations of a gateway: `Aerie.Fleet.Operations.Core` with tasks and timers. What became of each vehicle is in the store, so that it
  outlives this process; an operation does not, and is reported as `interrupted`.

  | what | limit | beyond it |
  |---|---|---|
  | operations that run | 8 | refused with `busy` |
  | operations that are known | 64 | the oldest ended one is forgotten |
  | vehicles at once, of one operation | its `step`, 100 at most | they wait |
  """
  use GenServer

  alias Aerie.Base.{Names, Store}
  alias Aerie.Fleet.Operations.{Core, Request, Work}
  alias Aerie.Control.Policy.Roles
  alias Aerie.Base.PubSub

  @max_running 8
  @max_known 64

  @typedoc "An operation as it is kept."
  @type entry :: %{
          id: String.t(),
          request: Request.t(),
          core: Core.t(),
          source: Roles.source(),
          via: String.t(),
          at: integer(),
          done_at: integer() | nil
        }

  @spec start_link(gateway: Names.gateway()) :: GenServer.on_start()
  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :operations))

  @doc "Begins an operation. The same id again gives the one that is there."
  @spec begin(Names.gateway(), Request.t(), [String.t(), ...], Roles.source(), String.t()) ::
          {:ok, entry()} | {:error, {:busy | :conflict | :unavailable, String.t()}}
  def begin(gateway, request, vehicles, source, via),
    do: call(gateway, {:begin, request, vehicles, source, via})

  @doc "Nothing of it begins any more."
  @spec stop(Names.gateway(), String.t()) :: {:ok, entry()} | {:error, {:unknown | :unavailable, String.t()}}
  def stop(gateway, id), do: call(gateway, {:stop, id})

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
  def init(gateway: gateway) do
    Process.set_label({:operations, gateway})
    {:ok, tasks} = Task.Supervisor.start_link()

    for entry <- entries(gateway), not Core.over?(entry.core) do
      Store.remember(gateway, {:operation, entry.id}, %{
        entry
        | core: Core.interrupted(entry.core),
          done_at: now()
      })
    end

    {:ok, %{gateway: gateway, tasks: tasks, running: %{}, work: %{}}}
  end

  @impl GenServer
  def handle_call({:begin, %{id: id} = request, vehicles, source, via}, _from, state) do
    case entry(state.gateway, id) do
      %{request: ^request, source: ^source} = entry ->
        {:reply, {:ok, entry}, state}

      %{} ->
        {:reply, {:error, {:conflict, "the id #{id} is that of another operation"}}, state}

      nil when map_size(state.running) >= @max_running ->
        {:reply, {:error, {:busy, "#{@max_running} operations run, as many as there may be; try again"}},
         state}

      nil ->
        forget(state.gateway)
        {core, actions} = Core.new(vehicles, request.plan)

        entry = %{
          id: id,
          request: request,
          core: core,
          source: source,
          via: via,
          at: now(),
          done_at: nil
        }

        state = go_on(entry, {core, actions}, state)
        {:reply, {:ok, entry(state.gateway, id)}, state}
    end
  end

  def handle_call({:stop, id}, _from, state) do
    case {state.running[id], entry(state.gateway, id)} do
      {nil, nil} ->
        {:reply, {:error, {:unknown, "there is no operation #{id}"}}, state}

      {nil, ended} ->
        {:reply, {:ok, ended}, state}

      {entry, _kept} ->
        state = go_on(entry, Core.stop(entry.core), state)
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

  def handle_info({:timeout, _timer, {:paused, id, n}}, state) do
    case state.running do
      %{^id => entry} -> {:noreply, go_on(entry, Core.paused(entry.core, n), state)}
      _ended -> {:noreply, state}
    end
  end

  def handle_info(_late, state), do: {:noreply, state}

  defp ended(state, task, result) do
    {{id, vehicle}, work} = Map.pop!(state.work, task)
    state = %{state | work: work}
    entry = Map.fetch!(state.running, id)
    go_on(entry, Core.ended(entry.core, vehicle, result), state)
  end

  defp go_on(entry, {core, actions}, state) do
    over? = Core.over?(core)
    entry = %{entry | core: core, done_at: if(over?, do: now())}
    :ok = Store.remember(state.gateway, {:operation, entry.id}, entry)
    PubSub.publish(state.gateway, {:notice, :operations}, entry.id)

    running =
      if over?, do: Map.delete(state.running, entry.id), else: Map.put(state.running, entry.id, entry)

    Enum.reduce(actions, %{state | running: running}, &act(&1, entry, &2))
  end

  defp act({:begin, vehicle}, entry, state) do
    %{gateway: gateway} = state
    %{request: request, source: source, via: via} = entry
    task = Task.Supervisor.async_nolink(state.tasks, Work, :run, [gateway, vehicle, request, source, via])
    %{state | work: Map.put(state.work, task.ref, {entry.id, vehicle})}
  end

  defp act({:pause, ms, n}, entry, state) do
    _timer = :erlang.start_timer(ms, self(), {:paused, entry.id, n})
    state
  end

  defp forget(gateway) do
    gateway
    |> entries()
    |> Enum.filter(& &1.done_at)
    |> Enum.drop(@max_known - @max_running - 1)
    |> Enum.each(&Store.forget(gateway, {:operation, &1.id}))
  end

  defp now, do: System.os_time(:microsecond)
end
