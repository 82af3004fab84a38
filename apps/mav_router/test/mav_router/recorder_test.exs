defmodule MavRouter.RecorderTest do
  use ExUnit.Case, async: true
  use Aerie.RecorderCase

  alias Aerie.Base.Store
  alias Aerie.Base.{Error, Names}
  alias Aerie.Base.Files.Raw
  alias MavRouter.{Recorder, Router}
  alias MavRouter.Recorder.{Recording, Tap}
  alias Aerie.RecorderCase.{FaultyDisk, FullDisk}
  alias MavCodec.Messages

  @moduletag :tmp_dir
  @key {"main", 1}

  # A vehicle that is recorded without a link: frames go to the recorder as its session would give them.
  defp vehicle(gateway, mode \\ :always, key \\ @key) do
    :ok = Recorder.start(gateway, {:vehicle, key}, mode)
    Names.whereis(gateway, :recording, {:vehicle, key})
  end

  defp give(gateway, frames), do: Recorder.vehicle_frames(gateway, @key, frames)
  defp status(gateway), do: Recorder.status(gateway, {:vehicle, @key})
  defp numbers(path), do: path |> recorded() |> Enum.map(&number/1)

  describe "a link" do
    test "is recorded as it is heard and spoken to, and its file has its name", c do
      gateway = start_recorder(c.tmp_dir, %{links: :always})
      be_session(gateway, 7)
      {id, port} = add_link(gateway, "udpin:127.0.0.1:0", id: "radio 1", network: "main")
      {:ok, socket} = :gen_udp.open(0, [:binary])
      for n <- 1..5, do: :ok = :gen_udp.send(socket, {127, 0, 0, 1}, port, attitude(7, n))
      heard = frames(5)
      :ok = Router.send(gateway, {"main", 7}, heartbeat(237, type: 18, autopilot: 8, component: 191))
      assert_receive {:udp, ^socket, _address, _port, _bytes}

      file = eventually(fn -> Recorder.status(gateway, {:link, id}).file end)
      assert Path.basename(file) =~ ~r/\Amain-radio_1-\d{8}T\d{6}Z\.tlog\z/
      :ok = Recorder.stop(gateway, {:link, id})
      assert [a, b, cc, d, e, ours] = recorded(file)
      assert Enum.map([a, b, cc, d, e], &{&1.at, &1.bytes}) == Enum.map(heard, &{&1.at, &1.bytes})
      assert {ours.system, ours.component, ours.id} == {237, 191, 0}
      assert %{state: :off, dropped: 0, frames: 6, files: 1} = Recorder.status(gateway, {:link, id})
      assert [%{file: ^file, open: false, bytes: bytes}] = Recorder.list(gateway)
      assert bytes == File.stat!(file).size
    end

    test "its snapshot shows the recording", c do
      gateway = start_recorder(c.tmp_dir, %{links: :always})
      be_session(gateway, 7)
      {id, port} = add_link(gateway, "udpin:127.0.0.1:0", id: "radio")

      assert %{state: :waiting, mode: :always, file: nil, error: nil} =
               snapshot(gateway, id).recording

      {:ok, socket} = :gen_udp.open(0, [:binary])
      :ok = :gen_udp.send(socket, {127, 0, 0, 1}, port, attitude(7, 1))
      frames(1)
      file = eventually(fn -> Recording.flush(Names.whereis(gateway, :recording, {:link, id})) end)

      assert %{state: :recording, file: ^file, size: size, since: since, dropped: 0, frames: 1} =
               snapshot(gateway, id).recording

      assert size == File.stat!(file).size
      assert_in_delta since, System.os_time(:second), 60
    end

    test "what is forwarded to its vehicle is recorded, and in the vehicle's ring", c do
      gateway = start_recorder(c.tmp_dir, %{links: :always})
      be_session(gateway, 7)
      {radio, radio_port} = add_link(gateway, "udpin:127.0.0.1:0", id: "radio")
      {_ground, ground_port} = add_link(gateway, "udpin:127.0.0.1:0", id: "ground")
      {:ok, vehicle} = :gen_udp.open(0, [:binary])
      {:ok, station} = :gen_udp.open(0, [:binary])
      :ok = :gen_udp.send(vehicle, {127, 0, 0, 1}, radio_port, heartbeat(7))
      [beat] = frames(1)
      :ok = Recorder.vehicle_frames(gateway, {"main", 7}, [beat])
      :ok = :gen_udp.send(station, {127, 0, 0, 1}, ground_port, heartbeat(255, type: 6, autopilot: 8))
      eventually(fn -> Router.route(gateway, {"main", 255}) end)

      order =
        MavCodec.encode(%Messages.CommandLong{target_system: 7, command: 400}, system: 255, component: 190)

      assert_order(vehicle, station, ground_port, order)
      file = eventually(fn -> Recording.flush(Names.whereis(gateway, :recording, {:link, radio})) end)
      assert order in Enum.map(recorded(file), & &1.bytes)
      {:ok, saved} = Recorder.save(gateway, {"main", 7})
      assert [_heartbeat, %{bytes: ^order} | _] = recorded(saved)
    end

    defp assert_order(vehicle, station, port, order) do
      :ok = :gen_udp.send(station, {127, 0, 0, 1}, port, order)

      receive do
        {:udp, ^vehicle, _, _, ^order} -> :ok
        {:udp, ^vehicle, _, _, _other} -> assert_order(vehicle, station, port, order)
      after
        Aerie.Patience.ms() -> flunk("the order was not forwarded")
      end
    end

    test "killed, its recording is back with a new file, and the link has not noticed", c do
      gateway = start_recorder(c.tmp_dir, %{links: :always})
      be_session(gateway, 7)
      {id, port} = add_link(gateway, "udpin:127.0.0.1:0", id: "radio")
      {:ok, socket} = :gen_udp.open(0, [:binary])
      link = Names.whereis(gateway, :link, id)
      recording = Names.whereis(gateway, :recording, {:link, id})
      :ok = :gen_udp.send(socket, {127, 0, 0, 1}, port, attitude(7, 1))
      frames(1)
      first = eventually(fn -> Recording.flush(recording) end)
      Process.exit(recording, :kill)

      again =
        eventually(fn ->
          pid = Names.whereis(gateway, :recording, {:link, id})
          pid != recording && pid
        end)

      # It has its name before its queue.
      _ = :sys.get_state(again, Aerie.Patience.ms())

      :ok = :gen_udp.send(socket, {127, 0, 0, 1}, port, attitude(7, 2))
      frames(1)
      second = eventually(fn -> Recording.flush(again) end)
      assert second != first
      # What is already with the file system is not lost with its writer.
      assert numbers(first) == [1]
      assert numbers(second) == [2]
      assert Names.whereis(gateway, :link, id) == link
    end
  end

  describe "a vehicle" do
    test "armed: from arming to disarming, each flight a file", c do
      gateway = start_recorder(c.tmp_dir, %{after_s: 0})
      recording = vehicle(gateway, :armed)
      assert status(gateway).state == :waiting

      for flight <- 0..1 do
        at = flight * 1_000_000
        give(gateway, [beat(1, false, at + 1), beat(1, true, at + 2)] ++ attitudes(1, 1..3, at))
        give(gateway, [beat(1, false, at + 9000), beat(1, false, at + 9001)])
        nil = Recording.flush(recording)
      end

      assert [first, second] = tlogs(c.tmp_dir)
      # The one that says disarmed is the last.
      assert length(recorded(first)) == 5
      assert length(recorded(second)) == 5
      assert %{files: 2, frames: 10, state: :waiting} = status(gateway)
    end

    test "begins by itself when the configuration asks for it, and again when it was killed", c do
      gateway = start_recorder(c.tmp_dir, %{vehicles: :always})
      Store.put_vehicle(gateway, @key, %{id: "VID-001", key: @key, last_heard: 5})
      first = eventually(fn -> Names.whereis(gateway, :recording, {:vehicle, @key}) end)
      # It has its name before it says how it is.
      waits? = fn -> match?(%{label: "main-VID-001", state: :waiting}, status(gateway)) end
      eventually(waits?)
      Process.exit(first, :kill)
      eventually(fn -> Names.whereis(gateway, :recording, {:vehicle, @key}) not in [nil, first] end)
      eventually(waits?)
      assert :ok = Recorder.stop(gateway, {:vehicle, "VID-001"})
      assert Recorder.status(gateway, {:vehicle, "VID-001"}).state == :off
    end

    test "always: begins with what was heard before there was anything to record, nothing twice", c do
      gateway = start_recorder(c.tmp_dir)
      test = self()

      giver =
        spawn_link(fn ->
          for n <- 1..2000 do
            give(gateway, attitudes(1, n..n))
            if n == 500, do: send(test, :go)
          end

          send(test, :done)
        end)

      assert is_pid(giver)
      assert_receive :go
      recording = vehicle(gateway)
      assert_receive :done
      file = Recording.flush(recording)
      assert numbers(file) == Enum.to_list(1..2000)

      # A second one goes on, with what came since.
      :ok = Recorder.stop(gateway, {:vehicle, @key})
      give(gateway, attitudes(1, 2001..2001))
      :ok = Recorder.start(gateway, {:vehicle, @key})
      give(gateway, attitudes(1, 2002..2002))
      assert numbers(Recording.flush(recording)) == [2002]
    end

    test "a file is followed by the next when it is long enough", c do
      gateway = start_recorder(c.tmp_dir, %{max_file_mb: 0.02})
      recording = vehicle(gateway)

      for part <- Enum.chunk_every(attitudes(1, 1..2000), 50) do
        give(gateway, part)
        Recording.flush(recording)
      end

      :ok = Recorder.stop(gateway, {:vehicle, @key})
      files = tlogs(c.tmp_dir)
      assert length(files) > 3
      assert files |> Enum.flat_map(&numbers/1) |> Enum.sort() == Enum.to_list(1..2000)
      for file <- files, do: assert(File.stat!(file).size < 25_000)
    end

    test "or old enough", c do
      gateway = start_recorder(c.tmp_dir, %{max_file_minutes: 0.001})
      recording = vehicle(gateway)
      give(gateway, attitudes(1, 1..10))
      Recording.flush(recording)
      # Looked at once a second: on a busy machine it is over before anybody could ask.
      eventually(fn -> status(gateway).file == nil end)
      give(gateway, attitudes(1, 11..20))
      Recording.flush(recording)
      assert [first, second] = Enum.map(Recorder.list(gateway), & &1.file)
      assert {numbers(first), numbers(second)} == {Enum.to_list(1..10), Enum.to_list(11..20)}
    end

    test "S9: neither keys nor signatures get into a file", c do
      gateway = start_recorder(c.tmp_dir)
      recording = vehicle(gateway)
      key = :crypto.hash(:sha256, "secret")
      setup = MavCodec.encode(%Messages.SetupSigning{secret_key: key, target_system: 1}, system: 255)
      {signed, signer} = MavCodec.Signing.sign(MavCodec.Signing.new(key), attitude(1, 7), 39)
      {signed_setup, _} = MavCodec.Signing.sign(signer, setup, 71)
      give(gateway, [frame(setup, 1), frame(signed, 2)])
      # Sent ones too, for the vehicle that they are for.
      :ok = Recorder.sent(gateway, "radio", "main", [setup, signed_setup, signed])
      file = Recording.flush(recording)
      assert File.read!(file) |> :binary.match(key) == :nomatch
      assert [a, b, cc, d] = recorded(file)
      assert Enum.all?([a, b, cc, d], &(&1.signature == nil))
      assert b.bytes == attitude(1, 7)
      assert {:ok, %{secret_key: hidden}} = MavCodec.decode(cc)
      assert hidden == :binary.copy(<<0xFF>>, 32)
      # Nor into a ring, or a message that a crash report would show.
      assert [_ | _] = entries = Recorder.Ring.entries(Recorder.Tables.of(gateway), @key)
      for {_n, records, _frames} <- entries, do: assert(:binary.match(records, key) == :nomatch)
      _counters = Tap.open(Recorder.Tables.of(gateway), {:link, "radio"}, 10_000)
      :ok = Recorder.link_frames(gateway, "radio", [frame(setup, 1), frame(signed_setup, 2)])
      assert_received {:record, {:link, "radio"}, _bytes, [%{id: 256} = one, %{id: 256} = other], nil}
      for term <- [one, other], do: assert(:binary.match(:erlang.term_to_binary(term), key) == :nomatch)
    end

    test "S9: nor do passwords in any other message, into a file, a ring or a tap", c do
      gateway = start_recorder(c.tmp_dir)
      recording = vehicle(gateway)
      _counters = Tap.open(Recorder.Tables.of(gateway), {:link, "radio"}, 100_000)

      for %module{} = message <- MavCodec.SecretSamples.all() do
        bytes = MavCodec.encode(message, system: 1)
        give(gateway, [frame(bytes, 1)])
        :ok = Recorder.sent(gateway, "radio", "main", [bytes])
        :ok = Recorder.link_frames(gateway, "radio", [frame(bytes, 1)])
        assert_receive {:record, {:link, "radio"}, _bytes, [%{id: id}] = frames, nil}
        assert id == module.id()
        assert :binary.match(:erlang.term_to_binary(frames), "hunter22") == :nomatch
      end

      file = Recording.flush(recording)
      assert length(recorded(file)) >= length(MavCodec.Signing.Redact.table())
      assert File.read!(file) |> :binary.match("hunter22") == :nomatch
      entries = Recorder.Ring.entries(Recorder.Tables.of(gateway), @key)
      for {_n, records, _frames} <- entries, do: assert(:binary.match(records, "hunter22") == :nomatch)
    end
  end

  describe "a disk that fails" do
    @describetag :capture_log

    test "full (the system says so): records are lost and counted, nothing else, and the log says so once",
         c do
      gateway = start_recorder(c.tmp_dir, %{files: FullDisk, pause_ms: 0})
      listen_paused(gateway)
      recording = vehicle(gateway)

      log =
        ExUnit.CaptureLog.capture_log(fn ->
          # It is written, and told of, a few milliseconds later by itself.
          give(gateway, attitudes(1, 1..10))
          assert Recording.flush(recording) == nil
          give(gateway, attitudes(1, 1..1))
          assert Recording.flush(recording) == nil
        end)

      assert length(String.split(log, "main-1 is not recorded: no space left on device")) == 2
      assert_received {:paused, "no space left on device"}
      assert %{state: :paused, dropped: 11, frames: 0, reason: "no space left on device"} = status(gateway)
      assert %{errors: 2, error: %{reason: "no space left on device", at: at}} = status(gateway)
      assert_in_delta at, System.os_time(:second), 60
      give(gateway, attitudes(1, 11..20))
      Recording.flush(recording)
      assert status(gateway).dropped == 21
      assert Process.alive?(recording)
    end

    test "full: nothing is left of files that could not be written, and one event says so", c do
      gateway = start_recorder(c.tmp_dir, %{files: FullDisk, pause_ms: 0})

      log =
        ExUnit.CaptureLog.capture_log(fn ->
          for system <- 1..3 do
            recording = vehicle(gateway, :always, {"main", system})
            for _try <- 1..3, do: assert(try_again(gateway, recording, system) == nil)
          end
        end)

      # The answer comes after what was said before it.
      assert Recorder.list(gateway) == []
      assert tlogs(c.tmp_dir) == []
      assert length(String.split(log, "is not recorded: no space left on device")) == 2
    end

    test "not one block free: no file is begun", c do
      FaultyDisk.new(c.tmp_dir)
      gateway = start_recorder(c.tmp_dir, %{files: FaultyDisk, pause_ms: 0})
      FaultyDisk.set(c.tmp_dir, :free, 1000)
      recording = vehicle(gateway)
      give(gateway, attitudes(1, 1..10))
      assert Recording.flush(recording) == nil
      assert %{state: :paused, reason: reason, files: 0} = status(gateway)
      assert reason =~ "no space left on device"
      assert tlogs(c.tmp_dir) == []
    end

    test "it is tried again after growing pauses, of a minute at most" do
      tables = %{notes: :ets.new(:notes, [:public]), settings: Recorder.Settings.from(%{})}
      output = Recorder.Recording.Output.new(make_ref(), tables, {:link, "l"}, "l", nil)

      Enum.reduce([5, 10, 20, 40, 60, 60, 60], output, fn pause, output ->
        before = System.monotonic_time(:millisecond)
        output = Recorder.Recording.Output.write(%{output | paused_until: nil}, "x", 1)
        # The moment from which it counts is between the two.
        assert output.paused_until >= before + pause * 1000
        assert output.paused_until <= System.monotonic_time(:millisecond) + pause * 1000
        output
      end)
    end

    test "recordings are for their owner alone", c do
      gateway = start_recorder(c.tmp_dir, %{})
      recording = vehicle(gateway)
      give(gateway, attitudes(1, 1..10))
      file = Recording.flush(recording)
      mode = &Bitwise.band(File.stat!(&1).mode, 0o777)
      assert mode.(file) == 0o600
      assert mode.(Path.dirname(file)) == 0o700
      assert mode.(Path.join(Path.dirname(file), "recordings.index")) == 0o600
    end

    defp try_again(gateway, recording, system) do
      Recorder.vehicle_frames(gateway, {"main", system}, attitudes(system, 1..3))
      Recording.flush(recording)
    end

    test "full in the middle of a record, then free again: what was written before can be read", c do
      FaultyDisk.new(c.tmp_dir)
      gateway = start_recorder(c.tmp_dir, %{files: FaultyDisk, pause_ms: 0})
      recording = vehicle(gateway)
      give(gateway, attitudes(1, 1..10))
      first = Recording.flush(recording)
      FaultyDisk.set(c.tmp_dir, :full, true)
      give(gateway, attitudes(1, 11..15))
      assert Recording.flush(recording) == nil
      give(gateway, attitudes(1, 16..20))
      assert Recording.flush(recording) == nil
      FaultyDisk.set(c.tmp_dir, :full, false)
      give(gateway, attitudes(1, 21..30))
      second = Recording.flush(recording)
      assert second != first

      # The first file ends in the middle of a record; whole ones before that count, and are only told as dropped.
      assert Enum.take(numbers(first), 10) == Enum.to_list(1..10)

      assert [%MavCodec.Tlog.Damage{kind: :cut_off}] =
               first |> MavCodec.Tlog.Reader.stream!() |> Enum.reject(&is_struct(&1, MavCodec.Frame))

      assert numbers(second) == Enum.to_list(21..30)
      assert %{dropped: 10, frames: 20, state: :recording, reason: nil} = status(gateway)
      # What was is not forgotten.
      assert %{errors: 2, error: %{reason: reason}} = status(gateway)
      assert reason =~ "no space left on device"
    end

    test "that hangs: its queue is bounded, and the giver of frames never waits", c do
      FaultyDisk.new(c.tmp_dir)
      gateway = start_recorder(c.tmp_dir, %{files: FaultyDisk, queue_kb: 64})
      FaultyDisk.set(c.tmp_dir, :gate, self())
      recording = vehicle(gateway)
      give(gateway, attitudes(1, 1..10))
      assert_receive {:at_the_gate, ^recording}

      for part <- Enum.chunk_every(attitudes(1, 11..5000), 10), do: give(gateway, part)
      assert {:message_queue_len, waiting} = Process.info(recording, :message_queue_len)
      assert waiting < 40

      assert [{{:vehicle, @key}, ^recording, counters, 65_536}] =
               :ets.tab2list(Recorder.Tables.of(gateway).taps)

      assert Tap.waiting(counters) <= 65_536
      dropped = Tap.dropped(counters)
      assert dropped > 4500

      FaultyDisk.set(c.tmp_dir, :gate, nil)
      send(recording, :pass)
      file = Recording.flush(recording)
      kept = numbers(file)
      # The oldest of them: a queue does not forget what it has.
      assert kept == Enum.to_list(1..(5000 - dropped))
      assert %{frames: frames, dropped: ^dropped} = status(gateway)
      assert frames + dropped == 5000
      assert Tap.waiting(counters) == 0
    end

    # Longer than OTP's 5 s for the end of a process.
    test "that is slow at the end: what was collected is written all the same", c do
      FaultyDisk.new(c.tmp_dir)
      gateway = start_recorder(c.tmp_dir, %{files: FaultyDisk, flush_ms: 60_000})
      recording = vehicle(gateway)
      give(gateway, attitudes(1, 1..10))

      _its_queue_is_empty = :sys.get_state(recording)
      FaultyDisk.set(c.tmp_dir, :gate, self())
      stopping = Task.async(fn -> Supervisor.stop(Names.via(gateway, :recorder)) end)
      assert_receive {:at_the_gate, ^recording}
      Process.send_after(recording, :pass, 5_500)
      Task.await(stopping, 30_000)
      assert [file] = tlogs(c.tmp_dir)
      assert numbers(file) == Enum.to_list(1..10)
    end

    # A pipe that nobody reads or writes is what a disk is whose bus is gone.
    test "that hangs when a file is begun: everybody else's files are read and written meanwhile", c do
      gateway = start_recorder(c.tmp_dir)
      File.mkdir_p!(dir = Path.join(c.tmp_dir, "recordings"))
      {"", 0} = System.cmd("mkfifo", [index = Path.join(dir, "recordings.index")])
      archive = Names.whereis(gateway, :recorder_archive)
      vehicle(gateway)
      give(gateway, attitudes(1, 1..10))

      eventually(fn ->
        match?({:current_stacktrace, [{:prim_file, _, _, _} | _]}, Process.info(archive, :current_stacktrace))
      end)

      # Not by this process, which waits for an answer without end.
      task = Task.async(fn -> File.write!(Path.join(c.tmp_dir, "other"), "written") end)
      written = Task.yield(task, Aerie.Patience.ms())

      {:ok, pipe} = :file.open(index, [:read, :write, :raw])
      :ok = Raw.rm(index)
      :ok = :file.close(pipe)
      assert written == {:ok, :ok}
      assert archive |> :sys.get_state(Aerie.Patience.ms()) |> is_map()
    end

    test "that hangs while its link is removed: other links start", c do
      FaultyDisk.new(c.tmp_dir)
      gateway = start_recorder(c.tmp_dir, %{files: FaultyDisk, links: :always})
      be_session(gateway, 7)
      {id, port} = add_link(gateway, "udpin:127.0.0.1:0")
      recording = Names.whereis(gateway, :recording, {:link, id})
      FaultyDisk.set(c.tmp_dir, :gate, self())
      {:ok, socket} = :gen_udp.open(0, [:binary])
      :ok = :gen_udp.send(socket, {127, 0, 0, 1}, port, attitude(7, 1))
      assert_receive {:at_the_gate, ^recording}

      server = Process.monitor(Names.whereis(gateway, :link, id))
      removal = Task.async(fn -> MavRouter.Link.stop(gateway, id) end)
      assert_receive {:DOWN, ^server, :process, _pid, :shutdown}
      {"other", _port} = add_link(gateway, "udpin:127.0.0.1:0", id: "other")
      assert Process.alive?(recording)
      send(recording, :pass)
      assert Task.await(removal, 30_000) == :ok
      assert [file] = tlogs(c.tmp_dir)
      assert numbers(file) == [1]
    end

    test "a file that somebody removes while it is written: told, and a new one is begun", c do
      gateway = start_recorder(c.tmp_dir)
      recording = vehicle(gateway)
      give(gateway, attitudes(1, 1..10))
      file = Recording.flush(recording)
      File.rm!(file)
      eventually(fn -> status(gateway).errors == 1 end)
      assert %{file: nil, error: %{reason: reason}} = status(gateway)
      assert reason == "#{file} was removed while it was written"
      give(gateway, attitudes(1, 11..20))
      assert numbers(Recording.flush(recording)) == Enum.to_list(11..20)
      assert status(gateway).state == :recording
    end

    test "a folder that cannot be made", c do
      File.write!(Path.join(c.tmp_dir, "recordings"), "in the way")
      gateway = start_recorder(c.tmp_dir)
      recording = vehicle(gateway)
      give(gateway, attitudes(1, 1..10))
      assert Recording.flush(recording) == nil
      assert %{state: :paused, dropped: 10, reason: reason} = status(gateway)
      assert reason =~ "recordings: "
      assert {:error, %Error{reason: {:unavailable, ^reason}}} = Recorder.save(gateway, @key)
    end

    defp listen_paused(gateway) do
      test = self()

      :telemetry.attach(
        {gateway, :paused},
        [:aerie, :recorder, :paused],
        fn _event, _measurements, metadata, _ ->
          if metadata.gateway == gateway, do: send(test, {:paused, metadata.reason})
        end,
        nil
      )

      on_exit(fn -> :telemetry.detach({gateway, :paused}) end)
    end
  end

  describe "room" do
    @describetag :capture_log

    setup c do
      FaultyDisk.new(c.tmp_dir)
      {:ok, dir: Path.join(c.tmp_dir, "recordings")}
    end

    # Complete recordings, about 10 kB each.
    defp record(gateway, recording, files) do
      for _ <- 1..files do
        give(gateway, attitudes(1, 1..230))
        file = Recording.flush(recording)
        :ok = Recorder.stop(gateway, {:vehicle, @key})
        :ok = Recorder.start(gateway, {:vehicle, @key})
        file
      end
    end

    test "our oldest go when ours are too many; what is not ours stays, whatever its name", c do
      gateway = start_recorder(c.tmp_dir, %{files: FaultyDisk, max_mb: 0.03})
      File.mkdir_p!(c.dir)
      foreign = Path.join(c.dir, "main-1-20200101T000000Z.tlog")
      File.write!(foreign, String.duplicate("x", 100_000))
      files = record(gateway, vehicle(gateway), 6)
      :ok = Recorder.Archive.check(gateway)
      left = Enum.map(Recorder.list(gateway), & &1.file)
      assert left == Enum.take(files, -length(left))
      assert length(left) in 2..3
      assert File.exists?(foreign)
      assert Enum.sort(tlogs(c.tmp_dir)) == Enum.sort([foreign | left])
    end

    test "our oldest go when the disk gets full, and nothing is recorded when that does not help", c do
      gateway = start_recorder(c.tmp_dir, %{files: FaultyDisk, min_free_mb: 1, pause_ms: 0})
      recording = vehicle(gateway)
      [oldest | newer] = record(gateway, recording, 3)
      FaultyDisk.set(c.tmp_dir, :free, 1_048_576 - 5_000)
      :ok = Recorder.Archive.check(gateway)
      assert Enum.map(Recorder.list(gateway), & &1.file) == newer
      refute File.exists?(oldest)

      give(gateway, attitudes(1, 1..10))
      assert Recording.flush(recording) == nil
      assert %{state: :paused, reason: "less than 1 MB are free", dropped: 10} = status(gateway)
      assert %{space: %{low: true, free: _}} = Recorder.status(gateway)

      FaultyDisk.set(c.tmp_dir, :free, 10_000_000)
      :ok = Recorder.Archive.check(gateway)
      _ = Recorder.list(gateway)
      give(gateway, attitudes(1, 11..20))
      assert numbers(Recording.flush(recording)) == Enum.to_list(11..20)
    end

    test "a recording that is being written is never removed", c do
      gateway = start_recorder(c.tmp_dir, %{files: FaultyDisk, min_free_mb: 1})
      recording = vehicle(gateway)
      give(gateway, attitudes(1, 1..10))
      file = Recording.flush(recording)
      FaultyDisk.set(c.tmp_dir, :free, 0)
      :ok = Recorder.Archive.check(gateway)
      assert [%{file: ^file, open: true}] = Recorder.list(gateway)
    end

    test "one is deleted on request, unless it is being written or not ours", c do
      gateway = start_recorder(c.tmp_dir)
      recording = vehicle(gateway)
      give(gateway, attitudes(1, 1..10))
      file = Recording.flush(recording)
      name = Path.basename(file)
      assert {:error, %{reason: {:conflict, _text}}} = Recorder.delete(gateway, name)
      :ok = Recorder.stop(gateway, {:vehicle, {"main", 1}})
      other = Path.join(Path.dirname(file), "other.tlog")
      File.write!(other, "not ours")

      for stranger <- ["other.tlog", "../" <> name, "recordings.index"],
          do:
            assert(
              {:error, %{reason: {:unknown, :recording, ^stranger}}} = Recorder.delete(gateway, stranger)
            )

      assert :ok = Recorder.delete(gateway, name)
      refute File.exists?(file)
      assert Recorder.list(gateway) == []
      assert File.exists?(other)
      assert {:error, %{reason: {:unavailable, _text}}} = Recorder.delete(make_ref(), name)
    end

    test "what somebody took out of the index, or wrote into it, is left alone", c do
      gateway = start_recorder(c.tmp_dir, %{files: FaultyDisk, max_mb: 0.001})
      recording = vehicle(gateway)
      [first] = record(gateway, recording, 1)
      index = Path.join(c.dir, "recordings.index")
      elsewhere = Path.join(c.tmp_dir, "precious-20200101T000000Z.tlog")
      File.write!(elsewhere, "precious")
      File.write!(index, "../precious-20200101T000000Z.tlog\n/etc/passwd\n\n")
      :ok = Recorder.Archive.check(gateway)
      assert Recorder.list(gateway) == []
      assert File.exists?(first)
      assert File.exists?(elsewhere)
    end

    test "the free space of a real disk is found out" do
      assert {:ok, bytes} = MavRouter.Recorder.Files.free("/")
      assert bytes > 0
      assert MavRouter.Recorder.Files.free("/nowhere") == :unknown
    end
  end

  describe "the ring" do
    test "has the last moments, and is saved on request with what comes after, nothing twice and nothing missing",
         c do
      # A minute, because the saving ends two seconds after its time even if nothing more comes, as on a busy machine. What comes
      # after is 1.2 s apart, so that fifty frames are that minute.
      gateway = start_recorder(c.tmp_dir, %{after_s: 60})

      frames =
        for {frame, n} <- Enum.with_index(attitudes(1, 1..200, 0), 1) do
          %{frame | at: 1_000_000_000_000_000 + 100_000 * min(n, 100) + 1_200_000 * max(n - 100, 0)}
        end

      Store.put_vehicle(gateway, @key, %{id: "VID-001", key: @key, last_heard: Enum.at(frames, 99).at})
      for part <- frames |> Enum.take(100) |> Enum.chunk_every(7), do: give(gateway, part)
      assert %{rings: %{@key => %{entries: 15}}} = Recorder.status(gateway)

      assert {:ok, file} = Recorder.save(gateway, "VID-001", "near miss")
      assert Path.basename(file) =~ ~r/\Amain-VID-001-near_miss-/
      # The past is in it already.
      assert Enum.take(numbers(file), 100) == Enum.to_list(1..100)
      saving = Names.whereis(gateway, :recording, {:saved, @key})
      monitor = Process.monitor(saving)
      for part <- frames |> Enum.drop(100) |> Enum.chunk_every(7), do: give(gateway, part)
      assert_receive {:DOWN, ^monitor, :process, _, :normal}
      assert numbers(file) == Enum.to_list(1..150)
      assert [%{open: false}] = Recorder.list(gateway)
    end

    test "frames that come while it is saved are in the file once", c do
      gateway = start_recorder(c.tmp_dir, %{after_s: 60})
      test = self()

      giver =
        spawn_link(fn ->
          for n <- 1..3000 do
            give(gateway, attitudes(1, n..n))
            if n == 1000, do: send(test, :go)
          end

          send(test, :done)
        end)

      assert is_pid(giver)
      assert_receive :go
      assert {:ok, file} = Recorder.save(gateway, @key)
      assert_receive :done
      assert ^file = Recording.flush(Names.whereis(gateway, :recording, {:saved, @key}))
      assert numbers(file) == Enum.to_list(1..3000)
    end

    test "a second request while it is saved goes on with the same file", c do
      gateway = start_recorder(c.tmp_dir, %{after_s: 60})
      give(gateway, attitudes(1, 1..10))
      assert {:ok, file} = Recorder.save(gateway, @key)
      give(gateway, attitudes(1, 11..20))
      assert {:ok, ^file} = Recorder.save(gateway, @key, "again")
      assert numbers(file) == Enum.to_list(1..20)
      assert [_one] = tlogs(c.tmp_dir)
    end

    test "is saved when an event calls for it", c do
      gateway = start_recorder(c.tmp_dir, %{ring: %{save_on: [:failsafe]}})
      give(gateway, attitudes(1, 1..10))
      Store.put_vehicle(gateway, @key, %{id: "VID-001", key: @key, last_heard: 1})
      event = %{vehicle: "VID-001", type: "armed", time: 1}
      :ok = Aerie.Base.PubSub.publish(gateway, :events, event)
      :ok = Aerie.Base.PubSub.publish(gateway, :events, %{event | type: "failsafe"})
      assert [file] = eventually(fn -> match?([_], tlogs(c.tmp_dir)) && tlogs(c.tmp_dir) end)
      assert Path.basename(file) =~ "main-VID-001-failsafe-"
      eventually(fn -> numbers(file) == Enum.to_list(1..10) end)
    end

    test "what is sent to a vehicle is in its ring, what is sent to all is not", c do
      gateway = start_recorder(c.tmp_dir)
      give(gateway, attitudes(1, 1..1))

      order =
        MavCodec.encode(%Messages.CommandLong{target_system: 1, command: 400}, system: 237, component: 191)

      :ok = Recorder.sent(gateway, "radio", "main", [order, heartbeat(237), order])
      :ok = Recorder.sent(gateway, "radio", "other", order)
      {:ok, file} = Recorder.save(gateway, @key)
      assert [30, 76, 76] = Enum.map(recorded(file), & &1.id)
    end

    test "a vehicle that cannot be saved is refused with the reason", c do
      gateway = start_recorder(c.tmp_dir, %{ring: %{enabled: false}})
      give(gateway, attitudes(1, 1..10))
      assert {:error, %Error{reason: {:unavailable, "no ring is kept" <> _}}} = Recorder.save(gateway, @key)
      assert {:error, %Error{reason: {:unknown, :vehicle, "VID-009"}}} = Recorder.save(gateway, "VID-009")
      other = start_recorder(Path.join(c.tmp_dir, "other"))
      assert {:error, %Error{reason: {:unavailable, "nothing was heard" <> _}}} = Recorder.save(other, @key)

      assert {:error, %Error{reason: {:unavailable, "the recorder is not running"}}} =
               Recorder.save(make_ref(), @key)
    end
  end

  test "without a recorder, links and sessions do not notice" do
    gateway = make_ref()
    assert Recorder.link_frames(gateway, "radio", attitudes(1, 1..1)) == :ok
    assert Recorder.vehicle_frames(gateway, @key, attitudes(1, 1..1)) == :ok
    assert Recorder.sent(gateway, "radio", "main", "x") == :ok
    assert Recorder.status(gateway) == nil
    assert Enum.all?(Recorder.metrics(gateway), &(&1.samples == []))
    assert {:error, _} = Recorder.start(gateway, {:link, "radio"})
  end

  test "what is known of a recording goes with its link or vehicle", c do
    gateway = start_recorder(c.tmp_dir, %{links: :always, vehicles: :always})
    known = fn -> for %{target: target} <- Recorder.status(gateway).recordings, do: target end

    for n <- 1..20 do
      {id, _port} = add_link(gateway, "udpin:127.0.0.1:0", id: "radio-#{n}")
      eventually(fn -> {:link, id} in known.() end)
      :ok = MavRouter.Link.stop(gateway, id)
    end

    Store.put_vehicle(gateway, @key, %{id: "VID-001", key: @key, last_heard: 5})
    recording = eventually(fn -> Names.whereis(gateway, :recording, {:vehicle, @key}) end)
    eventually(fn -> known.() == [{:vehicle, @key}] end)
    # It ends, and is begun again, while the vehicle is there; afterwards nothing is left of it.
    Process.exit(recording, :kill)

    again =
      eventually(fn ->
        pid = Names.whereis(gateway, :recording, {:vehicle, @key})
        pid != recording && pid
      end)

    # It has its name before its queue.
    _ = :sys.get_state(again, Aerie.Patience.ms())
    assert known.() == [{:vehicle, @key}]
    # Frames for which the folder gave no file in time are dropped.
    file =
      eventually(fn ->
        give(gateway, attitudes(1, 1..10))
        Recording.flush(again)
      end)

    give(gateway, attitudes(1, 11..20))
    Store.delete_vehicle(gateway, @key)
    :ok = Recorder.forget(gateway, @key)
    eventually(fn -> known.() == [] end)
    assert Names.whereis(gateway, :recording, {:vehicle, @key}) == nil
    assert tlogs(c.tmp_dir) == [file]
    assert numbers(file) == Enum.to_list(1..20)
    assert [%{open: false}] = Recorder.list(gateway)
    assert Map.new(Recorder.metrics(gateway), &{&1.name, &1.samples})["gateway_recorder_frames_total"] == []
  end

  test "metrics tell what was written and what was lost", c do
    gateway = start_recorder(c.tmp_dir)
    recording = vehicle(gateway)
    give(gateway, attitudes(1, 1..10))
    Recording.flush(recording)
    metrics = Map.new(Recorder.metrics(gateway), &{&1.name, &1.samples})
    assert metrics["gateway_recorder_frames_total"] == [{[recording: "main-1"], 10}]
    assert metrics["gateway_recorder_dropped_total"] == [{[recording: "main-1"], 0}]
    assert metrics["gateway_recorder_active"] == [{[], 1}]
  end
end
