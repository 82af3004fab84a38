defmodule MavRouter.Link.Transport.UdpServerTest do
  use ExUnit.Case, async: true

  alias MavRouter.Link.Transport.Net.Gathering
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
