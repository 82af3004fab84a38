defmodule MavRouter.Identity.Watchdog do
  @moduledoc """
  Asks the gateway's processes a few times a second whether they still work, and remembers when each answered last.

  A process is asked by a message in its mailbox, `{:watchdog, pid, tag}`, which it answers with `answer/2`: only a process that
  handles its messages does that. (A system message would not do: a suspended process answers those.) A process that owes an answer
  is not asked again, so a stuck one gathers no more than one message. Its time counts from the question:
  while the machine stands still nobody asks, so nobody is late.

  Asked are the store, the notices, the router and, for each vehicle, its session and its events process. The session reads the
  answers before it sends a heartbeat (`silent/2`), which needs the first three and its own two. If a process of another vehicle is
  stuck the heartbeat says MAV_STATE_CRITICAL and is still sent, for a fault stays where it happened.

  While this process is stuck or dead nobody knows, so no heartbeat goes out.

  Telemetry: `[:aerie, :identity, :silent]` and `[:aerie, :identity, :answering]` with `gateway`, `role`, `id` when a process has not
  answered in time, and when it does again.
  """
  use GenServer

  alias MavRouter.Identity.Settings
  alias Aerie.Base.Names

  @max_every_ms 500
  @needed [store: nil, pubsub: nil, router_sweeper: nil]
  @per_vehicle [:session, :events]

  @type tag :: {role :: atom(), id :: term()}

  @doc "Options: `:gateway`, `:settings` (`MavRouter.Identity.Settings`)."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options) do
    GenServer.start_link(__MODULE__, options, name: Names.via(Keyword.fetch!(options, :gateway), :watchdog))
  end

  @doc "Answers the message `{:watchdog, watchdog, tag}`."
  @spec answer(watchdog :: pid(), tag()) :: :ok
  def answer(watchdog, tag) do
    send(watchdog, {:alive, tag, self()})
    :ok
  end

  @doc """
  The processes that have not answered in time of those that every heartbeat needs and, for a heartbeat to a vehicle
  (its key), of its own; `[{:watchdog, nil}]` when nobody asks them.
  """
  @spec silent(Names.gateway(), term() | nil) :: [tag()]
  def silent(gateway, key) do
    own = if key, do: [{:events, key}], else: []

    Names.read(gateway, :watchdog, [{:watchdog, nil}], fn {table, deadman_ms} ->
      late([{:watchdog, nil}] ++ own ++ @needed, table, now() - deadman_ms)
    end)
  end

  # A process that has never answered is late: a heartbeat says what is known.
  defp late(tags, table, since),
    do: Enum.reject(tags, &match?([{_tag, at, true}] when at >= since, :ets.lookup(table, &1)))

  @doc "See `MavRouter.Identity.status/1`."
  @spec status(Names.gateway()) :: %{alive: boolean(), silent: [tag()], deadman_ms: pos_integer() | nil}
  def status(gateway) do
    absent = %{alive: false, silent: [{:watchdog, nil}], deadman_ms: nil}

    Names.read(gateway, :watchdog, absent, fn {table, deadman_ms} ->
      since = now() - deadman_ms
      needed = late([{:watchdog, nil} | @needed], table, since)
      others = for {tag, at, _} <- :ets.tab2list(table), tag not in needed, at < since, do: tag
      %{alive: needed == [], silent: Enum.sort(needed ++ others), deadman_ms: deadman_ms}
    end)
  end

  @doc """
  Whether any process had not answered in time when they were last asked. Each vehicle's heartbeat wants to know, so that nobody may have
  to look at all answers.
  """
  @spec any_silent?(Names.gateway()) :: boolean()
  def any_silent?(gateway),
    do:
      Names.read(gateway, :watchdog, true, fn {table, _} -> :ets.lookup_element(table, :silent, 2, false) end)

  @impl GenServer
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    Process.set_label({:watchdog, gateway})
    table = :ets.new(:watchdog, [:set, :protected, read_concurrency: true])
    :ets.insert(table, for(tag <- @needed, do: {tag, now(), false}))
    %Settings{deadman_ms: deadman_ms} = Keyword.fetch!(options, :settings)
    Names.put_value(gateway, :watchdog, {table, deadman_ms})
    # Often enough that one late answer is not a missed one.
    {:ok, _timer} = :timer.send_interval(min(@max_every_ms, div(deadman_ms, 4)), :ask)
    state = %{gateway: gateway, table: table, deadman_ms: deadman_ms, asked: now(), owing: %{}, silent: []}
    {:ok, state, {:continue, :ask}}
  end

  @impl GenServer
  def handle_continue(:ask, state), do: {:noreply, ask(state)}

  @impl GenServer
  def handle_info(:ask, state), do: {:noreply, ask(state)}

  def handle_info({:alive, tag, pid}, state) do
    # The answer of a process that was restarted meanwhile says nothing about the new one.
    case state.owing do
      %{^tag => ^pid} ->
        :ets.insert(state.table, {tag, now(), true})
        {:noreply, %{state | owing: Map.delete(state.owing, tag)}}

      _other ->
        {:noreply, state}
    end
  end

  defp ask(state) do
    # The machine stood still, and with it those that owe an answer.
    stood_still? = now() - state.asked > state.deadman_ms
    :ets.insert(state.table, {{:watchdog, nil}, now(), true})
    loops = loops(state.gateway)
    forget(state.table, loops)

    for {tag, pid} <- loops do
      # One that takes the place of another that died without an answer has no more time than that one had.
      if stood_still? or not is_map_key(state.owing, tag), do: restart_time(state.table, tag)
      if pid != nil and state.owing[tag] != pid, do: send(pid, {:watchdog, self(), tag})
    end

    notify(%{state | asked: now(), owing: loops})
  end

  defp restart_time(table, tag) do
    answered? = match?([{_tag, _at, true}], :ets.lookup(table, tag))
    :ets.insert(table, {tag, now(), answered?})
  end

  defp loops(gateway) do
    vehicles =
      for role <- @per_vehicle,
          {id, pid, _value} <- Names.all(gateway, role),
          into: %{},
          do: {{role, id}, pid}

    for {role, id} <- @needed, into: vehicles, do: {{role, id}, Names.whereis(gateway, role, id)}
  end

  # Removed vehicles. The needed ones stay, dead or alive.
  defp forget(table, loops) do
    for {tag, _at, _answered} <- :ets.tab2list(table), tag != {:watchdog, nil}, not is_map_key(loops, tag) do
      :ets.delete(table, tag)
    end

    :ok
  end

  # A process that has yet to answer for the first time is waited for, not complained of: a gateway that starts is not a fault.
  defp notify(state) do
    %{silent: silent} = status(state.gateway)
    :ets.insert(state.table, {:silent, silent != []})
    silent = Enum.reject(silent, &awaited?(state, &1))
    execute(state, :silent, silent -- state.silent)
    execute(state, :answering, state.silent -- silent)
    %{state | silent: silent}
  end

  defp awaited?(%{table: table, deadman_ms: deadman_ms}, tag) do
    case :ets.lookup(table, tag) do
      [{^tag, at, false}] -> now() - at <= deadman_ms
      _answered_before -> false
    end
  end

  defp execute(state, event, tags) do
    for {role, id} <- tags do
      :telemetry.execute([:aerie, :identity, event], %{count: 1}, %{
        gateway: state.gateway,
        role: role,
        id: id
      })
    end

    :ok
  end

  defp now, do: System.monotonic_time(:millisecond)
end
