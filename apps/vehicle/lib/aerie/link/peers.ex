defmodule Aerie.Link.Peers do
  @moduledoc """
  The peers of a link, bounded and aged: a value.

  A datagram's sender becomes a peer with its first good frame, never by garbage, however much of it comes from however
  many addresses. When there are as many peers as allowed, the one that was silent longest gives way if it was silent for
  5 s; else the newcomer is refused and counted. A peer of datagrams that is silent for 60 s is forgotten. Peers that are
  connections come and go with them.
  """

  alias Aerie.Link.Peer
  alias Aerie.Link.Spec.Address
  alias MavCodec.Parser

  @idle_ms 60_000
  @yields_ms 5_000
  # A quiet line decides what an unknown frame at its end is waiting for.
  @quiet_ms 200

  @enforce_keys [:framing, :parser]
  defstruct [:framing, :parser, max: 256, map: %{}, retired: %{}, sources: %{}]

  @typedoc "`retired`, `sources`: what the parsers of peers that are gone counted; `parser`: a fresh one for each new peer"
  @type t :: %__MODULE__{
          framing: :stream | :datagram,
          parser: Parser.t(),
          max: pos_integer,
          map: %{term => Peer.t()},
          retired: %{atom => non_neg_integer},
          sources: %{{non_neg_integer, 0..255} => map}
        }

  @type change :: {:up, Peer.t()} | {:down, Peer.t()} | :refused

  @doc "None yet. `parser` options are `MavCodec.Parser.new/1`'s."
  @spec new(:stream | :datagram, max :: pos_integer, keyword) :: t
  def new(framing, max, parser_options \\ []) do
    %__MODULE__{framing: framing, parser: Parser.new(parser_options), max: max}
  end

  @doc "Whether one more connection is allowed."
  @spec room?(t) :: boolean
  def room?(peers), do: map_size(peers.map) < peers.max

  @doc "Adds a peer that is known to be one: a connection, or the only other end."
  @spec add(t, term, String.t(), integer) :: t
  def add(peers, id, text, now) do
    {_same_name_before, peers} = remove(peers, id)
    put(peers, Peer.new(id, text, peers.parser, now))
  end

  @doc "Takes a peer away; its counters stay."
  @spec remove(t, term) :: {Peer.t() | nil, t}
  def remove(peers, id) do
    case Map.pop(peers.map, id) do
      {nil, _map} -> {nil, peers}
      {peer, map} -> {peer, retire(%{peers | map: map, sources: keep(peers.sources, peer)}, peer.parser)}
    end
  end

  @doc "Bytes of a peer: its frames, and whether that made or cost one a place."
  @spec push(t, term, binary, integer, integer) :: {[MavCodec.Frame.t()], [change], t}
  def push(%__MODULE__{map: map} = peers, id, bytes, now, at) do
    case map do
      %{^id => peer} ->
        {frames, peer} = Peer.push(peer, peers.framing, bytes, now, at)
        {frames, [], %{peers | map: %{map | id => peer}}}

      _unknown when peers.framing == :datagram ->
        newcomer(peers, id, bytes, now, at)

      # A connection that was refused or is over.
      _unknown ->
        {[], [], peers}
    end
  end

  defp newcomer(peers, id, bytes, now, at) do
    {frames, peer} = id |> Peer.new(text(id), peers.parser, now) |> Peer.push(peers.framing, bytes, now, at)

    cond do
      frames == [] -> {[], [], retire(peers, peer.parser)}
      room?(peers) -> {frames, [{:up, peer}], put(peers, peer)}
      true -> replace(peers, peer, frames, now)
    end
  end

  defp replace(peers, peer, frames, now) do
    oldest = peers.map |> Map.values() |> Enum.min_by(& &1.heard)

    if now - oldest.heard >= @yields_ms do
      {_oldest, peers} = remove(peers, oldest.id)
      {frames, [{:down, oldest}, {:up, peer}], put(peers, peer)}
    else
      {[], [:refused], peers}
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

  @doc "What all parsers counted, those of peers that are gone included, by the names of `Aerie.Link.Counters`."
  @spec totals(t) :: %{atom => non_neg_integer}
  def totals(peers) do
    Enum.reduce(peers.map, peers.retired, fn {_id, peer}, sums -> sum(sums, counted(peer.parser)) end)
  end

  @doc """
  Sequence loss by `{system, component}`, as `MavCodec.Parser` keeps it: of the peer that was heard last, where several
  carry one system, and of peers that are gone.
  """
  @spec sources(t) :: %{{non_neg_integer, 0..255} => map}
  def sources(peers) do
    peers.map
    |> Map.values()
    |> Enum.sort_by(& &1.heard)
    |> Enum.reduce(peers.sources, &Map.merge(&2, Parser.stats(&1.parser).sources))
  end

  # Bounded as one parser is: what forges ids costs the statistics of those that come after.
  defp keep(sources, peer) do
    merged = Map.merge(sources, Parser.stats(peer.parser).sources)
    if map_size(merged) <= Parser.Sources.limit(), do: merged, else: sources
  end

  defp put(peers, peer), do: %{peers | map: Map.put(peers.map, peer.id, peer)}
  defp retire(peers, parser), do: %{peers | retired: sum(peers.retired, counted(parser))}
  defp sum(sums, more), do: Map.merge(sums, more, fn _name, a, b -> a + b end)

  defp counted(parser) do
    stats = Parser.stats(parser)

    stats
    |> Map.take([:crc_errors, :resync_bytes, :unknown_ids, :incompatible, :lost])
    |> Map.merge(%{bytes_in: stats.bytes, frames_in: stats.frames})
  end

  defp text({address, port}), do: Address.format(address, port)
  defp text(id), do: to_string(id)
end
