# What recording costs whoever has frames: a link's process, a vehicle's session. Each read is timed by itself; the figure is
# that of the read divided by its frames.
#
#     bin/bench recorder [--reads 30000]
#
# Prints median and p99 in µs a frame, for reads of one frame and of ten: without a recorder, with one that records nothing,
# with the ring, with a recording, with both. Then the memory of rings, and how many frames a second one recording writes to
# a file in the temporary folder without dropping any.

Code.require_file("../../mav_codec/bench/support/options.ex", __DIR__)

defmodule Bench do
  alias Aerie.Base.{Names, Store}
  alias MavRouter.Recorder
  alias Aerie.Base.PubSub
  alias MavRouter.Recorder.{Ring, Tables}

  @key {"main", 1}

  def gateway(section) do
    gateway = make_ref()
    config = %{recorder: Map.merge(%{dir: dir(), min_free_mb: 0, space_ms: 600_000}, section)}

    for module <- [Store, PubSub, Recorder.Supervisor] do
      {:ok, _} = module.start_link(gateway: gateway, settings: Recorder.Settings.from(config))
    end

    gateway
  end

  def dir, do: Path.join(System.tmp_dir!(), "aerie-bench-#{System.pid()}")

  # Of the sizes that a PX4 vehicle sends: 20 to 60 bytes.
  def frames(n) do
    messages = [
      %MavCodec.Messages.Attitude{roll: 0.5, pitch: -0.1, yaw: 1.0, rollspeed: 0.1},
      %MavCodec.Messages.GlobalPositionInt{lat: 473_977_419, lon: 85_455_938, alt: 488_100, vx: 100},
      %MavCodec.Messages.VfrHud{groundspeed: 5.0, airspeed: 5.0, throttle: 40, climb: 0.5},
      %MavCodec.Messages.Heartbeat{type: 2, autopilot: 12, base_mode: 209, system_status: 4}
    ]

    messages
    |> Stream.cycle()
    |> Stream.with_index()
    |> Stream.map(fn {message, i} ->
      bytes = MavCodec.encode(message, system: 1, component: 1, seq: rem(i, 256))

      {[frame], _} =
        MavCodec.Parser.push_datagram(MavCodec.Parser.new(), bytes, 1_700_000_000_000_000 + i * 10_000)

      frame
    end)
    |> Enum.take(n)
  end

  # In the process of a session, as it is: nothing else in its heap.
  def time(name, reads, per, fun) do
    frames = frames(per)

    times =
      Task.async(fn ->
        for _ <- 1..1000, do: fun.(frames)

        for i <- 1..reads do
          # What is written has its turn, as between two reads of a socket.
          if rem(i, 100) == 0, do: Process.sleep(1)
          start = System.monotonic_time(:nanosecond)
          fun.(frames)
          System.monotonic_time(:nanosecond) - start
        end
      end)
      |> Task.await(:infinity)
      |> Enum.sort()

    at = fn share -> Enum.at(times, trunc(length(times) * share)) / 1000 / per end
    row(name, per, at.(0.5), at.(0.99))
  end

  defp row(name, per, median, p99) do
    IO.puts(
      "| #{String.pad_trailing(name, 44)} | #{String.pad_leading("#{per}", 2)} | " <>
        "#{:io_lib.format("~6.2f", [median])} | #{:io_lib.format("~6.2f", [p99])} |"
    )
  end

  def record(gateway, what) do
    :ok = Recorder.start(gateway, what, :always)
    gateway
  end

  def vehicle(gateway), do: &Recorder.vehicle_frames(gateway, @key, &1)
  def link(gateway), do: &Recorder.link_frames(gateway, "radio", &1)

  def linked(section) do
    gateway = gateway(section)
    Store.put_link(gateway, "radio", %{id: "radio", network: "main"})
    gateway
  end

  def memory(per) do
    gateway = gateway(%{ring: %{seconds: 3600, max_kb: 1_000_000, total_mb: 1_000}})
    tables = Tables.of(gateway)
    frames = frames(12_000)
    before = {:ets.info(tables.ring, :memory), :erlang.memory(:binary)}
    frames |> Enum.chunk_every(per) |> Enum.each(&Recorder.vehicle_frames(gateway, @key, &1))
    words = :ets.info(tables.ring, :memory) - elem(before, 0)
    bytes = words * :erlang.system_info(:wordsize) + :erlang.memory(:binary) - elem(before, 1)
    %{bytes: counted} = Ring.size(tables, @key)

    IO.puts(
      "ring, #{per} frames a read: #{div(bytes, 12_000)} bytes a frame (counted as #{div(counted, 12_000)}); " <>
        "two minutes of 100 frames/s are #{Float.round(bytes / 1_048_576, 1)} MB"
    )
  end

  # As fast as it is taken: the next read is given when the queue has room.
  def throughput(per) do
    gateway = gateway(%{ring: %{enabled: false}})
    record(gateway, {:vehicle, @key})
    frames = frames(per)
    reads = div(300_000, per)
    [{_, _, counters, limit}] = :ets.tab2list(Tables.of(gateway).taps)
    recording = Names.whereis(gateway, :recording, {:vehicle, @key})
    cpu = :erlang.statistics(:runtime) |> elem(0)
    start = System.monotonic_time(:microsecond)

    for _ <- 1..reads do
      wait(counters, div(limit, 2))
      Recorder.vehicle_frames(gateway, @key, frames)
    end

    Recorder.Recording.flush(recording)
    took = System.monotonic_time(:microsecond) - start
    cpu = (:erlang.statistics(:runtime) |> elem(0)) - cpu
    %{frames: written, dropped: dropped, bytes: bytes} = Recorder.status(gateway, {:vehicle, @key})

    IO.puts(
      "one recording, #{per} frames a read: #{div(written * 1_000_000, took)} frames/s, dropped #{dropped}, " <>
        "#{Float.round(bytes / took, 1)} MB/s, #{Float.round(cpu / written * 100, 2)} CPU s per 100,000 frames"
    )
  end

  defp wait(counters, limit) do
    if Recorder.Tap.waiting(counters) > limit do
      Process.sleep(1)
      wait(counters, limit)
    end
  end
end

Logger.configure(level: :none)
reads = MavCodec.Bench.Options.read(__ENV__.file, System.argv(), reads: 30_000)[:reads]
off = %{ring: %{enabled: false}}

IO.puts("| | frames a read | median µs | p99 µs |")
IO.puts("|---|---|---|---|")

for per <- [1, 10] do
  Bench.time("nothing: the timing itself", reads, per, fn _frames -> :ok end)
  Bench.time("link, no recorder", reads, per, Bench.link(make_ref()))
  Bench.time("link, recorder that records nothing", reads, per, Bench.link(Bench.linked(off)))
  Bench.time("link, recorded", reads, per, Bench.link(Bench.record(Bench.linked(off), {:link, "radio"})))
  Bench.time("vehicle, no ring, not recorded", reads, per, Bench.vehicle(Bench.gateway(off)))
  Bench.time("vehicle, ring (as configured by default)", reads, per, Bench.vehicle(Bench.gateway(%{})))

  Bench.time(
    "vehicle, recorded, no ring",
    reads,
    per,
    Bench.vehicle(Bench.record(Bench.gateway(off), {:vehicle, {"main", 1}}))
  )

  Bench.time(
    "vehicle, ring and recorded",
    reads,
    per,
    Bench.vehicle(Bench.record(Bench.gateway(%{}), {:vehicle, {"main", 1}}))
  )
end

IO.puts("")
for per <- [1, 10], do: Bench.memory(per)
IO.puts("")
for per <- [1, 10], do: Bench.throughput(per)
File.rm_rf!(Bench.dir())
