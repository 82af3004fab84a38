defmodule MavRouter.Link.PymavlinkTest do
  use ExUnit.Case, async: true
  use Aerie.LinkCase

  import Aerie.PythonPeer

  alias MavRouter.Router

  @moduletag :python
  @count 300
  # Our own heartbeat: an onboard controller at system 237, component 191, as the gateway's own that may come first.
  @hello [type: 18, autopilot: 8, component: 191]

  setup do
    gateway = start_parts()
    be_session(gateway, 7)
    {:ok, gateway: gateway}
  end

  # A port that nobody listens on and that nobody is given by chance: it is bound, and may be bound again.
  defp reserved_port do
    {:ok, socket} = :socket.open(:inet, :stream, :tcp)
    :ok = :socket.setopt(socket, {:socket, :reuseaddr}, true)
    :ok = :socket.bind(socket, %{family: :inet, addr: {127, 0, 0, 1}, port: 0})
    on_exit(fn -> :socket.close(socket) end)
    {:ok, %{port: port}} = :socket.sockname(socket)
    port
  end

  defp all_there(c, id, peer) do
    frames = frames(@count + 1)
    assert [0 | _] = Enum.map(frames, & &1.id)
    assert frames |> Enum.drop(1) |> Enum.map(&number/1) == Enum.to_list(1..@count)
    assert :ok = Router.send(c.gateway, {"main", 7}, heartbeat(237, @hello))
    assert await(peer, "heard ") == "HEARTBEAT 237 191"
    assert %{counters: %{crc_errors: 0, unknown_ids: 0}} = snapshot(c.gateway, id)
  end

  test "pymavlink calls us by UDP", c do
    {id, port} = add_link(c.gateway, "udpin:127.0.0.1:0")
    all_there(c, id, start("mavlink_peer.py", ["udpout:127.0.0.1:#{port}", "7", "#{@count}"]))
  end

  test "we call pymavlink by UDP", c do
    peer = start("mavlink_peer.py", ["udpin:127.0.0.1:0", "7", "#{@count}", "wait"])
    port = await(peer, "connected ")
    {id, _} = add_link(c.gateway, "udpout:127.0.0.1:#{port}")
    eventually(fn -> snapshot(c.gateway, id).status in [:up, :idle] end)
    :ok = Router.broadcast(c.gateway, heartbeat(237, @hello))
    assert await(peer, "heard ") == "HEARTBEAT 237 191"
    all_there(c, id, peer)
  end

  test "we call pymavlink by WebSocket", c do
    port = reserved_port()
    peer = start("mavlink_peer.py", ["wsserver:127.0.0.1:#{port}", "7", "#{@count}", "wait"])
    await(peer, "connected")
    {id, _} = add_link(c.gateway, "ws://127.0.0.1:#{port}")
    eventually(fn -> snapshot(c.gateway, id).status in [:up, :idle] end)
    :ok = Router.broadcast(c.gateway, heartbeat(237, @hello))
    assert await(peer, "heard ") == "HEARTBEAT 237 191"
    all_there(c, id, peer)
  end

  test "pymavlink calls us by TCP", c do
    {id, port} = add_link(c.gateway, "tcpin:127.0.0.1:0")
    all_there(c, id, start("mavlink_peer.py", ["tcp:127.0.0.1:#{port}", "7", "#{@count}"]))
  end

  test "we call pymavlink by TCP, which is there only later and goes in between", c do
    listen(c.gateway, [:up, :down])
    port = reserved_port()

    # Both are started, which takes a while, before we call: it is their listening that we wait for, not Python, whose
    # seconds the back-off would double.
    peers =
      for _ <- 1..2,
          do: start("mavlink_peer.py", ["tcpin:127.0.0.1:#{port}", "7", "#{@count}", "wait", "hold"])

    for peer <- peers, do: await(peer, "starting")
    {id, _} = add_link(c.gateway, "tcp:127.0.0.1:#{port}")
    until_down("connection refused")

    for peer <- peers do
      Port.command(peer, "begin\n")
      until_up()
      :ok = Router.broadcast(c.gateway, heartbeat(237, @hello))
      assert await(peer, "heard ") == "HEARTBEAT 237 191"
      all_there(c, id, peer)
      Port.command(peer, "end\n")

      # Only then is the port free for the next, and nobody there: before, a call may still be taken and dropped.
      assert_receive {^peer, {:exit_status, 0}}
      until_down("connection refused")
    end
  end

  # Events of the link in their order, up to the one that is meant.
  defp until_up, do: until(&match?({:up, _reason}, &1))
  defp until_down(words), do: until(&(match?({:down, _reason}, &1) and elem(&1, 1) =~ words))

  defp until(wanted?) do
    assert_receive {event, _measurements, metadata} when event in [:up, :down]
    if wanted?.({event, metadata[:reason]}), do: :ok, else: until(wanted?)
  end
end
