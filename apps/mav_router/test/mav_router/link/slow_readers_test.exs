defmodule MavRouter.Link.SlowReadersTest do
  @moduledoc "Ground stations that connect over TCP and read nothing, beside one that reads."
  use ExUnit.Case, async: true
  use Aerie.LinkCase

  alias MavRouter.Client
  alias MavRouter.Link.Spec
  alias Aerie.Base.Names
  alias Aerie.Patience

  @moduletag :capture_log

  # Bytes that fill what buffers a connection has, and many frames more.
  @frames 8_000

  test "as many as may connect cost one that reads no frame, fill no mailbox, and are let go" do
    gateway = start_parts()
    be_session(gateway, 1)

    :ok =
      Client.start(gateway, Spec.parse!("tcpin:127.0.0.1:0", id: "gcs", options: %{router: [side: :client]}))

    port =
      eventually(fn ->
        with(
          [%{port: port, status: status}] when status != :connecting <- Client.endpoints(gateway),
          do: port,
          else: (_ -> nil)
        )
      end)

    stuck = for _ <- 1..63, do: connect(port, recbuf: 4096)
    reader = connect(port, [])

    refused =
      for _ <- 1..40,
          {:ok, socket} <- [:gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false])],
          do: socket

    for socket <- refused, do: assert({:error, :closed} = :gen_tcp.recv(socket, 0, Patience.ms()))
    eventually(fn -> peers(gateway) == 64 end)

    link = Names.whereis(gateway, :link, "gcs")
    {id, udp} = add_link(gateway, "udpin:127.0.0.1:0")
    {:ok, vehicle} = :gen_udp.open(0, [:binary])
    test = self()
    reading = spawn_link(fn -> read(reader, MavCodec.Parser.new(), 0, test) end)

    # One after the other, as the reader gets them: what it lacks was lost, however slow the machine is.
    longest =
      for n <- 1..@frames, reduce: 0 do
        longest ->
          :ok = :gen_udp.send(vehicle, {127, 0, 0, 1}, udp, odometry(1, n))
          if rem(n, 20) == 0, do: assert_receive({:read, ^n}, Patience.ms())
          {:message_queue_len, waiting} = Process.info(link, :message_queue_len)
          max(longest, waiting)
      end

    assert longest < 20_000
    assert snapshot(gateway, id).counters.frames_in == @frames
    # They took nothing for ten seconds.
    eventually(fn -> peers(gateway) == 1 end)
    assert %{peers_refused: 40, dropped_out: dropped} = hd(Client.endpoints(gateway)).counters
    assert dropped > 0
    send(reading, :end)
    for socket <- stuck, do: :gen_tcp.close(socket)
  end

  defp connect(port, options) do
    {:ok, socket} = :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false] ++ options)
    socket
  end

  defp peers(gateway), do: Enum.count(MavRouter.Router.endpoints(gateway), &(&1.owner == "gcs"))

  defp read(socket, parser, n, test) do
    with {:ok, bytes} <- :gen_tcp.recv(socket, 0, Patience.ms()) do
      {frames, parser} = MavCodec.Parser.push(parser, bytes, 0)
      for {_frame, n} <- Enum.with_index(frames, n + 1), rem(n, 20) == 0, do: send(test, {:read, n})
      read(socket, parser, n + length(frames), test)
    end
  end
end
