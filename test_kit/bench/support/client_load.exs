Code.require_file("socket.ex", __DIR__)
Code.require_file("sample.ex", __DIR__)

defmodule Bench.ClientLoad do
  @moduledoc """
  A source of frames and its clients, in a VM of its own. A frame is of one length, and has the time of its sending in
  it.
  """

  alias Bench.{Sample, Socket}

  @size 28

  @doc "Everything of a run: sent, the fewest that a client got, and the latencies."
  def run(source, way, clients, rate, seconds) do
    parent = self()
    pids = for _ <- 1..clients, do: spawn_link(fn -> client(way, parent) end)
    # The gateway is to know them first.
    for pid <- pids, do: receive(do: ({:open, ^pid} -> :ok))
    {:ok, socket} = :gen_udp.open(0, [:binary, active: false])
    sent = send_all(socket, source, rate, seconds)
    results = for pid <- pids, send(pid, :result), do: receive(do: ({:result, ^pid, times} -> times))
    :gen_udp.close(socket)
    {sent, results |> Enum.map(&length/1) |> Enum.min(), Enum.concat(results)}
  end

  # A burst each millisecond.
  defp send_all(socket, port, rate, seconds) do
    start = System.monotonic_time(:microsecond)

    Enum.reduce(1..(seconds * 1000), 0, fn ms, sent ->
      due = div(rate * ms, 1000)
      Sample.sleep_until(start + ms * 1000)
      for _ <- (sent + 1)..due//1, do: :gen_udp.send(socket, {127, 0, 0, 1}, port, frame(clock()))
      due
    end)
  end

  defp frame(now) do
    attitude = %MavCodec.Messages.Attitude{time_boot_ms: now, roll: 0.5, yaw: 1.0}
    MavCodec.encode(attitude, system: 1, component: 1, seq: 0)
  end

  defp clock, do: Bitwise.band(System.os_time(:microsecond), 0xFFFFFFFF)

  @doc "A client that counts what comes until somebody asks for the result."
  def client(way, parent) do
    {socket, prefix} = open(way)
    :ok = :inet.setopts(socket, active: true)
    send(parent, {:open, self()})
    receive_all(socket, prefix, "", [], :infinity, parent)
  end

  # With the bytes before each frame.
  defp open({:websocket, port}), do: {elem(Socket.upgrade(port, "/"), 0), 2}
  defp open({:unix, _path} = way), do: {Socket.open(way), 4}
  defp open({:tcp, _port} = way), do: {Socket.open(way), 0}

  defp receive_all(socket, prefix, rest, times, silence_ms, parent) do
    receive do
      {:tcp, ^socket, bytes} ->
        {times, rest} = take(rest <> bytes, prefix, clock(), times)
        receive_all(socket, prefix, rest, times, silence_ms, parent)

      # What was sent last is still on its way.
      :result ->
        receive_all(socket, prefix, rest, times, 500, parent)
    after
      silence_ms ->
        :gen_tcp.close(socket)
        send(parent, {:result, self(), times})
    end
  end

  # A frame of another length is the gateway's own heartbeat or a ping: neither is sent in this benchmark.
  defp take(bytes, prefix, now, times) do
    case bytes do
      <<_::binary-size(^prefix), _::10-binary, at::32-little, _::binary-size(@size - 14), rest::binary>> ->
        take(rest, prefix, now, [Bitwise.band(now - at, 0xFFFFFFFF) | times])

      rest ->
        {times, rest}
    end
  end
end
