defmodule MavRouter.Link.Transport.TcpServerTest do
  use ExUnit.Case, async: true

  alias Aerie.Patience
  alias MavRouter.Link.Spec
  alias MavRouter.Link.Transport.TcpServer

  test "a connection that has to make room ends, with a reason; its bytes before make it keep its place" do
    {:ok, conn} = TcpServer.open(Spec.parse!("tcpin:127.0.0.1:0"))
    {:ok, conn, %{port: port}} = TcpServer.activate(conn)
    [silent, loud] = for _ <- 1..2, do: connect(port)

    {sockets, conn} =
      Enum.map_reduce([1, 2], conn, fn peer, conn ->
        assert_receive {:accepted, _listener, socket, {127, 0, 0, 1}} = message, Patience.ms()
        {[{:peer_up, ^peer, "127.0.0.1:" <> _port}], conn} = TcpServer.handle(conn, message)
        {socket, conn}
      end)

    :ok = :gen_tcp.send(loud, "x")
    assert_receive {:tcp, socket, "x"} = message, Patience.ms()
    assert {[{:read, [{peer, "x"}]}], conn} = TcpServer.handle(conn, message)
    assert conn.silent == MapSet.new(sockets -- [socket])

    [yielding] = sockets -- [socket]
    assert {[{:peer_down, other, reason}], conn} = TcpServer.handle(conn, {:yield, conn.listener, yielding})
    assert reason =~ "sent nothing" and other == 3 - peer
    assert {:error, :closed} = :gen_tcp.recv(silent, 0, Patience.ms())
    # It has ended already.
    assert :unknown = TcpServer.handle(conn, {:yield, conn.listener, yielding})
    :ok = TcpServer.close(conn)
  end

  defp connect(port) do
    {:ok, socket} = :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false])
    socket
  end
end
