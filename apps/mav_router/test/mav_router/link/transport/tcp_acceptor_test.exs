defmodule MavRouter.Link.Transport.TcpAcceptorTest do
  use ExUnit.Case, async: true

  alias MavRouter.Link.Transport.TcpAcceptor
  alias Aerie.Patience

  # So many connections of each address, which have sent something, or have been silent since `since`.
  defp held(numbers, since \\ nil),
    do: for({address, n} <- numbers, i <- 1..n, into: %{}, do: {{address, i}, {address, since && since + i}})

  test "an address has a share, the port a limit" do
    a = {10, 0, 0, 1}
    assert TcpAcceptor.check(%{}, a, 0) == :ok
    assert TcpAcceptor.check(held(%{a => 63}), a, 0) == :ok

    assert {:refused, "connections of 10.0.0.1 are refused: it has 64" <> _} =
             TcpAcceptor.check(held(%{a => 64}), a, 0)

    assert TcpAcceptor.check(held(%{a => 64}), {10, 0, 0, 2}, 0) == :ok
    full = held(for n <- 2..5, into: %{}, do: {{10, 0, 0, n}, 64})
    assert {:refused, "connections are refused: there are 256" <> _} = TcpAcceptor.check(full, a, 0)
  end

  test "at a limit the earliest connection yields that never said anything; none that did" do
    [a, b, c] = for n <- 1..3, do: {10, 0, 0, n}
    assert {:yields, {^a, 1}} = TcpAcceptor.check(held(%{a => 64}, 0), a, 5_001)
    assert {:refused, _five_seconds} = TcpAcceptor.check(held(%{a => 64}, 0), a, 5_000)
    mixed = Map.merge(held(%{a => 64}), %{{a, 7} => {a, 100}})
    assert {:yields, {^a, 7}} = TcpAcceptor.check(mixed, a, 9_000)
    # Of its own address, if that is at its limit.
    assert {:refused, _own} = TcpAcceptor.check(Map.merge(held(%{a => 64}), held(%{b => 64}, 0)), a, 9_000)

    # Of the address with the most, if the port is full.
    silent = for n <- 10..12, into: %{}, do: {{10, 0, 0, n}, 64}
    full = Map.merge(held(silent, 1_000), held(%{b => 63, c => 1}, 0))
    assert {:yields, {{10, 0, 0, n}, 1}} = TcpAcceptor.check(full, a, 9_000)
    assert n in 10..12
  end

  test "connections beyond the share are closed and counted; one that ended makes room" do
    {:ok, listener} = :gen_tcp.listen(0, [:binary, active: false, backlog: 128])
    {:ok, port} = :inet.port(listener)
    acceptor = TcpAcceptor.start(listener, [:binary, nodelay: true])
    connect = fn -> :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false]) end
    _held = for _ <- 1..64, do: {:ok, _socket} = connect.()

    sockets =
      for _ <- 1..64 do
        assert_receive {:accepted, ^listener, socket, {127, 0, 0, 1}}, Patience.ms()
        TcpAcceptor.heard(acceptor, socket)
        socket
      end

    {:ok, refused} = connect.()
    assert {:error, :closed} = :gen_tcp.recv(refused, 0, Patience.ms())
    assert_receive {:refused, ^listener, 1, "connections of 127.0.0.1 are refused" <> _}, Patience.ms()

    :ok = TcpAcceptor.gone(acceptor, hd(sockets))
    {:ok, _socket} = connect.()
    assert_receive {:accepted, ^listener, _socket, {127, 0, 0, 1}}, Patience.ms()
  end
end
