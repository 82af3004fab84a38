defmodule MavRouter.Link.Peers.PublishedPeersTest do
  use ExUnit.Case, async: true

  import Aerie.LinkCase, only: [attitude: 2]

  alias Aerie.Base.PubSub
  alias MavRouter.Link.Core
  alias MavRouter.Link.Peers
  alias MavRouter.Link.Peers.PublishedPeers
  alias MavRouter.Link.Spec
  alias MavRouter.Link.Core.Snapshot
  alias Aerie.Base.Store

  # Peers 1 to n, each with a system of its own, heard by one frame.
  defp peers(n, peers \\ Peers.new(:datagram, 2_000)) do
    Enum.reduce(1..n, peers, fn id, peers -> says(peers, id, id * 20, 1) end)
  end

  defp says(peers, id, ms, value) do
    {_frames, _changes, peers} = Peers.push(peers, id, attitude(rem(id, 250) + 1, value), ms, ms * 1_000)
    peers
  end

  test "one row is written for each peer that was heard, whatever the number of peers" do
    for n <- [10, 1_000] do
      peers = peers(n)
      assert {%{put: rows, delete: :all}, published} = PublishedPeers.changes(PublishedPeers.new(), peers)
      assert length(rows) == n

      measured = Peers.measure(peers)
      assert {%{put: [], delete: []}, published} = PublishedPeers.changes(published, measured)

      peers = measured |> says(3, 30_000, 2) |> says(7, 30_000, 2) |> Peers.measure()
      assert {%{put: rows, delete: []}, published} = PublishedPeers.changes(published, peers)
      assert [{{:peer, 3}, %{frames_in: 2, heard: 30_000}}, {{:peer, 7}, _seven}] = Enum.sort(rows)

      # A peer that leaves keeps its sources.
      {_peer, peers} = Peers.remove(peers, 3)

      assert {%{put: [{{:source, {4, 1}}, %{}}], delete: [{:peer, 3}]}, published} =
               PublishedPeers.changes(published, peers)

      assert {%{put: [], delete: []}, _published} = PublishedPeers.changes(published, peers)
    end
  end

  test "the rest of the snapshot does not grow with the number of peers" do
    core = Core.new(Spec.parse!("udpin::1"), max_peers: 2_000)
    {core, _} = Core.handle(core, :start, {0, 0})
    {core, _} = Core.handle(core, {:opened, %{local: "here"}}, {0, 0})
    words = fn n -> :erts_debug.flat_size(Snapshot.brief(%{core | peers: peers(n)}, 30_000)) end
    assert words.(1_000) == words.(10)
  end

  test "the store has what the link knows of its peers, as they come, speak and leave" do
    gateway = make_ref()
    start_supervised!({Store, gateway: gateway})
    start_supervised!({PubSub, gateway: gateway})
    peers = peers(20)
    {changes, published} = PublishedPeers.changes(PublishedPeers.new(), peers)

    Store.put_link(gateway, "other", %{id: "other"}, %{
      put: [{{:peer, 1}, %{heard: 0, sources: %{}}}],
      delete: []
    })

    Store.put_link(gateway, "a", %{id: "a"}, changes)

    {_peer, peers} = Peers.remove(says(peers, 5, 30_000, 3), 4)
    {changes, _published} = PublishedPeers.changes(published, peers)
    Store.put_link(gateway, "a", %{id: "a"}, changes)

    whole = Store.Links.whole(gateway, "a")
    assert whole.sources == Peers.sources(peers)
    assert Enum.map(whole.peers, & &1.peer) == Enum.to_list(1..20) -- [4]
    assert %{text: "5", frames_in: 2, silent_ms: silent} = Enum.find(whole.peers, &(&1.peer == 5))
    assert silent >= 0
    assert [%{id: "a", peers: [_ | _]}, %{id: "other", peers: [_one]}] = Store.Links.all(gateway)
    assert Store.link(gateway, "a") == %{id: "a"}

    # Replaced or deleted: nothing of the predecessor is left.
    Store.put_link(gateway, "a", %{id: "a"})
    assert %{peers: [], sources: %{}} = Store.Links.whole(gateway, "a")
    Store.delete_link(gateway, "other")
    assert Store.Links.whole(gateway, "other") == nil
  end
end
