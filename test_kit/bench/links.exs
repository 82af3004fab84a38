# How fast a link takes frames from a socket to a vehicle's session, on loopback, in this one program (the sender's
# work is in the figures).
#
#     bin/bench links [--frames 200000]
#
# Prints for UDP (one frame a datagram, and ten) and TCP: frames per second, frames lost, and reductions of the link's
# process per frame. Then the added latency at 1,000 and 10,000 frames/s: from before the send to the session.

Code.require_file("harness.exs", __DIR__)

defmodule LinksBench do
  alias Aerie.Base.{Names, PubSub, Store}
  alias Bench.{Gateway, Sample, Socket}
  alias MavRouter.{Link, Router}

  def main(n) do
    gateway = make_ref()

    for {module, settings} <- [
          {Store, nil},
          {PubSub, nil},
          {Router.Supervisor, Router.Settings.from(%{})},
          {Link.Supervisor, Link.Settings.from(%{})}
        ],
        do: {:ok, _} = module.start_link(gateway: gateway, settings: settings)

    # This process is the vehicle's session.
    :ok = Names.register(gateway, :session, {"main", 1})
    frames = for i <- 1..n, do: frame(i)
    udp = Gateway.link(gateway, "udpin:127.0.0.1:0", id: "udp")
    tcp = Gateway.link(gateway, "tcpin:127.0.0.1:0", id: "tcp")
    {:ok, socket} = :gen_udp.open(0, [:binary, active: false, sndbuf: 1_000_000])
    say = &:gen_udp.send(socket, {127, 0, 0, 1}, udp, &1)
    connection = Socket.open({:tcp, tcp})

    for {name, id, per, send} <- [
          {"UDP, 1 frame a datagram", "udp", 1, say},
          {"UDP, 10 frames a datagram", "udp", 10, say},
          {"TCP", "tcp", 20, &:gen_tcp.send(connection, &1)}
        ],
        do: throughput(name, Names.whereis(gateway, :link, id), Enum.chunk_every(frames, per), send)

    for rate <- [1_000, 10_000], do: latency(rate, say)
    counters = Map.take(Link.snapshot(gateway, "udp").counters, [:frames_in, :overload, :unclaimed])
    IO.puts("UDP link: #{inspect(counters)}")
  end

  defp frame(n) do
    attitude = %MavCodec.Messages.Attitude{time_boot_ms: n, roll: 0.5, yaw: 1.0}
    MavCodec.encode(attitude, system: 1, component: 1, seq: rem(n, 256))
  end

  defp throughput(name, link, writes, send) do
    n = Enum.sum_by(writes, &length/1)
    reductions = fn -> elem(Process.info(link, :reductions), 1) end
    {before, cpu, start} = {reductions.(), Sample.cpu(), System.monotonic_time(:microsecond)}
    spawn_link(fn -> Enum.each(writes, send) end)
    got = length(collect(n, 500))
    took = System.monotonic_time(:microsecond) - start - if(got < n, do: 500_000, else: 0)
    cpu = Float.round((Sample.cpu() - cpu) / got * 100_000, 2)

    IO.puts(
      "#{String.pad_trailing(name, 28)} #{round(got * 1_000_000 / took)} frames/s, lost #{n - got}, " <>
        "#{div(reductions.() - before, max(got, 1))} reductions a frame, CPU #{cpu} s per 100,000 frames"
    )
  end

  defp latency(rate, say) do
    n = min(rate * 3, 20_000)
    start = System.monotonic_time(:microsecond)

    spawn_link(fn ->
      for i <- 0..(n - 1) do
        wait_until(start + i * div(1_000_000, rate))
        say.(frame(clock()))
      end
    end)

    times = collect(n, 1000)
    [p50, p99] = Sample.spread(times, [0.5, 0.99])
    IO.puts("latency at #{rate} frames/s: p50 #{p50} us, p99 #{p99} us, lost #{n - length(times)}")
  end

  defp clock, do: Bitwise.band(System.monotonic_time(:microsecond), 0xFFFFFFFF)

  # More exact than sleeping for all of it.
  defp wait_until(at) do
    left = at - System.monotonic_time(:microsecond)

    cond do
      left <= 0 -> :ok
      left > 2000 -> Process.sleep(div(left, 1000) - 1) && wait_until(at)
      true -> :erlang.yield() && wait_until(at)
    end
  end

  # How old each frame is by the time in it, until `left` have come or none for so many ms.
  defp collect(left, silence_ms, times \\ [])
  defp collect(left, _silence_ms, times) when left <= 0, do: times

  defp collect(left, silence_ms, times) do
    receive do
      {:frames, _, frames} ->
        now = clock()
        ages = for %{payload: <<at::32-little, _::binary>>} <- frames, do: now - at
        collect(left - length(frames), silence_ms, ages ++ times)
    after
      silence_ms -> times
    end
  end
end

LinksBench.main(Bench.Options.read(__ENV__.file, frames: 200_000)[:frames])
