defmodule Aerie.Link.Shown do
  @moduledoc """
  What of a link's peers and sources stands in the store (`Aerie.Store.Links`): a value, which tells what changed since, so
  that a link of a thousand peers writes a row when one of them spoke.
  """

  alias Aerie.Link.Peer
  alias Aerie.Link.Peers
  alias Aerie.Store

  defstruct [:peers, :gone]

  @typedoc "`peers`: when each was heard and what its parser had counted; `gone`: sources of those that are gone. nil: nothing yet"
  @type t :: %__MODULE__{peers: %{term => {integer, map}} | nil, gone: map | nil}

  @doc "Nothing stands there that is ours."
  @spec new() :: t
  def new, do: %__MODULE__{}

  @doc "What to write, so that the peers of now stand there."
  @spec changes(t, Peers.t()) :: {Store.Links.changes(), t}
  def changes(shown, peers) do
    before = shown.peers || %{}
    gone = shown.gone || %{}

    {rows, now} =
      Enum.reduce(peers.map, {sources(gone, peers.sources), before}, fn {id, peer}, {rows, now} ->
        mark = {peer.heard, Peer.measure(peer).stats}

        # Of a peer that said nothing both are the same in memory, so that comparing costs nothing.
        if before[id] == mark, do: {rows, now}, else: {[row(id, peer, mark) | rows], Map.put(now, id, mark)}
      end)

    left = if map_size(now) > map_size(peers.map), do: Map.keys(now) -- Map.keys(peers.map), else: []
    # A link that is new may find another's rows.
    delete = if shown.peers == nil, do: :all, else: for(id <- left, do: {:peer, id})
    {%{put: rows, delete: delete}, %__MODULE__{peers: Map.drop(now, left), gone: peers.sources}}
  end

  # They never go; there are as many as one parser keeps.
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
