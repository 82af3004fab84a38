defmodule Aerie.Base.Files.RawTest do
  use ExUnit.Case, async: true
  alias Aerie.Base.Files.Raw

  @moduletag :tmp_dir

  test "the results are those of File", %{tmp_dir: dir} do
    file = Path.join(dir, "grüße")
    assert Raw.append(file, ["a", "b"]) == :ok
    assert Raw.append(file, "c") == :ok
    assert Raw.chmod(file, 0o640) == :ok
    File.ln_s!(file, link = Path.join(dir, "link"))
    none = Path.join(dir, "none")
    below = Path.join(file, "below")

    for path <- [dir, file, link, none, below] do
      assert Raw.stat(path) == File.stat(path, time: :posix)
      assert Raw.lstat(path) == File.lstat(path, time: :posix)
      assert Raw.read(path) == File.read(path)
      assert Raw.read_link(path) == File.read_link(path)
      assert Raw.exists?(path) == File.exists?(path)
      assert Raw.dir?(path) == File.dir?(path)
      assert names(Raw.ls(path)) == names(File.ls(path))
    end

    assert Raw.read(file) == {:ok, "abc"}
    assert File.stat!(file).mode |> Bitwise.band(0o777) == 0o640
    assert Raw.chmod(none, 0o600) == {:error, :enoent}
    assert Raw.append(dir, "a") == {:error, :eisdir}
    assert Raw.rename(file, moved = Path.join(dir, "moved")) == :ok
    assert Raw.rename(file, moved) == {:error, :enoent}
    assert Raw.rm(moved) == :ok
    assert Raw.rm(moved) == {:error, :enoent}
  end

  defp names({:ok, names}), do: Enum.sort(names)
  defp names(error), do: error

  test "a folder is made with those above it", %{tmp_dir: dir} do
    deep = Path.join(dir, "a/b/c")
    assert Raw.mkdir_p(deep) == :ok
    assert Raw.mkdir_p(deep) == :ok
    assert File.dir?(deep)
    File.write!(file = Path.join(dir, "file"), "")
    assert Raw.mkdir_p(file) == File.mkdir_p(file)
    assert Raw.mkdir_p(Path.join(file, "a/b")) == File.mkdir_p(Path.join(file, "a/b"))
    assert Raw.mkdir_p("") == {:error, :enoent}
  end
end
