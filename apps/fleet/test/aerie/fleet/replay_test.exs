defmodule Aerie.Fleet.ReplayTest do
  @moduledoc "Recorded flights as test vectors; G1: what every ground station records is read."
  use ExUnit.Case, async: true

  import Aerie.Flight, only: [frame: 2, frame: 3]
  import Aerie.Golden

  alias Aerie.Fleet.Replay
  alias MavCodec.Messages, as: M
  alias MavCodec.Tlog

  @fixtures Path.expand("../../../../vehicle/test/fixtures", __DIR__)
  @recordings ~w(arducopter_flight arducopter_mavlink1 ardurover_drive px4_flight px4_refusals
                 px4_118_failsafes_a px4_118_failsafes_b arducopter_48_failsafes ardurover_47_failsafes
                 arduplane_47_quadplane_vtol)
  @second 1_000_000
  @start 1_795_000_000 * @second

  defp file(name), do: Path.join(@fixtures, name <> ".tlog.gz")
  defp bytes(name), do: name |> file() |> File.read!() |> :zlib.gunzip()

  # The result as bytes: equal ones are equal in every detail.
  defp exact({:ok, flight}), do: :erlang.term_to_binary(flight, [:deterministic])

  defp tlog(frames), do: frames |> Tlog.records() |> IO.iodata_to_binary()
  defp play(frames, options \\ []), do: Replay.run({:chunks, [tlog(frames)]}, options)
  defp types({:ok, flight}), do: Enum.map(flight.events, & &1.type)

  defp beat(second, changes \\ [], source \\ []) do
    frame(
      struct!(%M.Heartbeat{type: 2, autopilot: 3, base_mode: 81, custom_mode: 4}, changes),
      at(second),
      source
    )
  end

  defp text(second, text, source \\ []), do: frame(%M.Statustext{severity: 6, text: text}, at(second), source)
  defp at(second), do: @start + round(second * @second)

  test "what an autopilot says before its first heartbeat is an event of it, at its own time" do
    early = [text(0, "ArduCopter V4.6"), text(1, "of a gimbal", component: 154), text(2.5, "Frame: QUAD")]
    {:ok, flight} = play(early ++ [beat(4), text(5, "Ready")])

    assert Enum.map(flight.events, &{&1.data["text"], &1.time}) ==
             [{"ArduCopter V4.6", at(0)}, {"of a gimbal", at(1)}, {"Frame: QUAD", at(2.5)}, {"Ready", at(5)}]
  end

  describe "flights of real firmware" do
    for recording <- @recordings do
      test "#{recording} gives what it gave" do
        assert {:ok, flight} = Replay.run(file(unquote(recording)))
        assert_golden(flight, Path.join(@fixtures, unquote(recording) <> ".events.txt"))
        for event <- flight.events, do: declared!(event)
      end

      test "#{recording} gives the same to the byte, in one piece or in pieces of any size" do
        once = exact(Replay.run(file(unquote(recording))))
        whole = bytes(unquote(recording))
        assert exact(Replay.run({:chunks, [whole]})) == once

        assert exact(
                 Replay.run(
                   {:chunks, for(<<piece::binary-size(997) <- whole>>, do: piece) ++ rest(whole, 997)}
                 )
               ) == once
      end
    end

    defp rest(whole, size), do: [binary_part(whole, byte_size(whole), -rem(byte_size(whole), size))]
  end

  describe "bytes" do
    # The first of a flight: parameters, texts, and a vehicle that gets ready.
    setup do: %{beginning: binary_part(bytes("px4_refusals"), 0, 60_000)}

    test "cut anywhere give identical results", %{beginning: beginning} do
      expected = exact(Replay.run({:chunks, [beginning]}))

      property =
        :proper.forall(:proper_types.list(:proper_types.range(0, byte_size(beginning))), fn cuts ->
          exact(Replay.run({:chunks, cut(beginning, cuts)})) == expected
        end)

      assert :proper.quickcheck(property, [:quiet, numtests: 40]) == true, inspect(:proper.counterexample())
    end

    defp cut(bytes, cuts) do
      {pieces, last} =
        (Enum.sort(cuts) ++ [byte_size(bytes)])
        |> Enum.map_reduce(0, fn to, from -> {binary_part(bytes, from, to - from), to} end)

      assert last == byte_size(bytes)
      pieces
    end

    test "that end anywhere give what was before the end", %{beginning: beginning} do
      {:ok, whole} = Replay.run({:chunks, [beginning]})

      property =
        :proper.forall(:proper_types.range(2_000, byte_size(beginning)), fn length ->
          {:ok, part} = Replay.run({:chunks, [binary_part(beginning, 0, length)]})

          List.starts_with?(whole.events, part.events) and List.starts_with?(whole.samples, part.samples) and
            part.summary.damaged_parts <= 1 and part.summary.bytes + part.summary.damaged_bytes == length
        end)

      assert :proper.quickcheck(property, [:quiet, numtests: 40]) == true, inspect(:proper.counterexample())
    end

    test "damaged anywhere cost themselves and are counted", %{beginning: beginning} do
      {:ok, whole} = Replay.run({:chunks, [beginning]})

      property =
        :proper.forall(
          {:proper_types.range(0, byte_size(beginning) - 50), :proper_types.binary(50)},
          fn {from, noise} ->
            <<head::binary-size(^from), _::binary-size(50), tail::binary>> = beginning
            {:ok, part} = Replay.run({:chunks, [head, noise, tail]})
            %{bytes: read, damaged_bytes: damaged, frames: frames} = part.summary
            read + damaged == byte_size(beginning) and frames >= whole.summary.frames - 6
          end
        )

      assert :proper.quickcheck(property, [:quiet, numtests: 40]) == true, inspect(:proper.counterexample())
    end
  end

  describe "frames of any message with any content" do
    test "are taken as what they are: nothing raises, and what comes of them can be published" do
      property =
        :proper.forall(:proper_types.list(any_frame()), fn frames ->
          frames = for {frame, n} <- Enum.with_index(frames, 1), do: made(frame, at(n / 10))
          {:ok, flight} = play([beat(0) | frames])
          for event <- flight.events, do: Aerie.Fleet.Bridge.Message.event(event)
          for event <- flight.events, do: declared!(event)

          for s <- flight.samples,
              do: Aerie.Fleet.Bridge.Message.state(s.vehicle, "#{s.group}", s.data, s.time_boot_ms, s.at)

          flight.summary.frames == length(frames) + 1
        end)

      assert :proper.quickcheck(property, [:quiet, numtests: 300, max_size: 60]) == true,
             inspect(:proper.counterexample())
    end

    @declared Map.new(Aerie.Vehicle.Event.Types.all(), &{&1.type, Enum.map(&1.fields, fn f -> f.name end)})
    defp declared!(event), do: [] = Map.keys(event.data) -- ["position" | @declared[event.type]]

    # Those that the cores look at, more often than the others.
    defp any_frame do
      looked_at = [
        0,
        1,
        2,
        4,
        22,
        24,
        30,
        33,
        42,
        65,
        74,
        77,
        111,
        147,
        148,
        162,
        235,
        242,
        244,
        245,
        253,
        410
      ]

      id =
        :proper_types.frequency([
          {3, :proper_types.elements(looked_at)},
          {1, :proper_types.elements(MavCodec.Dialects.All.ids())}
        ])

      byte =
        :proper_types.frequency([
          {2, :proper_types.elements([0, 1, 127, 128, 192, 255])},
          {1, :proper_types.byte()}
        ])

      payload = :proper_types.oneof([:proper_types.list(byte), :proper_types.vector(255, byte)])
      {id, payload, :proper_types.range(1, 3), :proper_types.elements([1, 1, 1, 2, 190])}
    end

    defp made({id, payload, system, component}, at) do
      [extra | _] = id |> MavCodec.Dialects.All.crc_extra() |> List.wrap()
      payload = payload |> Enum.take(255) |> :erlang.list_to_binary()
      bytes = MavCodec.Frame.Raw.frame(id, payload, extra, system: system, component: component)
      MavCodec.Frame.from_bytes(bytes, extra, at)
    end

    test "F7: a HIGH_LATENCY2 whose end was cut off, because it is zeros, is one all the same" do
      assert {:ok, %{summary: %{vehicles: ["VID-002"]}}} = play([made({235, [7], 2, 1}, at(0))])
    end
  end

  describe "a file" do
    @describetag :tmp_dir

    test "may be gzipped or not, and go on in another", %{tmp_dir: dir} do
      once = exact(Replay.run(file("px4_flight")))
      whole = bytes("px4_flight")
      plain = Path.join(dir, "plain.tlog")
      File.write!(plain, whole)
      assert exact(Replay.run(plain)) == once

      # As rotated by a recorder: between two records.
      {one, two} = whole |> Aerie.Flight.parse() |> Enum.split(2_000)
      files = [first, second] = [Path.join(dir, "1.tlog"), Path.join(dir, "2.tlog")]
      File.write!(first, tlog(one))
      File.write!(second, tlog(two))
      assert exact(Replay.run(files)) == once
    end

    test "that does not exist says so", %{tmp_dir: dir} do
      missing = Path.join(dir, "missing.tlog")
      assert Replay.run(missing) == {:error, "#{missing}: no such file or directory"}
      assert Replay.run(dir) == {:error, "#{dir}: illegal operation on a directory"}
      empty = Path.join(dir, "empty.tlog")
      File.write!(empty, "")
      assert Replay.run(empty) == {:error, "#{empty}: the file is empty"}
      other = Path.join(dir, "other.tlog")
      File.write!(other, String.duplicate("no record ", 1_000))
      assert Replay.run(other) == {:error, "#{other}: no MAVLink record found (is it a tlog?)"}
      gzip = Path.join(dir, "damaged.tlog.gz")
      File.write!(gzip, "px4_flight" |> file() |> File.read!() |> damage())
      assert Replay.run(gzip) == {:error, "#{gzip}: damaged gzip data, or a disk error"}
      assert Replay.run([]) == {:error, "no recording was given"}
    end

    defp damage(<<head::binary-size(50_000), _::binary-size(100), tail::binary>>),
      do: head <> String.duplicate(<<0x55>>, 100) <> tail

    test "with a cut-off end is read to there, and the end is reported", %{tmp_dir: dir} do
      path = Path.join(dir, "cut.tlog")
      whole = bytes("px4_refusals")
      File.write!(path, binary_part(whole, 0, byte_size(whole) - 5))
      assert {:ok, %{summary: summary}} = Replay.run(path)
      assert [%Tlog.Damage{kind: :cut_off, bytes: cut}] = summary.damage
      assert %{damaged_parts: 1, damaged_bytes: ^cut} = summary
    end
  end

  describe "virtual time" do
    test "a vehicle that falls silent is lost when its time is up, and restored with its next frame" do
      flight = play([beat(0), beat(1), beat(60), beat(61)])
      assert {:ok, %{events: [lost, restored], statuses: statuses}} = flight

      assert {lost.type, lost.time, restored.type, restored.time} ==
               {"link.lost", at(6), "link.restored", at(60)}

      assert Enum.map(statuses, &{&1.from, &1.to, round((&1.at - @start) / @second)}) ==
               [{:online, :stale, 4}, {:stale, :lost, 6}, {:lost, :online, 60}]
    end

    test "a text that stays incomplete comes when its time is up, not with the next frame" do
      chunk = %M.Statustext{severity: 4, text: String.duplicate("x", 50), id: 7, chunk_seq: 0}
      {:ok, flight} = play([beat(0), frame(chunk, at(0.5)), beat(2.9)])
      assert [%{type: "statustext", time: time}] = flight.events
      assert time == at(1.5)
    end

    test "one vehicle's frames are another's clock" do
      frames = [beat(0), beat(0, [], system: 2)] ++ for(second <- 1..10, do: beat(second, [], system: 2))

      assert {:ok,
              %{
                events: [%{type: "link.lost", vehicle: "VID-001"}],
                snapshots: %{"VID-001" => %{status: :lost}}
              }} = play(frames)
    end

    test "a second recording in the same file begins time again, and loses no vehicle" do
      later = for second <- 100..103, do: beat(second)
      earlier = for second <- 0..3, do: beat(second, base_mode: 209)
      assert {:ok, flight} = play(later ++ earlier)
      assert [%{type: "armed", time: time}] = flight.events
      assert time == at(0)
      assert flight.summary.jumps == 1
    end
  end

  describe "what the router has to say about frames" do
    test "H2, H4: an autopilot's heartbeat makes a vehicle, nobody else's does" do
      others = [
        beat(0, [type: 6, autopilot: 8], system: 255, component: 190),
        beat(0, [type: 26, autopilot: 8], system: 9, component: 154),
        text(0, "who are you", system: 7),
        text(0, "I boot")
      ]

      assert {:ok, flight} = play(others ++ [beat(1), text(1, "here I am")])
      assert flight.summary.vehicles == ["VID-001"]
      assert flight.summary.unclaimed == 4
      assert Enum.map(flight.events, & &1.data["text"]) == ["I boot", "here I am"]
      assert [{9, 154}, {255, 190}] = Enum.map(flight.summary.stations, &{&1.system, &1.component})
    end

    test "a recording without a vehicle has no flight, which is not an error" do
      assert {:ok, %{events: [], snapshots: %{}, summary: %{vehicles: []}}} =
               play([beat(0, [type: 6, autopilot: 8], system: 255)])
    end

    test "our own frames are not a vehicle's, but its answers to what we asked are read: its clock is known" do
      own = [system: 237, component: 191]
      request = frame(%M.Timesync{tc1: 0, ts1: 555}, at(2), own)
      answer = frame(%M.Timesync{tc1: 7_000_000_000, ts1: 555}, at(2.02))
      assert {:ok, flight} = play([beat(0), beat(1, [type: 18, autopilot: 8], own), request, answer, beat(3)])
      assert flight.summary.own == 2
      assert flight.summary.stations == []
      assert %{rtt_us: 20_000, offset_us: offset} = flight.snapshots["VID-001"].clock
      assert offset == 7_000_000 - at(2.01)
    end

    test "a gateway that got no time recorded what it sent before what came meanwhile: that is not a silence" do
      own = fn second -> beat(second, [type: 18, autopilot: 8], system: 237, component: 191) end
      late = Enum.map(2..30, &beat/1)
      assert {:ok, %{events: [], statuses: [], summary: summary}} = play([beat(0), beat(1), own.(30) | late])
      assert %{jumps: 0, own: 1} = summary
    end

    test "a recording that ends with our own frames has the silence before its end" do
      own = for second <- 2..20, do: beat(second, [type: 18, autopilot: 8], system: 237, component: 191)
      assert {:ok, flight} = play([beat(0), beat(1) | own])
      assert [{"link.lost", at}] = Enum.map(flight.events, &{&1.type, &1.time})
      assert at in at(6)..at(6.2)
      assert flight.summary.to == at(20)
    end

    test "X5: answers to what others asked are not" do
      request = frame(%M.Timesync{tc1: 0, ts1: 555}, at(2), system: 255, component: 190)
      answer = frame(%M.Timesync{tc1: 7_000_000_000, ts1: 555}, at(2.02))
      assert {:ok, flight} = play([beat(0), request, answer, beat(3)])
      assert %{offset_us: nil, foreign: 1} = flight.snapshots["VID-001"].clock
    end

    test "H5: the ground station that its failsafe listens to goes and comes back" do
      gcs = fn second -> beat(second, [type: 6, autopilot: 8, base_mode: 0], system: 255, component: 190) end
      param = %M.ParamValue{param_id: "SYSID_MYGCS", param_value: 255.0, param_type: 4, param_count: 1}
      frames = [beat(0), frame(param, at(0.1))]
      seconds = Enum.flat_map(1..40, &[beat(&1) | if(&1 in 1..9 or &1 > 25, do: [gcs.(&1)], else: [])])
      assert {:ok, flight} = play(frames ++ seconds)
      assert [{"gcs.lost", lost}, {"gcs.restored", _}] = Enum.map(flight.events, &{&1.type, &1.time})
      assert lost == at(14)
    end

    test "what two links brought is one text, and what is said twice is two" do
      both = [text(1, "twice", seq: 7), text(1.4, "twice", seq: 7)]
      again = text(2, "twice", seq: 8)
      assert {:ok, flight} = play([beat(0)] ++ both ++ [again])
      assert Enum.map(flight.events, &{&1.data["text"], &1.time}) == [{"twice", at(1)}, {"twice", at(2)}]
      assert flight.summary.copies == 1
    end

    test "no more vehicles than the configuration allows" do
      frames = for system <- 1..5, do: beat(system / 10, [], system: system)
      assert {:ok, flight} = play(frames, settings: Replay.Settings.from(%{limits: %{max_vehicles: 3}}))
      assert flight.summary.vehicles == ~w(VID-001 VID-002 VID-003)
      assert %{refused: 2, unclaimed: 2} = flight.summary
    end
  end

  test "names and networks are those of the configuration" do
    config = %{network: "main", vehicles: [%{id: "HAWK", network: "north", system_id: 1}]}

    assert {:ok, flight} =
             play([beat(0), beat(1, base_mode: 209)],
               settings: Replay.Settings.from(config),
               network: "north"
             )

    assert [%{type: "armed", vehicle: "HAWK"}] = flight.events
    assert %{"HAWK" => %{key: {"north", 1}, links: ["replay"]}} = flight.snapshots
    assert types(play([beat(0)])) == []
  end

  test "outputs can be taken one by one, in the order in which they come about" do
    count = fn {kind, _output}, counts -> Map.update(counts, kind, 1, &(&1 + 1)) end
    {:ok, flight} = Replay.run(file("px4_flight"))
    assert {:ok, counts, summary} = Replay.reduce(file("px4_flight"), [], %{}, count)
    assert summary == flight.summary

    assert counts == %{
             event: length(flight.events),
             sample: length(flight.samples),
             send: length(flight.sent)
           }

    assert {:ok, order, _} =
             Replay.reduce(file("px4_flight"), [], [], fn
               {:event, event}, order -> [event.time | order]
               _other, order -> order
             end)

    assert order == Enum.sort(order, :desc)
  end
end
