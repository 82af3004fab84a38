defmodule MavRouter.Endpoints.OutputTest do
  use ExUnit.Case, async: true

  alias MavCodec.Frame
  alias MavRouter.Endpoints.Counters
  alias MavRouter.Endpoints.Output
  alias MavRouter.Endpoints.Output.Batch

  @loopback %{family: :inet, addr: {127, 0, 0, 1}, port: 0}
  # SOL_SOCKET and SO_NO_CHECK: without checksums Linux refuses to cut up a write.
  @no_check {1, 11}

  setup do
    {:ok, gcs} = :gen_udp.open(0, [:binary, active: true, ip: {127, 0, 0, 1}])
    {:ok, port} = :inet.port(gcs)
    {:ok, socket} = :socket.open(:inet, :dgram, :udp)
    :ok = :socket.bind(socket, @loopback)
    out = {:udp, socket, %{@loopback | port: port}}
    {:ok, gcs: gcs, socket: socket, path: %{out: out, counters: Counters.new(), coalesce: false}}
  end

  defp frames(sizes),
    do: for({size, n} <- Enum.with_index(sizes), do: %Frame{bytes: :binary.copy(<<n>>, size)})

  defp sent(c, sizes) do
    frames = frames(sizes)
    _batch = Output.emit(c.path, Batch.new(frames))

    for %{bytes: bytes} <- frames do
      assert_receive {:udp, gcs, _address, _port, got} when gcs == c.gcs
      assert got == bytes
    end

    counters = c.path.counters
    assert Counters.get(counters, :frames_out) == length(sizes)
    assert Counters.get(counters, :bytes_out) == Enum.sum(sizes)
    :socket.info(c.socket).counters.write_pkg
  end

  test "frames of one size are one write, and a datagram each", c do
    assert sent(c, List.duplicate(40, 20)) == 1
  end

  test "a write is cut into no more datagrams than every kernel allows", c do
    assert sent(c, List.duplicate(21, 130)) == 4
  end

  test "frames of other sizes between them keep their place", c do
    assert sent(c, [40, 40, 40, 21, 21, 280, 280, 280, 280, 12]) == 5
  end

  test "where the system refuses to cut up a write, there is one for each frame", c do
    :ok = :socket.setopt_native(c.socket, @no_check, 1)
    assert sent(c, List.duplicate(40, 20)) == 20
  end
end
