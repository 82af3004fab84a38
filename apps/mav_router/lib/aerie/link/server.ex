defmodule Aerie.Link.Server do
  @moduledoc """
  The process of one link: owns the connection, feeds `Aerie.Link.Core` and carries out its actions.

  It reads, checks and counts frames and delivers them to the sessions by itself (`Aerie.Router.deliver/3` runs here), so
  links share no process, and what one does costs no other. See the README of this folder for the way of the data and for
  what a restart costs.
  """
  use GenServer

  require Logger

  alias Aerie.Store
  alias Aerie.Link.Again
  alias Aerie.Link.Core
  alias Aerie.Link.Counters
  alias Aerie.Link.Defaults
  alias Aerie.Link.Egress
  alias Aerie.Link.Opener
  alias Aerie.Link.Restarts
  alias Aerie.Link.Shown
  alias Aerie.Link.Snapshot
  alias Aerie.Link.Spec
  alias Aerie.Successor
  alias Aerie.Link.Transport
  alias Aerie.Names
  alias Aerie.Router
  alias Aerie.Router.Meter
  alias Aerie.Router.Load

  @drops [:unclaimed, :refused, :overload, :looped]

  @doc """
  Options: `:gateway`, `:spec`, `:notify` (an alias that gets `{alias, :ok | {:error, text}}` once, after the first
  attempt), `:home` (where its snapshot is kept: `Aerie.Store`, or a module with its `link/2` and `put_link/4`).
  The core's options are those of `Aerie.Link.Defaults` and of the spec.
  """
  @spec start_link(keyword) :: GenServer.on_start()
  def start_link(options) do
    gateway = Keyword.fetch!(options, :gateway)
    %Spec{id: id} = Keyword.fetch!(options, :spec)
    # Frames hold on to what was read, so old heaps are swept often; queued datagrams stay out of the heap.
    spawn_options = [message_queue_data: :off_heap, fullsweep_after: 50]
    start_options = [name: Names.via(gateway, :link, id), spawn_opt: spawn_options]
    Successor.start(fn -> GenServer.start_link(__MODULE__, options, start_options) end)
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
      transport: Transport.module(spec.kind),
      core: Core.new(spec, core_options(gateway, spec, former, now)),
      restarts: restarts,
      opener: nil,
      retry: nil,
      watched: nil,
      conn: nil,
      sessions: [],
      judged: nil,
      shown: Shown.new(),
      kernel_dropped: 0,
      notify: Keyword.get(options, :notify),
      egress: Egress.open(gateway, spec)
    }

    Process.send_after(self(), :tick, Core.tick_ms())

    # Whoever remembers links (the store) knows of this one from here on, whatever becomes of its first attempt.
    {:ok, publish(state), {:continue, {:start, Restarts.wait(restarts)}}}
  end

  defp core_options(gateway, spec, former, now) do
    counters = if former, do: Counters.add(former.counters, :restarts, 1), else: %Counters{}

    gateway
    |> Defaults.get()
    |> Keyword.merge(Map.to_list(spec.options))
    |> Keyword.merge(counters: counters, seed: {self(), now})
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
    {:noreply, write(state, to, bytes)}
  end

  @impl GenServer
  def handle_info(:tick, state) do
    # One at a time: a link that was busy for seconds owes no ticks.
    Process.send_after(self(), :tick, Core.tick_ms())
    {:noreply, state |> overrun() |> measured() |> step(:tick) |> look()}
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
    {egress, state} = Egress.forward(state.egress, peer, class, frames, mono(), &out(&1, peer, &2), state)
    {:noreply, %{state | egress: egress}}
  end

  def handle_info({:pump, peer}, state) do
    {egress, state} = Egress.pump(state.egress, peer, mono(), &out(&1, peer, &2), state)
    {:noreply, %{state | egress: egress}}
  end

  def handle_info({:rules, owner}, state) do
    {:noreply, sync(%{state | egress: Egress.rules(state.egress, owner, mono())})}
  end

  def handle_info(message, %{conn: nil} = state), do: {:noreply, unknown(state, message)}

  def handle_info(message, state) do
    case state.transport.handle(state.conn, message) do
      {events, conn} -> {:noreply, Enum.reduce(events, latched(%{state | conn: conn}, state), &event/2)}
      :unknown -> {:noreply, unknown(state, message)}
    end
  end

  # What the kernel dropped, because nobody else tells.
  defp overrun(%{conn: nil} = state), do: %{state | kernel_dropped: 0}

  defp overrun(%{transport: transport, kernel_dropped: before} = state) do
    now =
      if function_exported?(transport, :kernel_dropped, 1), do: transport.kernel_dropped(state.conn), else: 0

    state = %{state | kernel_dropped: now}
    if now > before, do: step(state, {:count, :kernel_dropped, now - before}), else: state
  end

  # What a link that is down waits for may have come: a device was plugged in.
  defp look(%{core: %{phase: :down}, watched: watched} = state) do
    if watch(state) == watched, do: state, else: step(state, :retry)
  end

  defp look(state), do: state

  # Silence is no event of the link, but what it is worth falls by it.
  defp measured(state) do
    case judged(Meter.quality(state.gateway, state.spec.id)) do
      same when same == state.judged -> state
      # Shown with this tick.
      judged -> %{state | judged: judged, core: Core.changed(state.core)}
    end
  end

  defp judged(nil), do: nil
  defp judged(quality), do: {round(quality.score), quality.loss, quality.rtt_ms, quality.carries}

  defp watch(state) do
    if function_exported?(state.transport, :watch, 1), do: state.transport.watch(sought(state)), else: nil
  end

  # A search begins with what was found the last time, and leaves other links' ports alone.
  defp sought(%{spec: %{detect: nil} = spec}), do: spec

  defp sought(%{spec: spec} = state) do
    configured = state.gateway |> Defaults.get() |> Keyword.take([:serial_ports, :serial_bauds]) |> Map.new()
    own = %{hint: state.core.found, taken: taken(state)}
    %{spec | options: configured |> Map.merge(spec.options) |> Map.merge(own)}
  end

  defp taken(%{spec: %{detect: :baud}}), do: []

  defp taken(state) do
    for %{id: id, kind: :serial} = link <- Store.links(state.gateway),
        id != state.spec.id,
        path = link.local || link.spec.device,
        do: path
  end

  # A UDP client may answer from elsewhere, and is written to there from now on: before what it said goes anywhere, so that
  # an answer to it finds it.
  defp latched(%{spec: %{kind: :udp_client}, conn: conn} = state, before) when conn != before.conn,
    do: sync(state)

  defp latched(state, _before), do: state

  # Late messages of connections that are closed, exits of processes that did their work.
  defp unknown(state, _message), do: state

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

  # What the transport says goes through the core, unless the connection ended with an event before it.
  defp event(_event, %{conn: nil} = state), do: state
  defp event({:written, {:ok, _bytes}}, state), do: state
  defp event({:written, {:error, _reason}}, state), do: step(state, {:count, :dropped_out, 1})
  defp event({:records, _records} = event, state), do: state |> step(event) |> delivered()
  defp event(event, state), do: step(state, event)

  defp delivered(%{conn: nil} = state), do: state

  defp delivered(state) do
    backlog = state.sessions |> Enum.map(&Load.waiting/1) |> Enum.max(fn -> 0 end)
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
    %{state | opener: Opener.start(sought(state)), retry: nil, watched: watched}
  end

  # Its bytes hold no frames: what are they?
  defp act(:sniff, %{conn: nil} = state), do: state
  defp act(:sniff, state), do: %{state | conn: state.transport.sniff(state.conn)}

  defp act(:relinked, state) do
    Again.tell(state.gateway, state.spec)
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
    spec = state.spec
    source = source(spec, peer)
    if state.home == Store, do: Aerie.Recorder.link_frames(state.gateway, spec.id, frames)
    outcome = Router.deliver(state.gateway, source, frames)
    egress = state.egress |> Egress.radio(peer, frames) |> Egress.asked(peer, frames, mono())
    sessions = if outcome.sessions == [], do: state.sessions, else: outcome.sessions
    %{state | core: dropped(state.core, outcome), egress: egress, sessions: sessions}
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
        "#{state.spec.id} gets more than it can read: #{measurements.datagrams} datagrams dropped so far. " <>
          "Give the gateway more CPU, or spread the vehicles over more links"
      )
    end

    metadata =
      Map.merge(metadata, %{gateway: state.gateway, link: state.spec.id, network: state.spec.network})

    :telemetry.execute([:aerie, :link, event], measurements, metadata)
    state
  end

  defp act(:publish, state), do: state |> sync() |> publish()
  defp act(:show, state), do: state |> others() |> publish()
  defp act(:settled, %{notify: nil} = state), do: state

  defp act(:settled, state) do
    send(
      state.notify,
      {state.notify, if(state.core.phase == :up, do: :ok, else: {:error, state.core.reason})}
    )

    %{state | notify: nil}
  end

  defp dropped(core, %{unclaimed: 0, refused: 0, overload: 0, looped: 0}), do: core

  defp dropped(core, outcome) do
    now = now()

    for name <- @drops, n = Map.fetch!(outcome, name), n > 0, reduce: core do
      core -> elem(Core.handle(core, {:count, name, n}, now), 0)
    end
  end

  defp source(spec, peer) do
    slow? = Map.get(spec.options, :high_latency, false)

    %{
      id: spec.id,
      network: spec.network,
      peer: peer,
      trust: Aerie.Signing.trust(spec),
      high_latency: slow?
    }
  end

  defp publish(state) do
    {changes, shown} = Shown.changes(state.shown, state.core.peers)
    snapshot = snapshot(state, &Snapshot.brief/2)
    :ok = state.home.put_link(state.gateway, state.spec.id, snapshot, changes)
    %{state | shown: shown}
  end

  defp snapshot(state, of) do
    state.core
    |> of.(mono())
    |> Map.merge(%{
      restarts: state.restarts,
      signing: Aerie.Signing.link(state.gateway, state.spec),
      quality: Meter.quality(state.gateway, state.spec.id),
      recording: Aerie.Recorder.shown(state.gateway, {:link, state.spec.id})
    })
  end

  # The peers there are now become endpoints of the router.
  defp sync(%{conn: nil} = state),
    do: %{state | egress: Egress.sync(state.egress, %{}, fn _peer -> nil end, mono())}

  defp sync(state) do
    peers = Map.new(state.core.peers.map, fn {id, peer} -> {id, peer.text} end)

    egress = Egress.line(state.egress, line(state), mono())
    others(%{state | egress: Egress.sync(egress, peers, &direct(state, &1), mono())})
  end

  # What others wrote to the peers' sockets.
  defp others(state) do
    {others, egress} = Egress.others(state.egress)
    %{state | egress: egress, core: %{state.core | counters: Counters.merge(state.core.counters, others)}}
  end

  defp line(%{spec: %{kind: :serial} = spec, core: %{found: found}}),
    do: {(found && found.path) || spec.device, (found && found.baud) || spec.baud}

  defp line(_state), do: nil

  defp direct(%{transport: transport, conn: conn}, peer) do
    if function_exported?(transport, :direct, 2), do: transport.direct(conn, peer)
  end

  defp out(%{conn: nil} = state, _peer, _bytes), do: {:error, step(state, {:count, :dropped_out, 1})}

  defp out(state, peer, bytes) do
    bytes = Aerie.Signing.fill(state.gateway, state.spec, peer, bytes)

    case state.transport.write(state.conn, peer, bytes) do
      # What is for a peer that others write to directly was counted by them.
      {:ok, conn} -> {:ok, sent(%{state | conn: conn}, bytes, not Egress.direct?(state.egress, peer))}
      {:busy, conn} -> {:busy, %{state | conn: conn}}
      {:error, _reason, conn} -> {:error, step(%{state | conn: conn}, {:count, :dropped_out, 1})}
    end
  end

  defp write(%{conn: nil} = state, _to, _bytes), do: step(state, {:count, :dropped_out, 1})
  defp write(state, {:peer, peer}, bytes), do: write_to(state, peer, bytes)

  defp write(state, :all, bytes) do
    Enum.reduce(Map.keys(state.core.peers.map), state, &write_to(&2, &1, bytes))
  end

  defp write_to(state, peer, given) do
    bytes = Aerie.Signing.seal(state.gateway, state.spec.id, peer, given)

    case state.transport.write(state.conn, peer, bytes) do
      {:ok, conn} ->
        sent(%{state | conn: conn}, Aerie.Signing.shown(given, bytes), true)

      {:busy, conn} ->
        step(%{state | conn: conn}, {:count, :dropped_out, 1})

      {:error, _reason, conn} ->
        step(%{state | conn: conn}, {:count, :dropped_out, 1})
    end
  end

  defp sent(state, bytes, count?) do
    if state.home == Store, do: Aerie.Recorder.sent(state.gateway, state.spec.id, state.spec.network, bytes)
    if count?, do: counted(state, IO.iodata_length(bytes)), else: state
  end

  defp counted(state, size) do
    counters = state.core.counters |> Counters.add(:bytes_out, size) |> Counters.add(:writes_out, 1)
    put_in(state.core.counters, counters)
  end

  defp now, do: {mono(), :os.system_time(:microsecond)}
  defp mono, do: :erlang.monotonic_time(:millisecond)
end
