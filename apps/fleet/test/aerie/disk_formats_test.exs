defmodule Aerie.DiskFormatsTest do
  @moduledoc """
  A gateway goes on with what an earlier version kept on the disk. `test/fixtures/disk/vN` was made by that version (`make.exs`
  there): a change of a format makes a new folder and leaves the old ones, which still have to be read.
  """
  use ExUnit.Case, async: true

  alias Aerie.Fleet.Bridge.Events.Outbox
  alias Aerie.Fleet.Bridge.State.LastPublished
  alias Aerie.Base.Secret
  alias Aerie.Control.Ledger
  alias Aerie.Vehicle.Command
  alias Aerie.Control.Params.Cache
  alias Aerie.Control.Policy.Audit
  alias Aerie.Fleet.Shadow.Document
  alias Aerie.Fleet.Shadow.Document.Sealed
  alias Aerie.Fleet.Shadow.Store.LocalStore
  alias Aerie.Fleet.Shadow.Keys
  alias Aerie.Base.Store
  alias Aerie.Fleet.{Operations, Tracks}

  @moduletag :tmp_dir
  @fixtures Path.expand("../fixtures/disk", __DIR__)

  # Git keeps no modes.
  defp copy(version, tmp_dir) do
    dir = Path.join(tmp_dir, version)
    File.cp_r!(Path.join(@fixtures, version), dir)
    dir
  end

  for path <- Path.wildcard(Path.join(@fixtures, "v*")), version = Path.basename(path) do
    describe version do
      @describetag version: version

      test "the outbox: what was not confirmed is sent again", %{tmp_dir: dir, version: version} do
        {:ok, outbox} =
          Outbox.open(Path.join(copy(version, dir), "outbox"), max_bytes: 1_048_576, segment_bytes: 65_536)

        {records, outbox} = Outbox.read(outbox, 10)
        assert for({_seq, record} <- records, do: record.id) == ["event-2", "event-3"]
        assert [{_, %{subject: "fleet.test.VID-001.event.armed", body: ~s({"seq":2})}} | _] = records
        assert Outbox.stats(outbox).damaged == 0
        Outbox.close(outbox)
      end

      test "what was published last", %{tmp_dir: dir, version: version} do
        kept = LastPublished.File.read(Path.join(copy(version, dir), "outbox/last/vehicles.json"))
        assert %{epoch: 7, ended: true, vehicles: %{"VID-001" => %{mode: "GUIDED", armed: true}}} = kept
      end

      test "the ledger: nothing is done twice, nothing that was not done is lost", %{
        tmp_dir: dir,
        version: version
      } do
        gateway = make_ref()
        folder = Path.join(copy(version, dir), "ledger")
        assert Ledger.Journal.check(folder) == :ok
        options = [gateway: gateway, dir: folder, max_entries: 1000, max_age_s: 1_000_000_000]
        start_supervised!({Ledger, options})

        known = fn id ->
          {:ok, command} = Command.new(id: id, vehicle: "VID-001", type: "arm")
          Ledger.admit(gateway, command)
        end

        assert {:stored, %{status: :completed}} = known.("done")
        assert {:stored, %{status: :unknown}} = known.("sent")
        assert :new = known.("admitted")
      end

      test "the audit log: it goes on, and the chain holds", %{tmp_dir: dir, version: version} do
        folder = Path.join(copy(version, dir), "audit")
        {:ok, %{first: first, last: last, problems: []}} = Audit.Verify.folder(folder)
        assert first == 1
        {:ok, log} = Audit.Log.open(folder, 131_072, 1_795_339_800_000_000)
        assert {n, _hash} = Audit.Log.head(log)
        assert n == last + 1
        Audit.Log.close(log)
        assert {:ok, %{first: ^first, last: ^n, problems: [], notes: []}} = Audit.Verify.folder(folder)
      end

      test "lists of parameters", %{tmp_dir: dir, version: version} do
        assert {:ok, table} = Cache.load(Path.join(copy(version, dir), "params"), {:uid, "ab12"})
        assert %{hash: 77, params: %{"A" => %{value: 5, default: 3}, "B" => %{value: 0.5}}} = table
      end

      test "tracks: each sample is read as it was written", %{tmp_dir: dir, version: version} do
        gateway = tracks_gateway()
        folder = Path.join(copy(version, dir), "tracks")
        assert {:ok, files, 0} = Tracks.Files.open(gateway, folder, max_bytes: 1_048_576, keep_ms: 86_400_000)
        Tracks.Metrics.status(gateway, %{dir: folder, bytes: Tracks.Files.bytes(files), problem: nil})
        first = 1_795_213_200_000_000

        assert {:ok, %{next: nil, since: ^first, vehicles: %{"VID-001" => flying, "VID-002" => lost}}} =
                 Tracks.Reader.read(gateway, :all, first, first + 7_200_000_000, 1)

        assert for(sample <- flying, do: div(sample.at - first, 1000)) == [0, 1_000, 2_000, 3_600_000]

        assert %{lat: 47.39770, lon: 8.5456, height: 20.0, heading: 90, speed: 3.5, age: 0, battery: 0.8} =
                 hd(flying)

        assert %{mode: "GUIDED", armed: true, in_air: true, status: :online, lat: 47.7577} = List.last(flying)

        assert %{battery: nil, height: nil, lon: -8.5456, age: 300, status: :lost, mode: "AUTO_LOITER"} =
                 hd(lost)

        Tracks.Files.close(files)
      end

      test "operations: vehicles that had begun are interrupted, the others wait", %{
        tmp_dir: dir,
        version: version
      } do
        folder = Path.join(copy(version, dir), "operations")

        assert {:ok, [%{id: "up-1", source: %{name: "ann"}} = entry]} =
                 Operations.Journal.load(make_ref(), folder)

        assert %{state: :interrupted, waiting: ["VID-003"], results: results} = entry.core
        assert %{"VID-001" => %{verdict: :ok}, "VID-002" => %{verdict: :failed}} = results

        assert {:sequence, [_one, _two, %{steps: [_arm, {:command, "takeoff", _height}]}]} =
                 entry.request.what
      end

      test "desired states and the key that seals them", %{tmp_dir: dir, version: version} do
        shadow = Path.join(copy(version, dir), "shadow")
        assert {:ok, %{key: key}} = LocalStore.open(make_ref(), shadow, nil)
        assert Secret.reveal(key) == File.read!(Path.join([@fixtures, version, "shadow", "key"]))
        text = LocalStore.read(shadow, "VID-001")

        keys = %Keys{common: key}

        # Sealed before each vehicle had a key of its own.
        assert {:former, %Document{version: 1, fields: %{"mode" => %{value: "GUIDED", actor: "ops"}}}} =
                 Sealed.decode(text, "test", "VID-001", keys)
      end
    end
  end

  defp tracks_gateway do
    gateway = make_ref()

    start_supervised!(
      Supervisor.child_spec({Store, gateway: gateway, tables: [Tracks.Files.table()]}, id: gateway)
    )

    gateway
  end

  describe "stores that a kill or a bad disk has left" do
    test "the outbox: what can be read is sent, and it goes on behind it", %{tmp_dir: dir} do
      folder = Path.join(copy("cut", dir), "outbox")
      {:ok, outbox} = Outbox.open(folder, max_bytes: 1_048_576, segment_bytes: 200)
      assert %{events: 5, segments: 3, damaged: 1, dropped: 0} = Outbox.stats(outbox)
      record = %Outbox.Record{id: "new", vehicle: "V", subject: "s", body: "b"}
      {:ok, outbox} = Outbox.append(outbox, [record])
      {records, outbox} = Outbox.read(outbox, 20)

      assert for({seq, record} <- records, do: {seq, record.id}) == [
               {2, "event-2"},
               {3, "event-3"},
               {4, "event-4"},
               {5, "event-5"},
               {9, "event-9"},
               {10, "new"}
             ]

      assert Outbox.empty?(Outbox.ack(outbox, for({seq, _record} <- records, do: seq)))
      assert Path.wildcard(folder <> "/*.log") == []
    end

    test "the ledger: a damaged end is unknown, and what was never admitted may come again", %{tmp_dir: dir} do
      gateway = make_ref()
      folder = Path.join(copy("cut", dir), "ledger")
      options = [gateway: gateway, dir: folder, max_entries: 1000, max_age_s: 1_000_000_000]
      start_supervised!({Ledger, options})
      assert %{status: :completed} = Ledger.lookup(gateway, "done")
      assert %{status: :unknown} = Ledger.lookup(gateway, "damaged")
      assert Ledger.lookup(gateway, "cut") == nil
      assert %{damaged: 1} = Ledger.status(gateway)
      assert File.exists?(Path.join(folder, "ledger.damaged"))
    end

    test "the audit log: the line is set aside in a record", %{tmp_dir: dir} do
      folder = Path.join(copy("cut", dir), "audit")
      {:ok, log} = Audit.Log.open(folder, 1_048_576, 1_795_339_800_000_000)
      assert {6, _hash} = Audit.Log.head(log)
      Audit.Log.close(log)
      assert {:ok, %{problems: [missing], notes: [note]}} = Audit.Verify.folder(folder)
      assert missing =~ "the log had been shortened; it had reached record 4"
      assert note =~ "record 4: a line of 179 bytes was torn and set aside"
    end
  end

  test "what a newer version wrote is refused with what to do, and is left alone", %{tmp_dir: tmp_dir} do
    dir = copy("v1", tmp_dir)
    outbox = Path.join(dir, "outbox")
    File.write!(Path.join(outbox, "FORMAT"), "aerie-outbox 2\n")
    files = File.ls!(outbox)
    assert {:error, text} = Outbox.open(outbox, max_bytes: 1_048_576, segment_bytes: 65_536)
    assert text =~ outbox and text =~ "newer version"
    assert File.ls!(outbox) == files

    File.write!(Path.join(dir, "shadow/FORMAT"), "aerie-shadow 2\n")
    assert {:error, text} = LocalStore.open(make_ref(), Path.join(dir, "shadow"), nil)
    assert text =~ "newer version"

    tracks = Path.join(dir, "tracks")
    File.write!(Path.join(tracks, "FORMAT"), "aerie-tracks 2\n")
    files = File.ls!(tracks)
    limits = [max_bytes: 1_048_576, keep_ms: 86_400_000]
    assert {:error, text} = Tracks.Files.open(tracks_gateway(), tracks, limits)
    assert text =~ tracks and text =~ "newer version"
    assert File.ls!(tracks) == files

    ledger = Path.join(dir, "ledger")
    file = Path.join(ledger, "ledger")
    newer = String.replace(File.read!(file), ~r/\Aaerie-ledger 1\n/, "aerie-ledger 2\n")
    File.write!(file, newer)
    assert {:error, text} = Ledger.Journal.check(ledger)
    assert text =~ "newer version"
    assert {:error, ^text} = Ledger.Journal.open(ledger, [], fn record, acc -> [record | acc] end)
    assert File.read!(file) == newer
  end
end
