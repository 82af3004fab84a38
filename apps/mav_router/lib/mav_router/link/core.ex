defmodule MavRouter.Link.Core do
  @moduledoc """
  The state machine of a link, pure: `handle/3` takes an event and returns actions, which `MavRouter.Link.Server` performs.

  ```mermaid
  stateDiagram-v2
    idle --> connecting: start
    connecting --> up: opened
    connecting --> down: failed
    up --> down: closed
    down --> connecting: retry (after the back-off)
    up --> ended: ended (a recording is over)
  ```

  | event | meaning |
  |---|---|
  | `:start` | connect |
  | `{:opened, info}`, `{:failed, reason}` | result of the action `:open` |
  | `{:read, [{peer, bytes}]}` | received |
  | `{:records, [{at, bytes}]}` | replayed |
  | `{:peer_up, peer, text}`, `{:peer_down, peer, reason}` | connections of a server |
  | `{:peer_stuck, peer}`, `{:refused, n, text}` | a peer that takes nothing; connections beyond a limit |
  | `{:closed, reason}`, `{:ended, text}` | the connection ended: connect again, or never again |
  | `{:warning, text}` | for the log |
  | `:retry` | the back-off is over, or what was missing may have come |
  | `{:sniffed, place, baud, sniffed}` | what bytes without frames are: the result of `:sniff` |
  | `{:count, name, n}` | something to count (`MavRouter.Link.Core.Counters`) |
  | `:tick` | every `tick_ms/0` |

  | action | meaning |
  |---|---|
  | `:open`, `:close` | open or close the transport |
  | `{:retry_in, ms}` | set a timer for `:retry` |
  | `{:deliver, peer, frames}` | deliver frames to the router |
  | `{:join, peer, text}` | a new peer: make it an endpoint |
  | `{:forget, peer}`, `{:drop, peer}` | a peer is gone: forget its routes; end the connection to a peer |
  | `{:emit, event, measurements, metadata}` | execute a telemetry event below `[:aerie, :link]` |
  | `:publish` | publish the snapshot, and make the peers endpoints |
  | `:publish_snapshot` | publish the snapshot only |
  | `{:warn, text}` | log a warning |
  | `:sniff` | bytes come but no frames: find out what they are |
  | `:reconnected` | have the streams of its vehicles requested again |
  | `:settled` | the first attempt has its result |

  Every event comes with its time, `{monotonic ms, unix microseconds}`; the only randomness is a seed in the state.
  """

  alias Aerie.Base.Timing.HostClock
  alias Aerie.Base.Timing.Backoff
  alias MavRouter.Link.Core.Counters
  alias MavRouter.Link.Core.DamageLog
  alias MavRouter.Link.Core.Reception
  alias MavRouter.Link.Core.Overload
  alias MavRouter.Link.Peers
  alias MavRouter.Link.Core.Rates
  alias MavRouter.Link.Reason
  alias MavRouter.Link.Serial.Finding
  alias MavRouter.Link.Settings
  alias MavRouter.Link.Core.Snapshot
  alias MavRouter.Link.Spec
  alias MavRouter.Link.Core.Stall

  @tick_ms 250
  # After a connection that lasted this long the link connects again at once.
  @good_ms 2_000
  # Bytes without a frame for this long: no longer MAVLink, or a wrong baud rate.
  @garbled_ms 5_000
  # A search that fails takes five seconds, so that one begins every ten.
  @search_ms 5_000
  # After this silence a UDP client resolves its name again, and a detected serial port is searched for again, unless a
  # vehicle that is not lost is reached by it.
  @silent_ms 30_000
  @silent_high_latency_ms 3_600_000

  # Between two warnings of refused connections.
  @refused_ms 60_000

  @enforce_keys [:spec, :peers]
  defstruct [
    :refused_at,
    :spec,
    :peers,
    :reason,
    :retry_at,
    :since,
    :opened,
    :last_heard,
    :offset,
    :found,
    :sniff_at,
    :overload,
    :behind,
    :damage,
    :idle_ms,
    :silent_ms,
    :needed?,
    diagnosis: [],
    phase: :idle,
    backoff: Backoff.new(),
    seed: nil,
    counters: %Counters{},
    rates: Rates.new(),
    info: %{},
    connected_before: false,
    garbled_ms: @garbled_ms,
    heard: nil,
    sampled: nil
  ]

  @type phase :: :idle | :connecting | :up | :down | :ended
  @type now :: {monotonic_ms :: integer, unix_us :: integer}
  @type t :: %__MODULE__{}
  @type event :: term
  @type action :: term

  @doc "The interval of `:tick` in ms."
  @spec tick_ms() :: pos_integer
  def tick_ms, do: @tick_ms

  @doc """
  A link before its start. Options: `:counters` (of its former process), `:seed` (any term), `:silent_ms` (#{@silent_ms}; on
  a link of high latency #{@silent_high_latency_ms}), `:garbled_ms` (#{@garbled_ms}), `:needed?` (whether a vehicle is
  reached by a peer), and those of `MavRouter.Link.Settings`: `:max_peers`, `:idle_ms`, `:parser` (options of
  `MavCodec.Parser.new/1`).
  """
  @spec new(Spec.t(), keyword) :: t
  def new(%Spec{} = spec, options \\ []) do
    options = %{} |> Settings.from() |> Settings.options() |> Keyword.merge(options)

    %__MODULE__{
      spec: spec,
      peers: Peers.new(spec.framing, options[:max_peers], options[:parser]),
      counters: options[:counters] || %Counters{},
      damage: DamageLog.new(options[:counters] || %Counters{}),
      seed: :rand.seed_s(:exsss, :erlang.phash2(options[:seed])),
      idle_ms: options[:idle_ms],
      silent_ms: options[:silent_ms] || silent_ms(spec),
      needed?: options[:needed?] || fn _peer -> false end,
      garbled_ms: options[:garbled_ms] || @garbled_ms,
      backoff: if(spec.detect, do: Backoff.new(@search_ms, @search_ms), else: Backoff.new())
    }
  end

  defp silent_ms(%{options: %{high_latency: true}}), do: @silent_high_latency_ms
  defp silent_ms(_spec), do: @silent_ms

  @doc "Handles one event. An event that does not belong to the phase changes nothing."
  @spec handle(t, event, now) :: {t, [action]}
  def handle(core, event, now)

  def handle(%{phase: :up} = core, {:read, reads}, now), do: read(core, reads, now)
  def handle(%{phase: :up} = core, {:records, records}, now), do: replay(core, records, now)

  def handle(%{phase: :idle} = core, :start, now), do: connect(core, now)
  def handle(%{phase: :down} = core, :retry, now), do: connect(core, now)

  def handle(%{phase: :connecting} = core, {:opened, info}, {mono, _at} = now) do
    core =
      if core.spec.server, do: core, else: add_peer(core, :remote, info[:peer] || Spec.place(core.spec), mono)

    reconnects = if core.connected_before, do: 1, else: 0

    core =
      %{core | info: info, opened: mono, heard: nil, connected_before: true, retry_at: nil}
      |> Reception.found(info)
      |> count(:reconnects, reconnects)
      |> phase(:up, nil, now)

    up = {:emit, :up, %{reconnects: core.counters.reconnects}, %{local: info[:local]}}
    # Only the first time: a link that connects often would say it often.
    warn = if reconnects == 0 and info[:warning], do: [{:warn, info[:warning]}], else: []
    {core, [:publish, :settled, up] ++ warn ++ if(reconnects > 0, do: [:reconnected], else: [])}
  end

  def handle(%{phase: :connecting} = core, {:failed, reason}, now) do
    {core, actions} = down(core, reason, now)
    # Last, so that the result is published before a waiting caller gets it.
    {core, actions ++ [:settled]}
  end

  def handle(%{phase: :up} = core, {:closed, reason}, {mono, _at} = now) do
    core = %{core | backoff: backoff(core, mono - core.opened)}
    {last, core} = end_peers(core)
    {core, actions} = down(core, reason, now)
    {core, last ++ [:close | actions]}
  end

  def handle(%{phase: :up} = core, {:ended, text}, now) do
    {last, core} = end_peers(core)
    {phase(core, :ended, text, now), last ++ [:close, :publish, {:emit, :ended, %{}, %{reason: text}}]}
  end

  def handle(core, {:warning, text}, _now), do: {core, [{:warn, text}]}

  def handle(%{phase: :up} = core, {:peer_up, peer, text}, {mono, _at}) do
    if Peers.room?(core.peers) do
      {add_peer(core, peer, text, mono), [{:join, peer, text}, {:emit, :peer_up, %{}, %{peer: text}}]}
    else
      {count(core, :peers_refused, 1), [{:drop, peer}]}
    end
  end

  def handle(%{phase: :up} = core, {:peer_down, id, reason}, _now) do
    case Peers.remove(core.peers, id) do
      {nil, _peers} -> {core, []}
      {peer, peers} -> {%{core | peers: peers}, peer_down(core, peer, reason)}
    end
  end

  # Only a server can do without one peer: another link's only one may come back.
  def handle(%{phase: :up, spec: %{server: true, framing: :stream}} = core, {:peer_stuck, id}, now) do
    case handle(core, {:peer_down, id, "took nothing for #{Stall.stuck_s()} s"}, now) do
      {core, []} -> {core, []}
      {core, actions} -> {core, [{:drop, id} | actions]}
    end
  end

  def handle(%{phase: :up, spec: %{server: true}} = core, {:refused, n, text}, {mono, _at}) do
    core = count(core, :peers_refused, n)

    if core.refused_at != nil and mono - core.refused_at < @refused_ms,
      do: {core, []},
      else: {%{core | refused_at: mono}, [{:warn, text}]}
  end

  # A detected port that no longer speaks MAVLink is searched for again; for a configured one the diagnosis says so.
  def handle(%{phase: :up} = core, {:sniffed, place, baud, sniffed}, {mono, _at} = now) do
    finding = Finding.from_listening(place, baud, sniffed)
    core = Reception.sniffed(core, mono)

    cond do
      finding.condition == :vehicle or not Reception.garbled?(core, mono) -> {core, []}
      core.spec.detect -> handle(core, {:closed, "no more MAVLink on #{Finding.format(finding)}"}, now)
      true -> {%{core | diagnosis: [finding]}, [{:emit, :garbled, %{}, %{finding: finding}}, :publish]}
    end
  end

  def handle(core, {:count, name, n}, now) when name in [:shed, :shed_new, :kernel_dropped],
    do: core |> count(name, n) |> Overload.datagrams(n, now)

  def handle(core, {:count, :overload, n}, now),
    do: core |> count(:overload, n) |> Overload.frames(n, now)

  def handle(core, {:count, name, n}, _now), do: {count(core, name, n), []}

  def handle(core, :tick, now), do: core |> follow_clock(now) |> tick(now)
  def handle(core, _other, _now), do: {core, []}

  # When the system clock is set, the published times move with it. A recording has times of its own.
  defp follow_clock(core, {mono, at}) do
    offset = at - mono * 1000
    step = HostClock.step(core.offset || offset, offset)
    core = %{core | offset: offset}

    if step == 0,
      do: core,
      else: %{core | since: core.since && core.since + step, last_heard: moved(core, step), sampled: nil}
  end

  defp moved(%{spec: %{recorded: true}} = core, _step), do: core.last_heard
  defp moved(core, step), do: core.last_heard && core.last_heard + step

  defp tick(%{phase: :up} = core, {mono, _at} = now) do
    {deliveries, changes, peers} = Peers.tick(core.peers, mono, core.needed?)
    peers = Peers.measure(peers)
    {core, more} = changes(%{core | peers: peers}, changes)
    {core, sniff} = Reception.sniff(core, mono)
    {core, relieved} = Overload.relieved(core, mono)
    {core, publish} = sample(core, mono)
    actions = deliver(deliveries) ++ more ++ sniff ++ relieved ++ publish

    if Reception.silent?(core, mono) do
      {core, closing} =
        handle(core, {:closed, "nothing heard from #{place(core)} for #{div(core.silent_ms, 1000)} s"}, now)

      {core, actions ++ closing}
    else
      {core, actions}
    end
  end

  defp tick(core, {mono, _at}) do
    {core, relieved} = Overload.relieved(core, mono)
    {core, publish} = sample(core, mono)
    {core, relieved ++ publish}
  end

  defp backoff(core, lasted) do
    cond do
      lasted >= @good_ms -> Backoff.reset(core.backoff)
      # The other end speaks MAVLink: soon, but an end that closes each connection at once must not keep us busy.
      core.heard -> Backoff.soon(core.backoff)
      true -> core.backoff
    end
  end

  defp connect(core, now) do
    {phase(core, :connecting, core.reason, now), [:open, :publish]}
  end

  defp down(core, reason, {mono, _at} = now) do
    {random, seed} = :rand.uniform_s(core.seed)
    {wait, backoff} = Backoff.next(core.backoff, random)
    text = Reason.format(reason, core.spec)
    diagnosis = with {:undetected, findings} <- reason, do: findings, else: (_fault -> [])

    core = %{core | seed: seed, backoff: backoff, retry_at: mono + wait, info: %{}}
    core = %{core | diagnosis: diagnosis, sniff_at: nil}

    down = {:emit, :down, %{retry_ms: wait, attempt: backoff.attempt}, %{reason: text}}
    {phase(core, :down, text, now), [:publish, {:retry_in, wait}, down]}
  end

  defp phase(core, phase, reason, {_mono, at}), do: %{core | phase: phase, reason: reason, since: at}

  # Every received byte comes through here.
  defp read(core, reads, {mono, at}) do
    {deliveries, changes, peers} = Peers.read(core.peers, reads, mono, at)
    core = note_senders(core, peers, deliveries, mono, at)

    if changes == [] do
      {core, deliver(deliveries)}
    else
      {core, actions} = changes(core, changes)
      {core, actions ++ deliver(deliveries)}
    end
  end

  defp replay(core, records, {mono, at}) do
    {deliveries, peers} = Peers.replay(core.peers, records, mono)
    {note_senders(core, peers, deliveries, mono, at), deliver(deliveries)}
  end

  defp note_senders(core, peers, [], _mono, _at), do: %{core | peers: peers}

  defp note_senders(core, peers, deliveries, mono, at) do
    %{core | peers: peers, counters: messages(deliveries, core.counters), heard: mono, last_heard: at}
  end

  defp messages([], counters), do: counters
  defp messages([{_peer, frames} | rest], counters), do: messages(rest, Counters.messages(counters, frames))

  defp deliver([{peer, frames}]), do: [{:deliver, peer, frames}]
  defp deliver(deliveries), do: for({peer, frames} <- deliveries, do: {:deliver, peer, frames})

  defp changes(core, changes) do
    Enum.reduce(changes, {core, []}, fn
      {:up, peer}, {core, actions} ->
        {core, actions ++ [{:join, peer.id, peer.text}, {:emit, :peer_up, %{}, %{peer: peer.text}}]}

      {:down, peer}, {core, actions} ->
        {core, actions ++ peer_down(core, peer, :idle)}
    end)
  end

  defp peer_down(core, peer, reason) do
    reason = if reason == :idle, do: "silent", else: Reason.format(reason, core.spec)
    [{:forget, peer.id}, {:emit, :peer_down, %{}, %{peer: peer.text, reason: reason}}]
  end

  defp end_peers(core) do
    ids = Map.keys(core.peers.map)
    {deliveries, peers} = Peers.clear(core.peers)
    {deliver(deliveries) ++ for(id <- ids, do: {:forget, id}), %{core | peers: peers}}
  end

  defp add_peer(core, id, text, mono), do: %{core | peers: Peers.add(core.peers, id, text, mono)}
  defp count(core, _name, 0), do: core
  defp count(core, name, n), do: %{core | counters: Counters.add(core.counters, name, n)}

  defp place(core), do: core.info[:peer] || Spec.place(core.spec)

  # A link on which nothing happens is not published, unless its rates have yet to fall to 0.
  defp sample(core, mono) do
    counters = counters(core)
    seen = {counters, map_size(core.peers.map), Snapshot.text(core, mono)}
    actions = if Rates.any?(core.rates) or seen != core.sampled, do: [:publish_snapshot], else: []
    {words, damage} = DamageLog.check(core.damage, counters, mono)
    core = %{core | rates: Rates.sample(core.rates, counters, mono), sampled: seen, damage: damage}
    {core, if(words, do: [{:warn, words} | actions], else: actions)}
  end

  @doc "A part of the snapshot that is not known here changed: publish it with the next tick."
  @spec changed(t) :: t
  def changed(core), do: %{core | sampled: nil}

  @doc "All counters: those of the link, and those of the parsers of all its peers, past ones included."
  @spec counters(t) :: Counters.t()
  def counters(core), do: Counters.merge(core.counters, Peers.totals(core.peers))
end
