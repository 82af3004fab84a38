defmodule Aerie.Link.Peers do
  @moduledoc """
  The peers of a link, bounded and aged: a value.

  A datagram's sender becomes a peer with its first good frame, never by garbage, however much of it comes from however
  many addresses. Whoever is not known costs a look at a map and at an allowance: only #{100} unknown senders a second,
  #{512} at once, are listened to, the datagrams of the rest are counted (`peers_refused`) and thrown away, so that made-up
  senders take nothing from those that are there. A datagram that does not begin as a frame does gets at most half of that.

  When there are as many peers as allowed, one that never said more than its first words (`Aerie.Link.Peer`, `known`) gives
  way after 5 s, the earliest first; else the newcomer is refused. A known one never does. A peer of datagrams that is silent
  for 60 s is forgotten. Peers that are connections come and go with them.
  """

  alias Aerie.Allowance
  alias Aerie.Link.Peer
  alias Aerie.Address
  alias MavCodec.Parser

  @idle_ms 60_000
  @yields_ms 5_000
  # A quiet line decides what an unknown frame at its end is waiting for.
  @quiet_ms 200
  # Unknown senders that are listened to: one in so many ms, so many at once.
  @newcomer_ms 10
  @newcomers 512

  @enforce_keys [:framing, :parser, :unknown]
  defstruct [:framing, :parser, :newcomers, :unknown] ++
              [max: 256, map: %{}, retired: %{}, sum: %{}, sources: %{}]

  @typedoc """
  - `retired`, `sources`: what the parsers of peers that are gone counted; `sum`: those of the others, as of `measure/1`
  - `parser`: a fresh one for each new peer; `newcomers`: when there will be room for as many new ones as ever
  - `unknown`: `{since, id}` of peers that may give way
  """
  @type t :: %__MODULE__{
          framing: :stream | :datagram,
          parser: Parser.t(),
          newcomers: Allowance.t(),
          max: pos_integer,
          map: %{term => Peer.t()},
          unknown: :gb_sets.set({integer, term}),
          retired: %{atom => non_neg_integer},
          sum: %{atom => integer},
          sources: %{{non_neg_integer, 0..255} => map}
        }

  @type change :: {:up, Peer.t()} | {:down, Peer.t()}

  @doc "None yet. `parser` options are `MavCodec.Parser.new/1`'s."
  @spec new(:stream | :datagram, max :: pos_integer, keyword) :: t
  def new(framing, max, parser_options \\ []) do
    %__MODULE__{framing: framing, parser: Parser.new(parser_options), unknown: :gb_sets.new(), max: max}
  end

  @doc "Whether one more connection is allowed."
  @spec room?(t) :: boolean
  def room?(peers), do: map_size(peers.map) < peers.max

  @doc "Adds a peer that is known to be one: a connection, or the only other end."
  @spec add(t, term, String.t(), integer) :: t
  def add(peers, id, text, now) do
    {_same_name_before, peers} = remove(peers, id)
    put(peers, %{Peer.new(id, text, peers.parser, now) | known: true})
  end

  @doc "Takes a peer away; its counters stay."
  @spec remove(t, term) :: {Peer.t() | nil, t}
  def remove(peers, id) do
    case Map.pop(peers.map, id) do
      {nil, _map} -> {nil, peers}
      {peer, map} -> {peer, peers |> forget(peer) |> Map.put(:map, map)}
    end
  end

  # What it counted moves from those that are there to those that are gone.
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

  @doc "Bytes of a peer: its frames, and whether that made or cost one a place."
  @spec push(t, term, binary, integer, integer) :: {[MavCodec.Frame.t()], [change], t}
  def push(%__MODULE__{map: map} = peers, id, bytes, now, at) do
    case map do
      %{^id => %{known: true} = peer} ->
        {frames, peer} = Peer.push(peer, peers.framing, bytes, now, at)
        {frames, [], %{peers | map: %{map | id => peer}}}

      %{^id => peer} ->
        {frames, peer} = Peer.push(peer, peers.framing, bytes, now, at)
        {frames, [], judge(peers, peer)}

      _unknown when peers.framing == :datagram ->
        newcomer(peers, id, bytes, now, at)

      # A connection that was refused or is over.
      _unknown ->
        {[], [], peers}
    end
  end

  defp judge(peers, peer) do
    if Peer.proven?(peer),
      do:
        put(%{peers | unknown: :gb_sets.del_element({peer.since, peer.id}, peers.unknown)}, %{
          peer
          | known: true
        }),
      else: put(peers, peer)
  end

  defp newcomer(peers, id, bytes, now, at) do
    keep = if begins?(bytes), do: 0, else: div(@newcomers, 2)

    case Allowance.take(peers.newcomers, now, @newcomer_ms, @newcomers, keep) do
      {:ok, newcomers} -> listen(%{peers | newcomers: newcomers}, id, bytes, now, at)
      :none -> {[], [], refused(peers, bytes)}
    end
  end

  defp begins?(<<magic, _rest::binary>>), do: magic in [0xFD, 0xFE]
  defp begins?(<<>>), do: false

  defp refused(%{retired: retired} = peers, bytes) do
    %{peers | retired: sum(retired, %{peers_refused: 1, bytes_in: byte_size(bytes)})}
  end

  defp listen(peers, id, bytes, now, at) do
    {frames, peer} = id |> Peer.new(text(id), peers.parser, now) |> Peer.push(peers.framing, bytes, now, at)

    cond do
      frames == [] -> {[], [], %{peers | retired: sum(peers.retired, counted(Peer.measure(peer).stats))}}
      room?(peers) -> {frames, [{:up, peer}], welcome(peers, peer)}
      true -> replace(peers, peer, frames, bytes, now)
    end
  end

  defp welcome(peers, peer) do
    put(%{peers | unknown: :gb_sets.add_element({peer.since, peer.id}, peers.unknown)}, peer)
  end

  defp replace(peers, peer, frames, bytes, now) do
    with false <- :gb_sets.is_empty(peers.unknown),
         {_since, id} = :gb_sets.smallest(peers.unknown),
         %{framed: framed} = earliest when now - framed >= @yields_ms <- Map.fetch!(peers.map, id) do
      {_earliest, peers} = remove(peers, id)
      {frames, [{:down, earliest}, {:up, peer}], welcome(peers, peer)}
    else
      _none_gives_way -> {[], [], refused(peers, bytes)}
    end
  end

  @doc "Forgets datagram peers that were silent too long, and lets quiet ones end what waited for more bytes."
  @spec tick(t, integer) :: {[{term, [MavCodec.Frame.t()]}], [change], t}
  def tick(peers, now) do
    gone = if peers.framing == :datagram, do: idle(peers, now), else: []
    peers = Enum.reduce(gone, peers, fn peer, peers -> elem(remove(peers, peer.id), 1) end)
    quiet = for {_id, peer} <- peers.map, not peer.flushed, now - peer.heard >= @quiet_ms, do: peer
    {deliveries, peers} = Enum.flat_map_reduce(quiet, peers, &flush/2)
    {deliveries, Enum.map(gone, &{:down, &1}), peers}
  end

  # The only other end stays, heard or not.
  defp idle(peers, now) do
    for {id, peer} <- peers.map, id != :remote, now - peer.heard >= @idle_ms, do: peer
  end

  @doc "Ends all peers, as when the connection is over: their last frames."
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

  @doc "Looks at the parsers of the peers that said something since the last time."
  @spec measure(t) :: t
  def measure(peers) do
    Enum.reduce(peers.map, peers, fn
      {id, %{stats: nil} = peer}, peers ->
        peer = Peer.measure(peer)
        now = counted(peer.stats)
        sum = peers.sum |> sum(now) |> sum(peer.counted, -1)
        %{peers | map: %{peers.map | id => %{peer | counted: now}}, sum: sum}

      {_id, _same}, peers ->
        peers
    end)
  end

  @doc "What all parsers counted, those of peers that are gone included, by the names of `Aerie.Link.Counters`."
  @spec totals(t) :: %{atom => non_neg_integer}
  def totals(peers), do: sum(peers.retired, measure(peers).sum)

  @doc """
  Sequence loss by `{system, component}`, as `MavCodec.Parser` keeps it: of the peer that was heard last, where several
  carry one system, and of peers that are gone.
  """
  @spec sources(t) :: %{{non_neg_integer, 0..255} => map}
  def sources(peers) do
    peers.map
    |> Map.values()
    |> Enum.sort_by(& &1.heard)
    |> Enum.reduce(peers.sources, &Map.merge(&2, Peer.measure(&1).stats.sources))
  end

  # Bounded as one parser is: what forges ids costs the statistics of those that come after.
  defp keep(sources, peer) do
    merged = Map.merge(sources, peer.stats.sources)
    if map_size(merged) <= Parser.Sources.limit(), do: merged, else: sources
  end

  defp put(peers, peer), do: %{peers | map: Map.put(peers.map, peer.id, peer)}

  defp sum(sums, more, sign \\ 1)
  defp sum(sums, nil, _sign), do: sums
  defp sum(sums, more, sign), do: Enum.reduce(more, sums, fn {name, n}, sums -> add(sums, name, sign * n) end)

  defp add(sums, _name, 0), do: sums

  defp add(sums, name, n) do
    case sums do
      %{^name => before} -> %{sums | name => before + n}
      _first -> Map.put(sums, name, n)
    end
  end

  defp counted(stats) do
    stats
    |> Map.take([:crc_errors, :resync_bytes, :unknown_ids, :incompatible, :lost])
    |> Map.merge(%{bytes_in: stats.bytes, frames_in: stats.frames})
  end

  defp text({address, port}), do: Address.format(address, port)
  defp text(id), do: to_string(id)
end
