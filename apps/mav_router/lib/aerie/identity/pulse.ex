defmodule Aerie.Identity.Pulse do
  @moduledoc """
  Asks the gateway's loops a few times a second whether they still turn, and remembers when each answered last.

  A loop is asked by a message in its own mailbox, `{:pulse, pid, tag}`, which it answers with `answer/2`: only a process
  that takes its messages does that. (A system message would not do: a suspended process answers those.) A loop that owes
  an answer is not asked again, so a stuck one gathers no more than one.

  The vehicle's session reads the answers before it sends a heartbeat (`silent/2`). Asked are the store, the notices, the
  router and, for each vehicle, its session and its event loop. A vehicle's heartbeat needs the first three and its own two;
  another vehicle's stuck loop makes it say MAV_STATE_CRITICAL and no more, for a fault stays where it happened.

  This process stuck or dead means that nobody knows, so no heartbeat goes out.

  Telemetry: `[:aerie, :identity, :silent]` and `[:aerie, :identity, :answering]` with `gateway`, `role`, `id` when a loop
  has not answered in time, and when it does again.
  """
  use GenServer

  alias Aerie.Names

  @max_every_ms 500
  @deadman_ms 3_000
  @needed [store: nil, pubsub: nil, router_sweeper: nil]
  @per_vehicle [:session, :events]

  @type tag :: {role :: atom(), id :: term()}

  @doc "Options: `:gateway`, `:config` (its `mavlink.heartbeat_deadman_s`)."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options) do
    GenServer.start_link(__MODULE__, options, name: Names.via(Keyword.fetch!(options, :gateway), :pulse))
  end

  @doc "What a loop does with `{:pulse, pulse, tag}`."
  @spec answer(pid(), tag()) :: :ok
  def answer(pulse, tag) do
    send(pulse, {:alive, tag, self()})
    :ok
  end

  @doc """
  Those of the loops behind a vehicle's heartbeat that have not answered in time; `[{:pulse, nil}]` when nobody asks them.
  """
  @spec silent(Names.gateway(), term()) :: [tag()]
  def silent(gateway, key) do
    Names.with_value(gateway, :pulse, [{:pulse, nil}], fn {table, deadman_ms} ->
      now = now()
      for tag <- [{:pulse, nil}, {:events, key} | @needed], late?(table, tag, now, deadman_ms), do: tag
    end)
  end

  @doc "See `Aerie.Identity.status/1`."
  @spec status(Names.gateway()) :: %{alive: boolean(), silent: [tag()], deadman_ms: pos_integer() | nil}
  def status(gateway) do
    absent = %{alive: false, silent: [{:pulse, nil}], deadman_ms: nil}

    Names.with_value(gateway, :pulse, absent, fn {table, deadman_ms} ->
      now = now()
      needed = for tag <- [{:pulse, nil} | @needed], late?(table, tag, now, deadman_ms), do: tag

      late = for {tag, at, _} <- :ets.tab2list(table), tag not in needed, now - at > deadman_ms, do: tag

      %{alive: needed == [], silent: Enum.sort(needed ++ late), deadman_ms: deadman_ms}
    end)
  end

  @doc "Whether any loop at all is silent."
  @spec any_silent?(Names.gateway()) :: boolean()
  def any_silent?(gateway) do
    Names.with_value(gateway, :pulse, true, fn {table, deadman_ms} ->
      :ets.select_count(table, [{{:_, :"$1", :_}, [{:<, :"$1", now() - deadman_ms}], [true]}]) > 0
    end)
  end

  # Who has never answered is late: a heartbeat is given for what is known.
  defp late?(table, tag, now, deadman_ms) do
    case :ets.lookup(table, tag) do
      [{_tag, at, true}] -> now - at > deadman_ms
      _never -> true
    end
  end

  @impl GenServer
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    Process.set_label({:pulse, gateway})
    table = :ets.new(:pulse, [:set, :protected, read_concurrency: true])
    deadman_ms = deadman_ms(Keyword.get(options, :config))
    Names.put_value(gateway, :pulse, {table, deadman_ms})
    # Often enough that one late answer is no missed one.
    {:ok, _timer} = :timer.send_interval(min(@max_every_ms, div(deadman_ms, 4)), :ask)
    state = %{gateway: gateway, table: table, deadman_ms: deadman_ms, owing: %{}, silent: []}
    {:ok, state, {:continue, :ask}}
  end

  @impl GenServer
  def handle_continue(:ask, state), do: {:noreply, ask(state)}

  @impl GenServer
  def handle_info(:ask, state), do: {:noreply, ask(state)}

  def handle_info({:alive, tag, pid}, state) do
    # An answer of a process that was replaced meanwhile says nothing about its successor.
    case state.owing do
      %{^tag => ^pid} ->
        :ets.insert(state.table, {tag, now(), true})
        {:noreply, %{state | owing: Map.delete(state.owing, tag)}}

      _other ->
        {:noreply, state}
    end
  end

  defp ask(state) do
    :ets.insert(state.table, {{:pulse, nil}, now(), true})
    loops = loops(state.gateway)
    forget(state.table, loops)

    owing =
      for {tag, pid} <- loops, pid != nil, into: %{} do
        if state.owing[tag] != pid, do: send(pid, {:pulse, self(), tag})
        # From here on it has had its time to answer.
        :ets.insert_new(state.table, {tag, now(), false})
        {tag, pid}
      end

    tell(%{state | owing: owing})
  end

  defp loops(gateway) do
    vehicles =
      for role <- @per_vehicle, {id, pid} <- registered(gateway, role), into: %{}, do: {{role, id}, pid}

    for {role, id} <- @needed, into: vehicles, do: {{role, id}, Names.whereis(gateway, role, id)}
  end

  defp registered(gateway, role) do
    Registry.select(Aerie.Registry, [{{{gateway, role, :"$1"}, :"$2", :_}, [], [{{:"$1", :"$2"}}]}])
  end

  # Vehicles that are no more. The needed ones stay, dead or alive.
  defp forget(table, loops) do
    for {tag, _at, _answered} <- :ets.tab2list(table), tag != {:pulse, nil}, not is_map_key(loops, tag) do
      :ets.delete(table, tag)
    end

    :ok
  end

  defp tell(state) do
    %{silent: silent} = status(state.gateway)
    execute(state, :silent, silent -- state.silent)
    execute(state, :answering, state.silent -- silent)
    %{state | silent: silent}
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

  defp deadman_ms(%{mavlink: %{heartbeat_deadman_s: seconds}}) when is_number(seconds),
    do: round(seconds * 1000)

  defp deadman_ms(_absent), do: @deadman_ms

  defp now, do: System.monotonic_time(:millisecond)
end
