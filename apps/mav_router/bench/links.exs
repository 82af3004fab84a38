# How fast a link takes frames from a socket to a vehicle's session, on loopback, in this one program (the sender's work
# is in the figures).
#
#     bin/bench links [--frames 200000]
#
# Prints for UDP (one frame a datagram, and ten) and TCP: frames per second, frames lost, and reductions of the link's
# process per frame. Then the added latency at 1,000 and 10,000 frames/s: from before the send to the session.

Code.require_file("../../mav_codec/bench/support/options.ex", __DIR__)

defmodule Bench do
  alias Aerie.Base.Names
  alias MavRouter.Link

  def gateway do
    gateway = make_ref()
    {:ok, _} = Aerie.Base.Store.start_link(gateway: gateway)
    {:ok, _} = Aerie.Base.PubSub.start_link(gateway: gateway)

    {:ok, _} =
      MavRouter.Router.Supervisor.start_link(
        gateway: gateway,
        settings: MavRouter.Router.Settings.from(%{})
      )

    {:ok, _} = Link.Supervisor.start_link(gateway: gateway, settings: Link.Settings.from(%{}))

    :ok = Aerie.Base.Names.register(gateway, :session, {"main", 1})
    gateway
  end

  def frame(n) do
    MavCodec.encode(%MavCodec.Messages.Attitude{time_boot_ms: n, roll: 0.5, yaw: 1.0},
      system: 1,
      component: 1,
      seq: rem(n, 256)
    )
  end

  def count(0, got), do: got

  def count(left, got) do
    receive do
      {:frames, _, frames} -> count(left - length(frames), got + length(frames))
    after
      500 -> got
    end
  end

  def throughput(name, gateway, id, n, send) do
    pid = Names.whereis(gateway, :link, id)
    {_, before} = Process.info(pid, :reductions)
    cpu = :erlang.statistics(:runtime) |> elem(0)
    start = System.monotonic_time(:microsecond)
    sender = spawn_link(fn -> send.() end)
    got = count(n, 0)
    took = System.monotonic_time(:microsecond) - start - if(got < n, do: 500_000, else: 0)
    cpu = (:erlang.statistics(:runtime) |> elem(0)) - cpu
    {_, reductions} = Process.info(pid, :reductions)
    Process.unlink(sender)

    IO.puts(
      "#{String.pad_trailing(name, 28)} #{round(got * 1_000_000 / took)} frames/s, lost #{n - got}, " <>
        "#{div(reductions - before, max(got, 1))} reductions a frame, CPU #{Float.round(cpu / got * 100, 2)} s per 100,000 frames"
    )
  end

  def latency(_gateway, rate, port) do
    {:ok, socket} = :gen_udp.open(0, [:binary, active: false])
    n = min(rate * 3, 20_000)
    gap = div(1_000_000, rate)
    test = self()

    spawn_link(fn ->
      start = System.monotonic_time(:microsecond)

      for i <- 0..(n - 1) do
        wait_until(start + i * gap)
        now = System.monotonic_time(:microsecond)
        :gen_udp.send(socket, {127, 0, 0, 1}, port, frame(Bitwise.band(now, 0xFFFFFFFF)))
      end

      send(test, :sent)
      Process.sleep(1000)
    end)

    times = Enum.sort(collect(n, []))
    at = fn share -> Enum.at(times, trunc(length(times) * share)) end
    IO.puts("latency at #{rate} frames/s: p50 #{at.(0.5)} us, p99 #{at.(0.99)} us, lost #{n - length(times)}")
  end

  defp wait_until(at) do
    left = at - System.monotonic_time(:microsecond)

    cond do
      left <= 0 -> :ok
      left > 2000 -> Process.sleep(div(left, 1000) - 1) && wait_until(at)
      true -> :erlang.yield() && wait_until(at)
    end
  end

  defp collect(0, times), do: times

  defp collect(left, times) do
    receive do
      {:frames, _, frames} ->
        now = Bitwise.band(System.monotonic_time(:microsecond), 0xFFFFFFFF)

        collect(
          left - length(frames),
          for(%{payload: <<t::32-little, _::binary>>} <- frames, do: now - t) ++ times
        )
    after
      1000 -> times
    end
  end

  def run(n) do
    gateway = gateway()
    frames = for i <- 1..n, do: frame(i)

    {:ok, udp} = Link.start(gateway, "udpin:127.0.0.1:0")
    port = Link.snapshot(gateway, udp).port
    {:ok, socket} = :gen_udp.open(0, [:binary, active: false, sndbuf: 1_000_000])
    say = &:gen_udp.send(socket, {127, 0, 0, 1}, port, &1)
    test = self()
    :gen_udp.controlling_process(socket, test)
    throughput("UDP, 1 frame a datagram", gateway, udp, n, fn -> Enum.each(frames, say) end)

    throughput("UDP, 10 frames a datagram", gateway, udp, n, fn ->
      frames |> Enum.chunk_every(10) |> Enum.each(say)
    end)

    {:ok, tcp} = Link.start(gateway, "tcpin:127.0.0.1:0")

    {:ok, socket} =
      :gen_tcp.connect({127, 0, 0, 1}, Link.snapshot(gateway, tcp).port, [:binary, active: false])

    throughput("TCP", gateway, tcp, n, fn ->
      frames |> Enum.chunk_every(20) |> Enum.each(&:gen_tcp.send(socket, &1))
    end)

    for rate <- [1_000, 10_000], do: latency(gateway, rate, port)

    IO.inspect(Map.take(Link.snapshot(gateway, udp).counters, [:frames_in, :overload, :unclaimed]),
      label: "UDP link"
    )
  end
end

n = MavCodec.Bench.Options.read(__ENV__.file, System.argv(), frames: 200_000)[:frames]
Bench.run(n)
