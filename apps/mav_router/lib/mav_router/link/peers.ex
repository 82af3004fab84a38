defmodule MavRouter.Link.Peers do
  # Unknown senders that are parsed: one per so many ms, and so many in a burst.
  @newcomer_ms 10
  @newcomers 512

  @moduledoc """
  The peers of a link: a value that is bounded, and forgets silent peers.

  The sender of a datagram becomes a peer with its first good frame, never by garbage, however much of it comes from however
  many addresses. Only #{div(1000, @newcomer_ms)} unknown senders per second, in bursts of up to #{@newcomers}, are parsed; the datagrams of the others cost two
  look-ups, are counted (`peers_refused`) and discarded. So forged senders take nothing away from real peers. Datagrams that do
  not begin like a frame get at most half of that allowance. What may be the beginning of a frame is kept for a few seconds
  (`MavRouter.Link.Peers.Fragments`): some senders cut their frames over several datagrams.

  When the limit of peers is reached, a newcomer replaces the earliest peer that has not become known in 5 s
  (`MavRouter.Link.Peers.Peer`); if there is none, the newcomer is refused. Known peers are never replaced. A datagram
  peer is forgotten after 60 s of silence, unless a vehicle is reached by it. The peers of a stream come and go with
  their connections.
  """

  alias Aerie.Base.Timing.TokenBucket
  alias MavRouter.Link.Peers.Fragments
  alias MavRouter.Link.Peers.Peer
  alias Aerie.Base.Net.Address
  alias MavCodec.Parser

  @idle_ms 60_000
  @yields_ms 5_000
  # After this silence, found at two ticks, the parser decides about bytes that might have been the beginning of a frame.
  @quiet_ms 200

  @enforce_keys [:framing, :parser, :unknown]
  defstruct [:framing, :parser, :newcomers, :unknown] ++
              [:max, :fragments, map: %{}, retired: %{}, sum: %{}, sources: %{}]

  @typedoc """
  - `retired`, `sources`: counts of the parsers of former peers; `sum`: counts of the current ones, as of `measure/1`
  - `parser`: copied for each new peer; `newcomers`: the allowance for unknown senders
  - `unknown`: `{since, id}` of the peers that may be replaced
  """
  @type t :: %__MODULE__{
          framing: :stream | :datagram,
          parser: Parser.t(),
          newcomers: TokenBucket.t(),
          fragments: Fragments.t(),
          max: pos_integer,
          map: %{term => Peer.t()},
          unknown: :gb_sets.set({integer, term}),
          retired: %{atom => non_neg_integer},
          sum: %{atom => integer},
          sources: %{{non_neg_integer, 0..255} => map}
        }

  @type change :: {:up, Peer.t()} | {:down, Peer.t()}

  @typedoc "Frames of one peer, in order."
  @type delivery :: {peer :: term, [MavCodec.Frame.t()]}

  @doc "No peers yet. The parser options are those of `MavCodec.Parser.new/1`."
  @spec new(:stream | :datagram, max :: pos_integer, keyword) :: t
  def new(framing, max, parser_options \\ []) do
    %__MODULE__{
      framing: framing,
      parser: Parser.new(parser_options),
      unknown: :gb_sets.new(),
      fragments: Fragments.new(),
      max: max
    }
  end

  @doc "Whether one more connection is allowed."
  @spec room?(t) :: boolean
  def room?(peers), do: map_size(peers.map) < peers.max

  @doc "Adds a peer that is known from the start: a connection, or the only other end."
  @spec add(t, term, String.t(), integer) :: t
  def add(peers, id, text, now) do
    {_former, peers} = remove(peers, id)
    put(peers, %{Peer.new(id, text, peers.parser, now) | known: true})
  end

  @doc "Removes a peer; its counts stay."
  @spec remove(t, term) :: {Peer.t() | nil, t}
  def remove(peers, id) do
    case Map.pop(peers.map, id) do
      {nil, _map} -> {nil, peers}
      {peer, map} -> {peer, peers |> forget(peer) |> Map.put(:map, map)}
    end
  end

  # Its counts move from those of current to those of former peers.
  defp forget(peers, peer) do
    peer = Peer.measure(peer)

    %{
      peers
      | sum: sum(peers.sum, peer.counted, -1),
        retired: sum(peers.retired, counted(peer.stats)),
        sources: keep(peers.sources, peer),
        unknown: :gb_sets.del_element({peer.since, peer.id}, peers.unknown)
    }
  end

  @doc """
  Parses reads that came at `mono` (monotonic ms) and `at` (unix microseconds). Reads of the same peer become one
  delivery; deliveries are in the order in which the peers spoke.
  """
  @spec read(t, [{term, binary | [MavCodec.Frame.t()]}], integer, integer) ::
          {[delivery], [change()], t}
  # Nearly always one datagram.
  def read(peers, [{id, bytes}], mono, at) do
    case push(peers, id, bytes, mono, at) do
      {[], changes, peers} -> {[], changes, peers}
      {frames, changes, peers} -> {[{id, frames}], changes, peers}
    end
  end

  def read(peers, reads, mono, at) do
    {peers, spoken, frames, changes} =
      Enum.reduce(reads, {peers, [], %{}, []}, fn {peer, bytes}, {peers, spoken, frames, changes} ->
        {new, change, peers} = push(peers, peer, bytes, mono, at)

        case frames do
          _any when new == [] -> {peers, spoken, frames, change ++ changes}
          %{^peer => before} -> {peers, spoken, %{frames | peer => [new | before]}, change ++ changes}
          _first -> {peers, [peer | spoken], Map.put(frames, peer, [new]), change ++ changes}
        end
      end)

    deliveries = for peer <- Enum.reverse(spoken), do: {peer, join(frames[peer])}
    {deliveries, Enum.reverse(changes), peers}
  end

  defp join([frames]), do: frames
  defp join(lists), do: lists |> Enum.reverse() |> Enum.concat()

  @doc """
  Parses the records of a recording, each with its own time (unix microseconds). A record is like a datagram: damage in
  one says nothing about the next.
  """
  @spec replay(t, [{integer, binary}], integer) :: {[delivery], t}
  def replay(peers, records, mono) do
    {frames, peers} =
      Enum.flat_map_reduce(records, peers, fn {recorded, bytes}, peers ->
        {frames, _changes, peers} = push(peers, :remote, bytes, mono, recorded)
        {frames, peers}
      end)

    {if(frames == [], do: [], else: [{:remote, frames}]), peers}
  end

  @doc "Parses what a peer sent; returns its frames, and the peers that came or went with them."
  @spec push(t, term, binary | [MavCodec.Frame.t()], integer, integer) :: {[MavCodec.Frame.t()], [change], t}
  def push(%__MODULE__{map: map} = peers, id, bytes, now, at) do
    case map do
      %{^id => %{known: true} = peer} ->
        {frames, peer} = Peer.push(peer, peers.framing, bytes, now, at)
        {frames, [], %{peers | map: %{map | id => peer}}}

      %{^id => peer} ->
        {frames, peer} = Peer.push(peer, peers.framing, bytes, now, at)
        {frames, [], promote(peers, peer)}

      _unknown when peers.framing == :datagram ->
        newcomer(peers, id, bytes, now, at)

      # A connection that was refused or has ended.
      _unknown ->
        {[], [], peers}
    end
  end

  defp promote(peers, peer) do
    if Peer.proven?(peer) do
      unknown = :gb_sets.del_element({peer.since, peer.id}, peers.unknown)
      put(%{peers | unknown: unknown}, %{peer | known: true})
    else
      put(peers, peer)
    end
  end

  defp newcomer(peers, id, bytes, now, at) do
    {begun, fragments} = Fragments.take(peers.fragments, id)
    keep = if begun != nil or frame?(bytes), do: 0, else: div(@newcomers, 2)

    case TokenBucket.take(peers.newcomers, now, @newcomer_ms, @newcomers, keep) do
      {:ok, newcomers} ->
        peer = begun || Peer.new(id, text(id), peers.parser, now)
        parse(%{peers | newcomers: newcomers, fragments: fragments}, {begun, peer}, bytes, now, at)

      :none ->
        {[], [], refused(peers, bytes)}
    end
  end

  defp frame?(<<magic, _rest::binary>>), do: magic in [0xFD, 0xFE]
  defp frame?(<<>>), do: false

  defp refused(%{retired: retired} = peers, bytes) do
    %{peers | retired: sum(retired, %{peers_refused: 1, bytes_in: byte_size(bytes)})}
  end

  defp parse(peers, {begun, peer}, bytes, now, at) do
    {frames, peer} = Peer.push(peer, peers.framing, bytes, now, at)

    cond do
      frames == [] and Peer.waiting?(peer) -> {[], [], begun(peers, peer)}
      frames == [] -> {[], [], retire(peers, [peer])}
      room?(peers) -> {frames, [{:up, peer}], put_unknown(peers, peer)}
      true -> replace(peers, {begun, peer}, frames, bytes, now)
    end
  end

  defp begun(peers, peer) do
    {gone, fragments} = Fragments.put(peers.fragments, peer)
    retire(%{peers | fragments: fragments}, gone)
  end

  # Counts what senders sent that never became peers.
  defp retire(peers, gone),
    do: Enum.reduce(gone, peers, &%{&2 | retired: sum(&2.retired, counted(Peer.measure(&1).stats))})

  defp put_unknown(peers, peer) do
    put(%{peers | unknown: :gb_sets.add_element({peer.since, peer.id}, peers.unknown)}, peer)
  end

  defp replace(peers, {begun, peer}, frames, bytes, now) do
    with false <- :gb_sets.is_empty(peers.unknown),
         {_since, id} = :gb_sets.smallest(peers.unknown),
         %{framed: framed} = earliest when now - framed >= @yields_ms <- Map.fetch!(peers.map, id) do
      {_earliest, peers} = remove(peers, id)
      {frames, [{:down, earliest}, {:up, peer}], put_unknown(peers, peer)}
    else
      _none_to_replace -> {[], [], peers |> retire(List.wrap(begun)) |> refused(bytes)}
    end
  end

  @doc """
  Forgets datagram peers after a long silence, unless a vehicle is reached by one (`needed?`); after a short one,
  parsers give up waiting for more bytes.
  """
  @spec tick(t, integer, (term -> boolean)) :: {[{term, [MavCodec.Frame.t()]}], [change], t}
  def tick(peers, now, needed? \\ fn _peer -> false end) do
    idle = if peers.framing == :datagram, do: idle(peers, now, needed?), else: []
    peers = Enum.reduce(idle, peers, fn peer, peers -> elem(remove(peers, peer.id), 1) end)
    {gone, fragments} = Fragments.expire(peers.fragments, now)
    peers = retire(%{peers | fragments: fragments}, gone)
    quiet = for {_id, peer} <- peers.map, peer.flushed != true, now - peer.heard >= @quiet_ms, do: peer
    # A link that stood still finds its tick before the bytes that came meanwhile, so the next tick decides.
    {due, first} = Enum.split_with(quiet, &(&1.flushed == :due))
    peers = Enum.reduce(first, peers, &put(&2, %{&1 | flushed: :due}))
    {deliveries, peers} = Enum.flat_map_reduce(due, peers, &flush/2)
    {deliveries, Enum.map(idle, &{:down, &1}), peers}
  end

  # The only other end is never forgotten.
  defp idle(peers, now, needed?) do
    for {id, peer} <- peers.map, id != :remote, now - peer.heard >= @idle_ms, not needed?.(id), do: peer
  end

  @doc "Removes all peers, as their connection ended; returns their last frames."
  @spec clear(t) :: {[{term, [MavCodec.Frame.t()]}], t}
  def clear(peers) do
    {deliveries, peers} = peers.map |> Map.values() |> Enum.flat_map_reduce(peers, &flush/2)
    {deliveries, Enum.reduce(Map.keys(peers.map), peers, fn id, peers -> elem(remove(peers, id), 1) end)}
  end

  defp flush(peer, peers) do
    case Peer.flush(peer) do
      {[], peer} -> {[], put(peers, peer)}
      {frames, peer} -> {[{peer.id, frames}], put(peers, peer)}
    end
  end

  @doc "Updates the sums from the parsers of the peers that were heard since the last call."
  @spec measure(t) :: t
  def measure(peers) do
    Enum.reduce(peers.map, peers, fn
      {id, %{stats: nil} = peer}, peers ->
        peer = Peer.measure(peer)
        now = counted(peer.stats)
        sum = peers.sum |> sum(now) |> sum(peer.counted, -1)
        %{peers | map: %{peers.map | id => %{peer | counted: now}}, sum: sum}

      {_id, _unchanged}, peers ->
        peers
    end)
  end

  @doc "The counts of all parsers, those of former peers included, by the names of `MavRouter.Link.Core.Counters`."
  @spec totals(t) :: %{atom => non_neg_integer}
  def totals(peers),
    do: peers |> retire(Map.values(peers.fragments.peers)) |> Map.fetch!(:retired) |> sum(measure(peers).sum)

  @doc """
  Sequence loss by `{system, component}`, as `MavCodec.Parser` keeps it, former peers included. If several peers carry one
  system, that of the peer that was heard last.
  """
  @spec sources(t) :: %{{non_neg_integer, 0..255} => map}
  def sources(peers) do
    peers.map
    |> Map.values()
    |> Enum.sort_by(& &1.heard)
    |> Enum.reduce(peers.sources, &Map.merge(&2, Peer.measure(&1).stats.sources))
  end

  # Bounded like that of one parser: after forged ids, later statistics are not kept.
  defp keep(sources, peer) do
    merged = Map.merge(sources, peer.stats.sources)
    if map_size(merged) <= Parser.Sources.limit(), do: merged, else: sources
  end

  defp put(peers, peer), do: %{peers | map: Map.put(peers.map, peer.id, peer)}

  defp sum(sums, more, sign \\ 1)
  defp sum(sums, nil, _sign), do: sums
  # As a list, because a link does it at every tick, and Enum takes several calls for each key of a map.
  defp sum(sums, more, sign), do: more |> Map.to_list() |> add(sums, sign)

  defp add([], sums, _sign), do: sums
  defp add([{_name, 0} | rest], sums, sign), do: add(rest, sums, sign)

  defp add([{name, n} | rest], sums, sign) do
    case sums do
      %{^name => before} -> add(rest, %{sums | name => before + sign * n}, sign)
      _new -> add(rest, Map.put(sums, name, sign * n), sign)
    end
  end

  defp counted(stats) do
    %{
      bytes_in: stats.bytes,
      frames_in: stats.frames,
      crc_errors: stats.crc_errors,
      resync_bytes: stats.resync_bytes,
      unknown_ids: stats.unknown_ids,
      incompatible: stats.incompatible,
      lost: stats.lost
    }
  end

  defp text({address, port}), do: Address.format(address, port)
  defp text(id), do: to_string(id)
end
