defmodule Aerie.Base.Files.DamagedTest do
  use ExUnit.Case, async: true

  import ExUnit.CaptureLog

  alias Aerie.Base.Files.{Damaged, Disk}
  alias Aerie.Base.Store

  @moduletag :tmp_dir

  test "a file is set aside under a name of its own, logged, and listed", %{tmp_dir: dir} do
    gateway = make_ref()
    start_supervised!({Store, gateway: gateway})
    path = Path.join(dir, "leases.json")

    log =
      capture_log(fn ->
        for n <- 1..2 do
          File.write!(path, "broken #{n}")
          assert {:ok, kept} = Damaged.set_aside(gateway, path, "nobody is in charge")
          assert File.read!(kept) == "broken #{n}"
          refute File.exists?(path)
        end
      end)

    assert log =~ "#{path} is damaged and was kept as #{path}.damaged-"
    assert [%{path: ^path, words: "nobody is in charge"}] = Damaged.list(gateway)
    # Neither took the other's name.
    assert [_, _] = Path.wildcard(path <> ".damaged-*")
  end

  test "without a store the log has it; a file that is gone is an error", %{tmp_dir: dir} do
    path = Path.join(dir, "a.json")

    assert capture_log(fn -> assert Damaged.note(make_ref(), path, path, "lost") == :ok end) =~
             "#{path} is damaged: lost"

    assert Damaged.set_aside(make_ref(), path, "lost") == {:error, :enoent}
  end

  test "a file that others can read is not damaged: its owner decides", %{tmp_dir: dir} do
    path = Path.join(dir, "key")
    File.write!(path, "x")
    File.chmod!(path, 0o600)
    assert Damaged.damaged?(path)
    File.chmod!(path, 0o640)
    refute Damaged.damaged?(path)
    refute Damaged.damaged?(path <> ".none")
    # A folder in the place of a file cannot be read as one.
    assert Damaged.damaged?(dir)
  end

  test "the disk of a folder has free space, and a file can be synced to it", %{tmp_dir: dir} do
    assert {:ok, free} = Disk.free(dir)
    assert free > 0
    assert Disk.free(Path.join(dir, "none")) == :unknown
    path = Path.join(dir, "data")
    File.write!(path, "x")
    assert Disk.sync(path) == :ok
    assert Disk.sync(path <> ".none") == {:error, :enoent}
  end
end
