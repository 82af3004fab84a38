defmodule MavRouter.Link.Transport.TcpAcceptorTest do
  use ExUnit.Case, async: true

  alias MavRouter.Link.Transport.TcpAcceptor
  alias Aerie.Patience

  test "an address has a share, the port a limit" do
    a = {10, 0, 0, 1}
    assert TcpAcceptor.check(%{}, a) == :ok
    assert TcpAcceptor.check(%{a => 63}, a) == :ok

    assert {:refused, "connections of 10.0.0.1 are refused: it has 64" <> _} =
             TcpAcceptor.check(%{a => 64}, a)

    assert TcpAcceptor.check(%{a => 64}, {10, 0, 0, 2}) == :ok
    full = for n <- 2..5, into: %{}, do: {{10, 0, 0, n}, 64}
    assert {:refused, "connections are refused: there are 256" <> _} = TcpAcceptor.check(full, a)
  end

  test "connections beyond the share are closed and counted; one that ended makes room" do
    {:ok, listener} = :gen_tcp.listen(0, [:binary, active: false, backlog: 128])
    {:ok, port} = :inet.port(listener)
    acceptor = TcpAcceptor.start(listener)
    connect = fn -> :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false]) end
    _held = for _ <- 1..64, do: {:ok, _socket} = connect.()
    for _ <- 1..64, do: assert_receive({:accepted, ^listener, _socket, {127, 0, 0, 1}}, Patience.ms())

    {:ok, refused} = connect.()
    assert {:error, :closed} = :gen_tcp.recv(refused, 0, Patience.ms())
    assert_receive {:refused, ^listener, 1, "connections of 127.0.0.1 are refused" <> _}, Patience.ms()

    :ok = TcpAcceptor.gone(acceptor, {127, 0, 0, 1})
    {:ok, _socket} = connect.()
    assert_receive {:accepted, ^listener, _socket, {127, 0, 0, 1}}, Patience.ms()
  end
end
