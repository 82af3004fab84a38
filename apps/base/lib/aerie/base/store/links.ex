defmodule Aerie.Base.Store.Links do
  @moduledoc """
  Links' snapshots with their peers and sources. There may be thousands of these, so they are rows of their own: a link writes only
  those that changed, and a reader puts them together.

  | row of a link | |
  |---|---|
  | `{:peer, id}` | `%{peer, text, heard, frames_in, bytes_in, sources}`; `heard` is monotonic ms |
  | `{:source, {system, component}}` | sequence loss of peers that are gone, as in `:sources` |
  """

  alias Aerie.Base.Names
  alias Aerie.Base.Store

  # Nobody can use a longer list.
  @max_peers 1_024

  @doc "How many peers of a link are listed."
  @spec max_peers() :: pos_integer()
  def max_peers, do: @max_peers

  @typedoc "Rows to write, and keys of rows to delete; `:all` deletes all earlier ones."
  @type changes :: %{put: [{key :: term, row :: map}], delete: [key :: term] | :all}

  @doc "One link's snapshot with `:peers` and `:sources`; nil when there is none."
  @spec whole(Names.gateway(), id :: term) :: map | nil
  def whole(gateway, id) do
    with %{} = snapshot <- Store.link(gateway, id), do: joined(gateway, id, snapshot)
  end

  @doc "All links' snapshots, as `whole/2`, in the order of their ids."
  @spec all(Names.gateway()) :: [map]
  def all(gateway), do: for(%{id: id} = link <- Store.links(gateway), do: joined(gateway, id, link))

  # The snapshot has them already.
  defp joined(_gateway, _id, %{peers: _, sources: _} = snapshot), do: snapshot

  defp joined(gateway, id, snapshot) do
    rows =
      Store.with_table(
        gateway,
        :link_rows,
        [],
        &:ets.select(&1, [{{{id, :"$1"}, :"$2"}, [], [{{:"$1", :"$2"}}]}])
      )

    now = System.monotonic_time(:millisecond)
    peers = for {{:peer, _id}, peer} <- rows, do: peer
    gone = for {{:source, source}, stats} <- rows, into: %{}, do: {source, stats}

    sources =
      peers |> Enum.sort_by(& &1.heard) |> Enum.reduce(gone, &Map.merge(&2, &1.sources))

    snapshot
    |> Map.put_new(:peers, peers |> Enum.take(@max_peers) |> Enum.map(&peer(&1, now)))
    |> Map.put_new(:sources, sources)
  end

  defp peer(row, now) do
    row |> Map.drop([:heard, :sources]) |> Map.put(:silent_ms, max(now - row.heard, 0))
  end

  @doc false
  @spec change(Names.gateway(), id :: term, changes) :: :ok
  def change(gateway, id, %{put: put, delete: delete}) do
    table = Store.table!(gateway, :link_rows)
    if delete == :all, do: clear(table, id), else: Enum.each(delete, &:ets.delete(table, {id, &1}))
    true = :ets.insert(table, for({key, row} <- put, do: {{id, key}, row}))
    :ok
  end

  defp clear(table, id), do: :ets.match_delete(table, {{id, :_}, :_})
end
