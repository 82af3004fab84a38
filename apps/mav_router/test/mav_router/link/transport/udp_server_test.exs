defmodule MavRouter.Link.Transport.UdpServerTest do
  use ExUnit.Case, async: true

  alias MavRouter.Link.Transport.Net.{Backlog, Gathering}
  alias MavRouter.Link.Transport.{Net, UdpServer}

  @loopback {127, 0, 0, 1}
  @senders 20
  @rounds 200

  test "a server that gathers loses nothing, keeps each sender's order, and goes on reading" do
    {:ok, socket} = Net.udp(@loopback, 0)
    # Its window lasts for the whole test, however busy the machine is.
    gathering = %{Gathering.new() | since: :erlang.monotonic_time(:millisecond) + 3_600_000, on?: true}
    {:ok, conn, %{port: port}} = UdpServer.activate(%UdpServer{socket: socket, gathering: gathering})

    senders =
      for _ <- 1..@senders do
        {:ok, sender} = :gen_udp.open(0, ip: @loopback)
        sender
      end

    {conn, got} =
      for n <- 1..@rounds, reduce: {conn, %{}} do
        {conn, got} ->
          for sender <- senders, do: :ok = :gen_udp.send(sender, @loopback, port, <<n::16>>)
          read(conn, got, @senders)
      end

    assert map_size(got) == @senders
    for {_sender, numbers} <- got, do: assert(Enum.reverse(numbers) == Enum.to_list(1..@rounds))
    # It rested after its reads, and went on.
    assert_received :rested
    UdpServer.close(conn)
  end

  test "in an overload it reads all that waits, at a higher priority until that is passed on" do
    {:ok, socket} = Net.udp(@loopback, 0)
    now = :erlang.monotonic_time(:millisecond)
    # It lasts for the whole test.
    backlog = %{Backlog.new() | strained: now + 3_600_000}
    {:ok, conn, %{port: port}} = UdpServer.activate(%UdpServer{socket: socket, backlog: backlog})
    {:ok, sender} = :gen_udp.open(0, ip: @loopback)
    say = fn numbers -> for n <- numbers, do: :ok = :gen_udp.send(sender, @loopback, port, <<n::16>>) end
    say.([0])
    {conn, [{_sender, [0]}]} = read(conn, %{}, 1) |> then(fn {conn, got} -> {conn, Map.to_list(got)} end)
    say.(1..1_000)
    assert {:gathered, _socket} = message = message()
    {events, conn} = UdpServer.handle(conn, message)
    assert Process.info(self(), :priority) == {:priority, :high}
    assert [{:read, reads}, :passed_on] = events
    assert length(reads) > 128
    assert reads == Enum.sort_by(reads, &elem(&1, 1))
    conn = UdpServer.passed_on(conn, now)
    assert Process.info(self(), :priority) == {:priority, :normal}
    # Nothing is left in the way of the next ones.
    {conn, _got} = read(conn, %{}, 1_000 - length(reads))
    say.([1_001])
    {conn, got} = read(conn, %{}, 1)
    assert Map.values(got) == [[1_001]]
    UdpServer.close(conn)
    assert Process.info(self(), :priority) == {:priority, :normal}
  end

  defp read(conn, got, 0), do: {conn, got}

  defp read(conn, got, missing) do
    {events, conn} = UdpServer.handle(conn, message())
    reads = for {:read, reads} <- events, read <- reads, do: read
    got = Enum.reduce(reads, got, fn {sender, <<n::16>>}, got -> Map.update(got, sender, [n], &[n | &1]) end)
    read(conn, got, missing - length(reads))
  end

  defp message do
    receive do
      {:udp, _socket, _address, _port, _bytes} = message ->
        message

      {:udp_passive, _socket} = message ->
        message

      {:gathered, _socket} = message ->
        send(self(), :rested)
        message
    after
      Aerie.Patience.ms() -> flunk("datagrams are missing")
    end
  end
end
