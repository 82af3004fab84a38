defmodule Aerie.Base.Files.FolderLockTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.Files.FolderLock

  @moduletag :tmp_dir

  defp owner(dir), do: Path.join(dir, "owner")

  test "one owner within this program, until it ends", %{tmp_dir: dir} do
    assert FolderLock.acquire(dir) == :ok
    assert FolderLock.acquire(dir) == :ok
    assert {:error, text} = Task.await(Task.async(fn -> FolderLock.acquire(dir) end), Aerie.Patience.ms())
    assert text =~ "is in use by another gateway in this program"

    other = Path.join(dir, "other")
    assert Task.await(Task.async(fn -> FolderLock.acquire(other) end), Aerie.Patience.ms()) == :ok
    Aerie.Patience.eventually(fn -> FolderLock.acquire(other) == :ok end)
  end

  test "a live process keeps its folder; one that is gone, or whose pid another process got, does not", %{
    tmp_dir: dir
  } do
    port = Port.open({:spawn_executable, System.find_executable("cat")}, [])
    {:os_pid, pid} = Port.info(port, :os_pid)
    started = FolderLock.start_time("#{pid}")
    assert started != ""

    File.write!(owner(dir), "#{pid} #{started}\n")
    assert {:error, text} = FolderLock.acquire(dir)
    assert text =~ "is in use by another gateway (process #{pid})"

    File.write!(owner(dir), "#{pid} #{started}1\n")
    assert FolderLock.acquire(dir) == :ok
    assert File.read!(owner(dir)) =~ System.pid()
    Port.close(port)

    for text <- ["", "no process", "99999999 5"] do
      File.write!(owner(dir), text)
      assert FolderLock.acquire(dir) == :ok
    end

    assert FolderLock.start_time("1; rm") == ""
  end

  test "a folder that cannot be made or written is an error that says why", %{tmp_dir: dir} do
    file = Path.join(dir, "file")
    File.write!(file, "")
    assert {:error, "cannot make folder " <> _} = FolderLock.acquire(Path.join(file, "below"))
    File.mkdir_p!(owner(Path.join(dir, "taken")))
    assert {:error, "cannot write into folder " <> _} = FolderLock.acquire(Path.join(dir, "taken"))
  end
end
