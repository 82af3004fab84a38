# What recording costs whoever has frames: a link's process, a vehicle's session. Each read is timed by itself; the
# figure is that of the read divided by its frames.
#
#     bin/bench recorder [--reads 30000]
#
# Prints median and p99 in µs a frame, for reads of one frame and of ten: without a recorder, with one that records
# nothing, with the ring, with a recording, with both. Then the memory of rings, and how many frames a second one
# recording writes to a file in the temporary folder without dropping any.

Code.require_file("harness.exs", __DIR__)

defmodule RecorderBench do
  alias Aerie.Base.{Names, PubSub, Store}
  alias Bench.{Sample, Table}
  alias MavRouter.Recorder
  alias MavRouter.Recorder.{Ring, Tables}

  @key {"main", 1}
  @widths [44, -2, -8, -6]
  @off %{ring: %{enabled: false}}

  def main(dir, reads) do
    Table.head(["", "frames a read", "median µs", "p99 µs"])
    link = fn gateway -> &Recorder.link_frames(gateway, "radio", &1) end
    vehicle = fn gateway -> &Recorder.vehicle_frames(gateway, @key, &1) end

    for per <- [1, 10],
        {name, fun} <- [
          {"nothing: the timing itself", fn _frames -> :ok end},
          {"link, no recorder", link.(make_ref())},
          {"link, recorder that records nothing", link.(gateway(dir, @off))},
          {"link, recorded", link.(recorded(gateway(dir, @off), {:link, "radio"}))},
          {"vehicle, no ring, not recorded", vehicle.(gateway(dir, @off))},
          {"vehicle, ring (as configured by default)", vehicle.(gateway(dir, %{}))},
          {"vehicle, recorded, no ring", vehicle.(recorded(gateway(dir, @off), {:vehicle, @key}))},
          {"vehicle, ring and recorded", vehicle.(recorded(gateway(dir, %{}), {:vehicle, @key}))}
        ],
        do: time(name, reads, per, fun)

    for measure <- [&memory/2, &throughput/2] do
      IO.puts("")
      for per <- [1, 10], do: measure.(dir, per)
    end
  end

  defp gateway(dir, section) do
    gateway = make_ref()

    settings =
      Recorder.Settings.from(%{recorder: Map.merge(%{dir: dir, min_free_mb: 0, space_ms: 600_000}, section)})

    for module <- [Store, PubSub, Recorder.Supervisor],
        do: {:ok, _} = module.start_link(gateway: gateway, settings: settings)

    Store.put_link(gateway, "radio", %{id: "radio", network: "main"})
    gateway
  end

  defp recorded(gateway, what) do
    :ok = Recorder.start(gateway, what, :always)
    gateway
  end

  # Of the sizes that a PX4 vehicle sends: 20 to 60 bytes.
  defp frames(n) do
    messages = [
      %MavCodec.Messages.Attitude{roll: 0.5, pitch: -0.1, yaw: 1.0, rollspeed: 0.1},
      %MavCodec.Messages.GlobalPositionInt{lat: 473_977_419, lon: 85_455_938, alt: 488_100, vx: 100},
      %MavCodec.Messages.VfrHud{groundspeed: 5.0, airspeed: 5.0, throttle: 40, climb: 0.5},
      %MavCodec.Messages.Heartbeat{type: 2, autopilot: 12, base_mode: 209, system_status: 4}
    ]

    for {message, i} <- messages |> Stream.cycle() |> Stream.with_index() |> Enum.take(n) do
      bytes = MavCodec.encode(message, system: 1, component: 1, seq: rem(i, 256))

      {[frame], _} =
        MavCodec.Parser.push_datagram(MavCodec.Parser.new(), bytes, 1_700_000_000_000_000 + i * 10_000)

      frame
    end
  end

  # In the process of a session, as it is: nothing else in its heap.
  defp time(name, reads, per, fun) do
    frames = frames(per)

    times =
      Task.async(fn ->
        for _ <- 1..1000, do: fun.(frames)

        # What is written has its turn, as between two reads of a socket.
        Enum.flat_map(1..div(reads, 100), fn _round ->
          Process.sleep(1)
          Sample.calls(1..100, fn _i, _last -> fun.(frames) end)
        end)
      end)

    [median, p99] =
      for ns <- times |> Task.await(:infinity) |> Sample.spread([0.5, 0.99]), do: decimals(ns / 1000 / per)

    Table.row([name, per, median, p99], @widths)
  end

  defp decimals(number), do: :erlang.float_to_binary(number, decimals: 2)

  defp memory(dir, per) do
    gateway = gateway(dir, %{ring: %{seconds: 3600, max_kb: 1_000_000, total_mb: 1_000}})
    tables = Tables.of(gateway)

    size = fn ->
      :ets.info(tables.ring, :memory) * :erlang.system_info(:wordsize) + :erlang.memory(:binary)
    end

    frames = frames(12_000)
    before = size.()
    frames |> Enum.chunk_every(per) |> Enum.each(&Recorder.vehicle_frames(gateway, @key, &1))
    bytes = size.() - before
    %{bytes: counted} = Ring.size(tables, @key)

    IO.puts(
      "ring, #{per} frames a read: #{div(bytes, 12_000)} bytes a frame (counted as #{div(counted, 12_000)}); " <>
        "two minutes of 100 frames/s are #{Float.round(bytes / 1_048_576, 1)} MB"
    )
  end

  # As fast as it is taken: the next read is given when the queue has room.
  defp throughput(dir, per) do
    gateway = recorded(gateway(dir, @off), {:vehicle, @key})
    frames = frames(per)
    [{_, _, counters, limit}] = :ets.tab2list(Tables.of(gateway).taps)
    recording = Names.whereis(gateway, :recording, {:vehicle, @key})
    cpu = Sample.cpu()

    {took, :ok} =
      :timer.tc(fn ->
        for _ <- 1..div(300_000, per) do
          Sample.until(fn -> Recorder.Tap.waiting(counters) <= div(limit, 2) end, 1)
          Recorder.vehicle_frames(gateway, @key, frames)
        end

        Recorder.Recording.flush(recording)
        :ok
      end)

    cpu = Sample.cpu() - cpu
    %{frames: written, dropped: dropped, bytes: bytes} = Recorder.status(gateway, {:vehicle, @key})

    IO.puts(
      "one recording, #{per} frames a read: #{div(written * 1_000_000, took)} frames/s, dropped #{dropped}, " <>
        "#{Float.round(bytes / took, 1)} MB/s, #{Float.round(cpu / written * 100_000, 2)} CPU s per 100,000 frames"
    )
  end
end

options = Bench.Options.read(__ENV__.file, reads: 30_000)
Bench.Gateway.in_folder("recorder", &RecorderBench.main(&1, options[:reads]))
