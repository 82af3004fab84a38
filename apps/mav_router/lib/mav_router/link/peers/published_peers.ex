defmodule MavRouter.Link.Peers.PublishedPeers do
  @moduledoc """
  What the store has of a link's peers and sources (`Aerie.Base.Store.Links`): a value that knows what has changed since, so that a
  link with a thousand peers writes one row when one of them was heard.
  """

  alias MavRouter.Link.Peers.Peer
  alias MavRouter.Link.Peers
  alias Aerie.Base.Store

  defstruct [:peers, :retired]

  @typedoc "`peers`: when each was heard, and its parser's counts; `retired`: sources of former peers. nil: nothing yet"
  @type t :: %__MODULE__{peers: %{term => {integer, map}} | nil, retired: map | nil}

  @doc "The store has nothing of this link's process yet."
  @spec new() :: t
  def new, do: %__MODULE__{}

  @doc "The writes that bring the store's peers up to date."
  @spec changes(t, Peers.t()) :: {Store.Links.changes(), t}
  def changes(published, peers) do
    before = published.peers || %{}

    {rows, now} =
      Enum.reduce(peers.map, {sources(published.retired || %{}, peers.sources), before}, fn {id, peer},
                                                                                            {rows, now} ->
        mark = {peer.heard, Peer.measure(peer).stats}

        # For a peer that was not heard both are the same term in memory, so comparing them is cheap.
        if before[id] == mark, do: {rows, now}, else: {[row(id, peer, mark) | rows], Map.put(now, id, mark)}
      end)

    left = if map_size(now) > map_size(peers.map), do: Map.keys(now) -- Map.keys(peers.map), else: []
    # A new process may find the rows of its predecessor.
    delete = if published.peers == nil, do: :all, else: for(id <- left, do: {:peer, id})
    {%{put: rows, delete: delete}, %__MODULE__{peers: Map.drop(now, left), retired: peers.sources}}
  end

  # Sources are never deleted; there are at most as many as one parser keeps.
  defp sources(same, same), do: []

  defp sources(before, now),
    do: for({source, stats} <- now, before[source] != stats, do: {{:source, source}, stats})

  defp row(id, peer, {heard, stats}) do
    row = %{
      peer: id,
      text: peer.text,
      heard: heard,
      frames_in: stats.frames,
      bytes_in: stats.bytes,
      sources: stats.sources
    }

    {{:peer, id}, row}
  end
end
