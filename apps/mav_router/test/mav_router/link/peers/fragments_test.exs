defmodule MavRouter.Link.Peers.FragmentsTest do
  @moduledoc "Senders that cut their frames over several datagrams."
  use ExUnit.Case, async: true

  alias MavRouter.Link.Peers
  alias MavCodec.Messages, as: M

  @sender {{10, 0, 0, 7}, 14_550}

  defp peers, do: Peers.new(:datagram, 8)

  defp beat(seq),
    do:
      IO.iodata_to_binary(
        MavCodec.encode(%M.Heartbeat{type: 2, autopilot: 3}, system: 7, component: 1, seq: seq)
      )

  defp pieces(<<>>, _size), do: []
  defp pieces(bytes, size) when byte_size(bytes) <= size, do: [bytes]

  defp pieces(<<bytes::binary>>, size),
    do: [binary_part(bytes, 0, size) | pieces(binary_part(bytes, size, byte_size(bytes) - size), size)]

  defp send_all(peers, id, datagrams, now) do
    datagrams
    |> Enum.with_index()
    |> Enum.reduce({[], [], peers}, fn {datagram, n}, {frames, changes, peers} ->
      {more, change, peers} = Peers.push(peers, id, datagram, now + n, n)
      {frames ++ more, changes ++ change, peers}
    end)
  end

  for size <- [1, 5, 12, 20, 23, 50] do
    test "frames in datagrams of #{size} bytes are heard, and their sender becomes a peer once" do
      bytes = for seq <- 0..9, into: <<>>, do: beat(seq)
      {frames, changes, peers} = send_all(peers(), @sender, pieces(bytes, unquote(size)), 0)
      assert Enum.map(frames, & &1.seq) == Enum.to_list(0..9)
      assert [{:up, %{id: @sender}}] = changes
      assert %{frames_in: 10, bytes_in: total} = Peers.totals(peers)
      assert total == byte_size(bytes)
    end
  end

  test "a sender that is heard in the middle of a frame is heard from the next one on" do
    bytes = binary_part(beat(0), 7, byte_size(beat(0)) - 7) <> beat(1) <> beat(2)
    {frames, _changes, _peers} = send_all(peers(), @sender, pieces(bytes, 9), 0)
    assert Enum.map(frames, & &1.seq) == [1, 2]
  end

  test "two senders do not mix" do
    [a, b] = pieces(beat(1), 11)
    other = {{10, 0, 0, 8}, 14_550}

    {frames, peers} =
      Enum.flat_map_reduce([{@sender, a}, {other, a}, {@sender, b}, {other, b}], peers(), fn {id, bytes},
                                                                                             peers ->
        {frames, _changes, peers} = Peers.push(peers, id, bytes, 0, 0)
        {frames, peers}
      end)

    assert length(frames) == 2
    assert map_size(peers.map) == 2
  end

  test "what a sender sent counts, although there is no place for it when its frame is whole" do
    [first, second] = pieces(beat(1), 11)
    {[], [], peers} = Peers.push(Peers.new(:datagram, 1), @sender, first, 0, 0)
    {[_frame], _changes, peers} = Peers.push(peers, {{10, 0, 0, 8}, 14_550}, beat(1), 0, 0)
    {[], [], peers} = Peers.push(peers, @sender, second, 0, 0)
    assert %{bytes_in: bytes, peers_refused: 1} = Peers.totals(peers)
    assert bytes == 2 * byte_size(beat(1))
  end

  test "what never becomes a frame is kept for seconds, of few senders, and counted" do
    # A hundred newcomers a second are let in.
    peers =
      for n <- 1..1_000, reduce: peers() do
        peers ->
          {[], [], peers} =
            Peers.push(peers, {{10, 1, div(n, 250), rem(n, 250)}, 1}, <<0xFD, 200, "garbage">>, n * 10, 0)

          peers
      end

    assert map_size(peers.map) == 0
    assert map_size(peers.fragments.peers) == 256
    {_deliveries, _changes, peers} = Peers.tick(peers, 15_001)
    assert peers.fragments.peers == %{}
    assert Peers.totals(peers).bytes_in == 9 * 1_000
  end
end
