defmodule Aerie.Link.Core do
  @moduledoc """
  What a link does, without doing it: a pure state machine. `handle/3` takes an event and gives actions, which
  `Aerie.Link` carries out.

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
  | `:start` | begin |
  | `{:opened, info}`, `{:failed, reason}` | outcome of the action `:open` |
  | `{:read, [{peer, bytes}]}` | received |
  | `{:records, [{at, bytes}]}` | replayed |
  | `{:peer_up, peer, text}`, `{:peer_down, peer, reason}` | connections of a server |
  | `{:closed, reason}`, `{:ended, text}` | the connection is over: to be made again, or for good |
  | `:retry` | the back-off's timer, or what was missing may be there now |
  | `{:sniffed, place, baud, sniffed}` | what bytes without frames are: the answer to `:sniff` |
  | `{:count, name, n}` | something to count (`Aerie.Link.Counters`) |
  | `:tick` | every `tick_ms/0` |

  | action | meaning |
  |---|---|
  | `:open`, `:close` | the transport |
  | `{:retry_in, ms}` | a timer for `:retry` |
  | `{:deliver, peer, frames}` | to the router |
  | `{:join, peer, text}` | a peer is new, and may be written to |
  | `{:forget, peer}`, `{:drop, peer}` | a peer is gone, and routes by it are void; end a peer's connection |
  | `{:emit, event, measurements, metadata}` | a telemetry event below `[:aerie, :link]` |
  | `:publish` | the snapshot changed, and by whom the link can be written to may have |
  | `:show` | only what the snapshot shows changed |
  | `{:warn, text}` | a line for the log |
  | `:sniff` | bytes come but no frames: find out what they are |
  | `:relinked` | connected again: its vehicles' streams are to be asked for |
  | `:settled` | the first attempt had its outcome |

  Time is given with each event as `{monotonic ms, unix microseconds}`; the only randomness is a seed in the state.
  """

  alias Aerie.HostClock
  alias Aerie.Link.Backoff
  alias Aerie.Link.Counters
  alias Aerie.Link.Damage
  alias Aerie.Link.Peers
  alias Aerie.Link.Rates
  alias Aerie.Link.Reason
  alias Aerie.Link.Serial.Finding
  alias Aerie.Link.Snapshot
  alias Aerie.Link.Spec
  alias Aerie.Link.Transport

  @tick_ms 250
  # A connection that held this long was a good one: its end is tried again at once.
  @good_ms 2_000
  # For so long bytes came that hold no frame: not ours any more, or the wrong baud rate.
  @garbled_ms 5_000
  @sniff_every_ms 10_000
  # Searches that fail last five seconds, so that one begins every ten.
  @search_ms 5_000
  # A UDP client that hears nothing for so long looks its name up again, a serial port is looked for again.
  @silent_ms 30_000
  # So long after the last datagram that was dropped a link counts as overloaded.
  @overload_ms 10_000

  @enforce_keys [:spec, :peers]
  defstruct [
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
    :damage,
    diagnosis: [],
    phase: :idle,
    backoff: Backoff.new(),
    seed: nil,
    counters: %Counters{},
    rates: Rates.new(),
    info: %{},
    connected_before: false,
    idle_ms: 10_000,
    silent_ms: @silent_ms,
    garbled_ms: @garbled_ms,
    heard: nil,
    sampled: nil
  ]

  @type phase :: :idle | :connecting | :up | :down | :ended
  @type now :: {monotonic_ms :: integer, unix_us :: integer}
  @type t :: %__MODULE__{}
  @type event :: term
  @type action :: term

  @doc "How often `:tick` is due, in ms."
  @spec tick_ms() :: pos_integer
  def tick_ms, do: @tick_ms

  @doc """
  A link that has not begun. Options: `:counters` (of its former life), `:seed` (any term), `:max_peers` (256),
  `:idle_ms` (10,000), `:silent_ms` (30,000), `:garbled_ms` (5,000), `:parser` (options of `MavCodec.Parser.new/1`).
  """
  @spec new(Spec.t(), keyword) :: t
  def new(%Spec{} = spec, options \\ []) do
    framing = Transport.module(spec.kind).framing()

    %__MODULE__{
      spec: spec,
      peers: Peers.new(framing, options[:max_peers] || 256, options[:parser] || []),
      counters: options[:counters] || %Counters{},
      damage: Damage.new(options[:counters] || %Counters{}),
      seed: :rand.seed_s(:exsss, :erlang.phash2(options[:seed])),
      idle_ms: options[:idle_ms] || 10_000,
      silent_ms: options[:silent_ms] || @silent_ms,
      garbled_ms: options[:garbled_ms] || @garbled_ms,
      backoff: if(spec.detect, do: Backoff.new(@search_ms, @search_ms), else: Backoff.new())
    }
  end

  @doc "One event. Events that do not belong to the phase change nothing."
  @spec handle(t, event, now) :: {t, [action]}
  def handle(core, event, now)

  def handle(%{phase: :up} = core, {:read, reads}, now), do: read(core, reads, now)
  def handle(%{phase: :up} = core, {:records, records}, now), do: replay(core, records, now)

  def handle(%{phase: :idle} = core, :start, now), do: connect(core, now)
  def handle(%{phase: :down} = core, :retry, now), do: connect(core, now)

  def handle(%{phase: :connecting} = core, {:opened, info}, {mono, _at} = now) do
    core =
      if single?(core), do: add_peer(core, :remote, info[:peer] || Spec.place(core.spec), mono), else: core

    reconnects = if core.connected_before, do: 1, else: 0

    core =
      %{core | info: info, opened: mono, heard: nil, connected_before: true, retry_at: nil}
      |> found(info)
      |> count(:reconnects, reconnects)
      |> phase(:up, nil, now)

    up = {:emit, :up, %{reconnects: core.counters.reconnects}, %{local: info[:local]}}
    {core, [:publish, :settled, up] ++ if(reconnects > 0, do: [:relinked], else: [])}
  end

  def handle(%{phase: :connecting} = core, {:failed, reason}, now) do
    {core, actions} = down(core, reason, now)
    # Whoever waits for the outcome finds it published.
    {core, actions ++ [:settled]}
  end

  def handle(%{phase: :up} = core, {:closed, reason}, {mono, _at} = now) do
    core = %{core | backoff: ended(core, mono - core.opened)}
    {last, core} = end_peers(core)
    {core, actions} = down(core, reason, now)
    {core, last ++ [:close | actions]}
  end

  def handle(%{phase: :up} = core, {:ended, text}, now) do
    {last, core} = end_peers(core)
    {phase(core, :ended, text, now), last ++ [:close, :publish, {:emit, :ended, %{}, %{reason: text}}]}
  end

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

  # What is not ours any more is looked for again; a port with a baud rate of the configuration is told about.
  def handle(%{phase: :up} = core, {:sniffed, place, baud, sniffed}, {mono, _at} = now) do
    finding = Finding.heard(place, baud, sniffed)
    core = %{core | sniff_at: mono + @sniff_every_ms}

    cond do
      finding.condition == :vehicle or not garbled?(core, mono) -> {core, []}
      core.spec.detect -> handle(core, {:closed, "no MAVLink any more on #{Finding.format(finding)}"}, now)
      true -> {%{core | diagnosis: [finding]}, [{:emit, :garbled, %{}, %{finding: finding}}, :publish]}
    end
  end

  def handle(core, {:count, name, n}, now) when name in [:shed, :kernel_dropped],
    do: core |> count(name, n) |> overloaded(n, now)

  def handle(core, {:count, name, n}, _now), do: {count(core, name, n), []}

  def handle(core, :tick, now), do: core |> set(now) |> tick(now)
  def handle(core, _other, _now), do: {core, []}

  # When the machine's clock was set, the times that are shown move with it. Those of a recording are its own.
  defp set(core, {mono, at}) do
    offset = at - mono * 1000
    step = HostClock.step(core.offset || offset, offset)
    core = %{core | offset: offset}

    if step == 0,
      do: core,
      else: %{core | since: core.since && core.since + step, last_heard: moved(core, step), sampled: nil}
  end

  defp moved(%{spec: %{kind: :replay}} = core, _step), do: core.last_heard
  defp moved(core, step), do: core.last_heard && core.last_heard + step

  # Datagrams came faster than they were read.
  defp overloaded(%{overload: nil} = core, n, {mono, at}) do
    overload = %{since: at, datagrams: n, last: mono}
    {%{core | overload: overload}, [{:emit, :overload, %{datagrams: n}, %{}}]}
  end

  defp overloaded(%{overload: overload} = core, n, {mono, _at}),
    do: {%{core | overload: %{overload | datagrams: overload.datagrams + n, last: mono}}, []}

  defp relieved(%{overload: %{last: last} = overload} = core, mono) when mono - last >= @overload_ms,
    do: {%{core | overload: nil}, [{:emit, :relieved, %{datagrams: overload.datagrams}, %{}}]}

  defp relieved(core, _mono), do: {core, []}

  defp tick(%{phase: :up} = core, {mono, _at} = now) do
    {deliveries, changes, peers} = Peers.tick(core.peers, mono)
    peers = Peers.measure(peers)
    {core, more} = changes(%{core | peers: peers}, changes)
    {core, sniff} = garbled(core, mono)
    {core, relieved} = relieved(core, mono)
    {core, publish} = sample(core, mono)
    actions = deliver(deliveries) ++ more ++ sniff ++ relieved ++ publish

    if silent?(core, mono) do
      {core, closing} =
        handle(core, {:closed, "nothing heard from #{place(core)} for #{div(core.silent_ms, 1000)} s"}, now)

      {core, actions ++ closing}
    else
      {core, actions}
    end
  end

  defp tick(core, {mono, _at}) do
    {core, relieved} = relieved(core, mono)
    {core, publish} = sample(core, mono)
    {core, relieved ++ publish}
  end

  defp ended(core, lasted) do
    cond do
      lasted >= @good_ms -> Backoff.reset(core.backoff)
      # Somebody is there who talks to us: soon again, but not so soon that one who ends each connection at once keeps us busy.
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

  # The way of every byte. Nearly always one datagram of a peer that is known.
  defp read(core, [{id, bytes}], {mono, at}) do
    case Peers.push(core.peers, id, bytes, mono, at) do
      {[], [], peers} ->
        {%{core | peers: peers}, []}

      {frames, [], peers} ->
        counters = Counters.messages(core.counters, frames)
        core = %{core | peers: peers, counters: counters, heard: mono, last_heard: at}
        {core, [{:deliver, id, frames}]}

      {frames, changes, peers} ->
        {core, more} = changes(%{core | peers: peers}, changes)
        deliveries = if frames == [], do: [], else: [{id, frames}]
        {heard(core, deliveries, mono, at), more ++ deliver(deliveries)}
    end
  end

  defp read(core, reads, now), do: batch(core, reads, now)

  # Reads of one peer within a batch become one delivery, in the order in which peers spoke.
  defp batch(core, reads, {mono, at}) do
    {peers, spoken, frames, changes} =
      Enum.reduce(reads, {core.peers, [], %{}, []}, fn {peer, bytes}, {peers, spoken, frames, changes} ->
        {new, change, peers} = Peers.push(peers, peer, bytes, mono, at)

        case frames do
          _any when new == [] -> {peers, spoken, frames, change ++ changes}
          %{^peer => before} -> {peers, spoken, %{frames | peer => [new | before]}, change ++ changes}
          _first -> {peers, [peer | spoken], Map.put(frames, peer, [new]), change ++ changes}
        end
      end)

    deliveries = for peer <- Enum.reverse(spoken), do: {peer, join(frames[peer])}
    {core, more} = changes(%{core | peers: peers}, Enum.reverse(changes))
    {heard(core, deliveries, mono, at), more ++ deliver(deliveries)}
  end

  defp join([frames]), do: frames
  defp join(lists), do: lists |> Enum.reverse() |> Enum.concat()

  # A record is as good as a datagram: what is damaged in one says nothing about the next.
  defp replay(core, records, {mono, at}) do
    {frames, peers} =
      Enum.flat_map_reduce(records, core.peers, fn {recorded, bytes}, peers ->
        {frames, _changes, peers} = Peers.push(peers, :remote, bytes, mono, recorded)
        {frames, peers}
      end)

    deliveries = if frames == [], do: [], else: [{:remote, frames}]
    {heard(%{core | peers: peers}, deliveries, mono, at), deliver(deliveries)}
  end

  defp heard(core, [], _mono, _at), do: core

  defp heard(core, deliveries, mono, at) do
    counters =
      Enum.reduce(deliveries, core.counters, fn {_peer, frames}, c -> Counters.messages(c, frames) end)

    %{core | counters: counters, heard: mono, last_heard: at}
  end

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
  defp single?(core), do: core.spec.kind not in [:udp_server, :tcp_server]

  defp silent?(%{spec: %{kind: :udp_client}} = core, mono) do
    mono - (core.heard || core.opened) >= core.silent_ms
  end

  # Not one of a given baud rate: a radio may be out of range, and what we say may still be heard.
  defp silent?(%{spec: %{detect: detect}} = core, mono) when detect != nil do
    mono - max(core.heard || core.opened, bytes_at(core)) >= core.silent_ms
  end

  defp silent?(_core, _mono), do: false

  defp place(core), do: core.info[:peer] || Spec.place(core.spec)

  # Bytes come, and for five seconds no frame was among them.
  defp garbled(%{spec: %{kind: :serial}} = core, mono) do
    cond do
      not garbled?(core, mono) -> {%{core | diagnosis: [], sniff_at: nil}, []}
      core.sniff_at == nil or mono >= core.sniff_at -> {%{core | sniff_at: mono + @sniff_every_ms}, [:sniff]}
      true -> {core, []}
    end
  end

  defp garbled(core, _mono), do: {core, []}

  defp garbled?(core, mono) do
    bytes_at(core) - (core.heard || core.opened) >= core.garbled_ms and
      mono - bytes_at(core) < core.garbled_ms
  end

  defp bytes_at(%{peers: %{map: %{remote: peer}}}), do: peer.heard
  defp bytes_at(core), do: core.opened

  # What was found, to begin with when it is lost; and what stood in the way, for people.
  defp found(core, %{finding: finding}) when finding != nil do
    %{core | found: %{path: finding.path, baud: finding.baud}, diagnosis: []}
  end

  defp found(core, _info), do: %{core | diagnosis: []}

  # A link on which nothing happens is not published; one whose rates have yet to fall to 0 is.
  defp sample(core, mono) do
    counters = counters(core)
    seen = {counters, map_size(core.peers.map), Snapshot.text(core, mono)}
    moving? = Enum.any?(Rates.per_second(core.rates), fn {_name, rate} -> rate != 0.0 end)
    actions = if moving? or seen != core.sampled, do: [:show], else: []
    {words, damage} = Damage.look(core.damage, counters, mono)
    core = %{core | rates: Rates.sample(core.rates, counters, mono), sampled: seen, damage: damage}
    {core, if(words, do: [{:warn, words} | actions], else: actions)}
  end

  @doc "Something that the snapshot shows, and that is not known here, changed: it is shown at the next tick."
  @spec changed(t) :: t
  def changed(core), do: %{core | sampled: nil}

  @doc "All counters: what was counted here and by the parsers of all peers there ever were."
  @spec counters(t) :: Counters.t()
  def counters(core), do: Counters.merge(core.counters, Peers.totals(core.peers))
end
