defmodule MavRouter.Link.Server do
  @moduledoc """
  The process of one link: owns the connection, feeds `MavRouter.Link.Core` and performs its actions.

  It reads, checks and counts frames and delivers them to the sessions itself (`MavRouter.Router.deliver/4` runs here): links
  share no process and do not slow each other down. The README of this folder describes the data path and what a restart
  costs.
  """
  use GenServer

  require Logger

  alias Aerie.Base.Store
  alias MavRouter.Link.Core
  alias MavRouter.Link.Core.Counters
  alias MavRouter.Link.Settings
  alias MavRouter.Link.Server.Egress
  alias MavRouter.Link.Server.Connector
  alias MavRouter.Link.Server.Restarts
  alias MavRouter.Link.Peers.PublishedPeers
  alias MavRouter.Link.Core.Snapshot
  alias MavRouter.Link.Spec
  alias MavRouter.Link.Server.Writer
  alias Aerie.Base.Names
  alias MavRouter.Router
  alias MavRouter.Endpoints.Meter
  alias MavRouter.Router.SessionBackpressure

  @drops [:unclaimed, :refused, :overload, :looped]

  @doc """
  Options: `:gateway`, `:spec`, `:notify` (an alias that gets `{alias, :ok | {:error, text}}` once, after the first
  attempt), `:home` (what keeps the snapshot: `Aerie.Base.Store`, or a module with its `Store.link/2` and `Store.put_link/4`). The core
  gets the options of `MavRouter.Link.Settings` and of the spec.
  """
  @spec start_link(keyword) :: GenServer.on_start()
  def start_link(options) do
    gateway = Keyword.fetch!(options, :gateway)
    %Spec{id: id} = Keyword.fetch!(options, :spec)
    # Frames keep whole reads alive, so old heaps are swept often; queued datagrams stay off the heap.
    spawn_options = [message_queue_data: :off_heap, fullsweep_after: 50]
    start_options = [name: Names.via(gateway, :link, id), spawn_opt: spawn_options]
    GenServer.start_link(__MODULE__, options, start_options)
  end

  @impl GenServer
  def init(options) do
    Process.flag(:trap_exit, true)
    gateway = Keyword.fetch!(options, :gateway)
    spec = Keyword.fetch!(options, :spec)
    Process.set_label({:link, spec.id})
    Logger.metadata(link: spec.id)

    home = Keyword.get(options, :home, Store)
    former = home.link(gateway, spec.id)
    now = now()
    restarts = Restarts.add(former[:restarts], elem(now, 0))

    state = %{
      gateway: gateway,
      spec: spec,
      home: home,
      transport: spec.transport,
      core: Core.new(spec, core_options(gateway, spec, former, now)),
      restarts: restarts,
      opener: nil,
      retry: nil,
      # The transport's watch while the link is down (`c:MavRouter.Link.Transport.watch/1`), as of the last attempt.
      watched: nil,
      conn: nil,
      origin: origin(spec),
      router_cache: nil,
      sessions: [],
      quality: nil,
      published: PublishedPeers.new(),
      kernel_dropped: 0,
      notify: Keyword.get(options, :notify),
      egress: Egress.open(gateway, spec)
    }

    Process.send_after(self(), :tick, Core.tick_ms())

    # Published before the first attempt: the store remembers the link, whatever comes of that.
    {:ok, publish(state), {:continue, {:start, Restarts.wait(restarts)}}}
  end

  defp core_options(gateway, spec, former, now) do
    counters = if former, do: Counters.add(former.counters, :restarts, 1), else: %Counters{}

    gateway
    |> Settings.options_of()
    |> Keyword.merge(Map.to_list(spec.options))
    |> Keyword.merge(
      counters: counters,
      seed: {self(), now},
      needed?: &Router.needed?(gateway, {spec.id, &1})
    )
  end

  @impl GenServer
  def handle_continue({:start, 0}, state), do: {:noreply, step(state, :start)}

  def handle_continue({:start, wait}, state) do
    Process.send_after(self(), :start, wait)
    {:noreply, state}
  end

  @impl GenServer
  def handle_call(:snapshot, _from, state) do
    state = sync(state)
    {:reply, snapshot(state, &Snapshot.of/2), state}
  end

  @impl GenServer
  def handle_cast({:send, to, bytes}, state) do
    {:noreply, Writer.send(state, to, bytes)}
  end

  @impl GenServer
  def handle_info(:tick, state) do
    # One timer at a time: a link that was busy for seconds does not catch up on ticks.
    Process.send_after(self(), :tick, Core.tick_ms())
    {:noreply, state |> count_kernel_drops() |> measure_quality() |> step(:tick) |> retry_if_changed()}
  end

  def handle_info(:retry, state), do: {:noreply, step(state, :retry)}
  def handle_info(:start, state), do: {:noreply, step(state, :start)}

  def handle_info({:opener, opener, result}, %{opener: opener} = state) do
    {:noreply, opened(%{state | opener: nil}, result)}
  end

  def handle_info({:EXIT, opener, reason}, %{opener: opener} = state) when is_pid(opener) do
    {:noreply, step(%{state | opener: nil}, {:failed, reason})}
  end

  def handle_info({:forward, peer, frames, class}, state) do
    {egress, state} =
      Egress.forward(state.egress, peer, class, frames, mono(), &Writer.forward(&1, peer, &2), state)

    {:noreply, %{state | egress: egress}}
  end

  def handle_info({:pump, peer}, state) do
    now = mono()
    {egress, state} = Egress.pump(state.egress, peer, now, &Writer.forward(&1, peer, &2), state)
    state = %{state | egress: egress}
    {:noreply, if(Egress.stuck?(egress, peer, now), do: step(state, {:peer_stuck, peer}), else: state)}
  end

  def handle_info({:rules, owner}, state) do
    {:noreply, sync(%{state | egress: Egress.rules(state.egress, owner, mono())})}
  end

  def handle_info(message, %{conn: nil} = state), do: {:noreply, ignore(state, message)}

  def handle_info(message, state) do
    case state.transport.handle(state.conn, message) do
      {events, conn} -> {:noreply, events(events, %{state | conn: conn})}
      :unknown -> {:noreply, ignore(state, message)}
    end
  end

  defp count_kernel_drops(%{conn: nil} = state), do: %{state | kernel_dropped: 0}

  defp count_kernel_drops(%{transport: transport, kernel_dropped: before} = state) do
    now =
      if function_exported?(transport, :kernel_dropped, 1), do: transport.kernel_dropped(state.conn), else: 0

    state = %{state | kernel_dropped: now}
    if now > before, do: step(state, {:count, :kernel_dropped, now - before}), else: state
  end

  # The event that a link waits for may have come: a device was plugged in.
  defp retry_if_changed(%{core: %{phase: :down}, watched: watched} = state) do
    if watch(state) == watched, do: state, else: step(state, :retry)
  end

  defp retry_if_changed(state), do: state

  # A link's quality falls with silence, which is not an event; the new value is published with this tick.
  defp measure_quality(state) do
    case rounded(Meter.quality(state.gateway, state.spec.id)) do
      same when same == state.quality -> state
      quality -> %{state | quality: quality, core: Core.changed(state.core)}
    end
  end

  defp rounded(nil), do: nil
  defp rounded(quality), do: {round(quality.score), quality.loss, quality.rtt_ms, quality.carries}

  defp watch(state) do
    if function_exported?(state.transport, :watch, 1), do: state.transport.watch(prepared(state)), else: nil
  end

  defp prepared(state), do: Connector.prepare(state.spec, state.gateway, state.core.found)

  # Late messages of closed connections, exits of processes that are done.
  defp ignore(state, _message), do: state

  @impl GenServer
  def terminate(_reason, state) do
    Egress.close(state.egress)
    if state.conn, do: state.transport.close(state.conn)
    publish(state)
  end

  defp opened(state, {:ok, conn}) do
    case state.transport.activate(conn) do
      {:ok, conn, info} ->
        step(%{state | conn: conn}, {:opened, info})

      {:error, reason} ->
        state.transport.close(conn)
        step(state, {:failed, reason})
    end
  end

  defp opened(state, {:error, reason}), do: step(state, {:failed, reason})

  defp events([], state), do: state
  defp events([event | rest], state), do: events(rest, event(event, state))

  # Events of the transport go through the core, unless an earlier one of them ended the connection.
  defp event(_event, %{conn: nil} = state), do: state
  defp event({:written, {:ok, _bytes}}, state), do: state

  defp event({:traced, make}, state) do
    if state.home == Store, do: MavRouter.Recorder.link_trace(state.gateway, state.spec.id, make)
    state
  end

  defp event({:written, {:error, _reason}}, state), do: step(state, {:count, :dropped_out, 1})
  defp event({:records, _records} = event, state), do: state |> step(event) |> delivered()
  defp event(:redirected, state), do: sync(state)
  defp event(:passed_on, state), do: %{state | conn: state.transport.passed_on(state.conn, mono())}
  defp event(event, state), do: step(state, event)

  defp delivered(%{conn: nil} = state), do: state

  defp delivered(state) do
    backlog = state.sessions |> Enum.map(&SessionBackpressure.waiting/1) |> Enum.max(fn -> 0 end)
    %{state | conn: state.transport.delivered(state.conn, backlog)}
  end

  defp step(state, event) do
    {core, actions} = Core.handle(state.core, event, now())
    run(actions, %{state | core: core})
  end

  defp run([], state), do: state
  defp run([action | rest], state), do: run(rest, act(action, state))

  defp act(:open, state) do
    _ = if state.retry, do: Process.cancel_timer(state.retry)
    watched = watch(state)
    %{state | opener: Connector.start(prepared(state)), retry: nil, watched: watched}
  end

  defp act(:sniff, %{conn: nil} = state), do: state
  defp act(:sniff, state), do: %{state | conn: state.transport.sniff(state.conn)}

  # Their sessions request their streams: a vehicle may have been restarted, or be on another of its ports, which has
  # other rates.
  defp act(:reconnected, %{gateway: gateway, spec: %{id: id, network: network}} = state) do
    for %{network: ^network, links: links, key: key} <- Store.vehicles(gateway), id in links do
      with session when is_pid(session) <- Names.whereis(gateway, :session, key),
           do: send(session, {:link_reconnected, id})
    end

    state
  end

  defp act(:close, %{conn: nil} = state), do: state

  defp act(:close, state) do
    state.transport.close(state.conn)
    sync(%{state | conn: nil})
  end

  defp act({:retry_in, ms}, state) do
    %{state | retry: Process.send_after(self(), :retry, ms)}
  end

  defp act({:deliver, peer, frames}, state) do
    if state.home == Store, do: MavRouter.Recorder.link_frames(state.gateway, state.spec.id, frames)
    {outcome, cache} = Router.deliver(state.gateway, %{state.origin | peer: peer}, frames, state.router_cache)
    now = mono()
    egress = state.egress |> Egress.radio(peer, frames, now) |> Egress.note_requests(peer, frames, now)
    sessions = if outcome.sessions == [], do: state.sessions, else: outcome.sessions
    dropped(%{state | egress: egress, sessions: sessions, router_cache: cache}, outcome)
  end

  defp act({:join, peer, text}, state) do
    %{state | egress: Egress.join(state.egress, peer, text, &direct(state, &1), mono())}
  end

  defp act({:forget, peer}, state) do
    Router.forget(state.gateway, state.spec.id, peer)
    %{state | egress: Egress.remove(state.egress, peer)}
  end

  defp act({:drop, _peer}, %{conn: nil} = state), do: state
  defp act({:drop, peer}, state), do: %{state | conn: state.transport.drop(state.conn, peer)}

  defp act({:warn, text}, state) do
    Logger.warning("link #{state.spec.id}: #{text}")
    state
  end

  defp act({:emit, event, measurements, metadata}, state) do
    if event == :overload do
      Logger.warning(
        "link #{state.spec.id} receives more than it can read: #{measurements.datagrams} datagrams dropped so far, " <>
          "those of senders that were not heard before first. Give the gateway more CPU, or spread the vehicles over more links"
      )
    end

    metadata =
      Map.merge(metadata, %{gateway: state.gateway, link: state.spec.id, network: state.spec.network})

    :telemetry.execute([:aerie, :link, event], measurements, metadata)
    state
  end

  defp act(:publish, state), do: state |> sync() |> publish()
  defp act(:publish_snapshot, state), do: state |> take_counts() |> publish()
  defp act(:settled, %{notify: nil} = state), do: state

  defp act(:settled, state) do
    send(
      state.notify,
      {state.notify, if(state.core.phase == :up, do: :ok, else: {:error, state.core.reason})}
    )

    %{state | notify: nil}
  end

  defp dropped(state, %{unclaimed: 0, refused: 0, overload: 0, looped: 0}), do: state

  defp dropped(state, outcome) do
    for name <- @drops, n = Map.fetch!(outcome, name), n > 0, reduce: state do
      state -> step(state, {:count, name, n})
    end
  end

  defp origin(spec) do
    %{
      id: spec.id,
      network: spec.network,
      peer: nil,
      trust: MavRouter.Signing.trust(spec),
      high_latency: Map.get(spec.options, :high_latency, false)
    }
  end

  defp publish(state) do
    {changes, published} = PublishedPeers.changes(state.published, state.core.peers)
    snapshot = snapshot(state, &Snapshot.brief/2)
    :ok = state.home.put_link(state.gateway, state.spec.id, snapshot, changes)
    %{state | published: published}
  end

  defp snapshot(state, of) do
    state.core
    |> of.(mono())
    |> Map.merge(%{
      restarts: state.restarts,
      signing: MavRouter.Signing.link(state.gateway, state.spec),
      quality: Meter.quality(state.gateway, state.spec.id),
      recording: MavRouter.Recorder.summary(state.gateway, {:link, state.spec.id})
    })
  end

  # Makes the current peers, and only them, endpoints of the router.
  defp sync(%{conn: nil} = state),
    do: %{state | egress: Egress.sync(state.egress, %{}, fn _peer -> nil end, mono())}

  defp sync(state) do
    peers = Map.new(state.core.peers.map, fn {id, peer} -> {id, peer.text} end)
    egress = Egress.line(state.egress, line(state.core.info), mono())
    take_counts(%{state | egress: Egress.sync(egress, peers, &direct(state, &1), mono())})
  end

  # Adds what others counted who wrote to the peers' sockets.
  defp take_counts(state) do
    {counts, egress} = Egress.take_counts(state.egress)
    %{state | egress: egress, core: %{state.core | counters: Counters.merge(state.core.counters, counts)}}
  end

  defp line(%{baud: baud, local: device}), do: {device, baud}
  defp line(_info), do: nil

  defp direct(%{transport: transport, conn: conn}, peer) do
    if function_exported?(transport, :direct, 2), do: transport.direct(conn, peer)
  end

  defp now, do: {mono(), :os.system_time(:microsecond)}
  defp mono, do: :erlang.monotonic_time(:millisecond)
end
