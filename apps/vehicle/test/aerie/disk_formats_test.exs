defmodule Aerie.DiskFormatsTest do
  @moduledoc """
  A gateway goes on with what an earlier version kept on the disk. `test/fixtures/disk/vN` was made by that version (`make.exs`
  there): a change of a format makes a new folder and leaves the old ones, which still have to be read.
  """
  use ExUnit.Case, async: true

  alias Aerie.Bridge.{LastPublished, Outbox}
  alias Aerie.{Command, Ledger, Secret}
  alias Aerie.Params.Cache
  alias Aerie.Shadow.{Copy, Document, Keys, SealedDocument}

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

      test "lists of parameters", %{tmp_dir: dir, version: version} do
        assert {:ok, table} = Cache.load(Path.join(copy(version, dir), "params"), {:uid, "ab12"})
        assert %{hash: 77, params: %{"A" => %{value: 5, default: 3}, "B" => %{value: 0.5}}} = table
      end

      test "desired states and the key that seals them", %{tmp_dir: dir, version: version} do
        shadow = Path.join(copy(version, dir), "shadow")
        assert {:ok, %{key: key}} = Copy.open(shadow, nil)
        assert Secret.reveal(key) == File.read!(Path.join([@fixtures, version, "shadow", "key"]))
        text = Copy.read(shadow, "VID-001")

        keys = %Keys{common: key}

        # Sealed before each vehicle had a key of its own.
        assert {:former, %Document{version: 1, fields: %{"mode" => %{value: "GUIDED", actor: "ops"}}}} =
                 SealedDocument.decode(text, "test", "VID-001", keys)
      end
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
    assert {:error, text} = Copy.open(Path.join(dir, "shadow"), nil)
    assert text =~ "newer version"

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
