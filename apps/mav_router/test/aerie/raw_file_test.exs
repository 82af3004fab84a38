defmodule Aerie.RawFileTest do
  use ExUnit.Case, async: true
  alias Aerie.RawFile

  @moduletag :tmp_dir

  test "the results are those of File", %{tmp_dir: dir} do
    file = Path.join(dir, "grüße")
    assert RawFile.append(file, ["a", "b"]) == :ok
    assert RawFile.append(file, "c") == :ok
    assert RawFile.chmod(file, 0o640) == :ok
    File.ln_s!(file, link = Path.join(dir, "link"))
    none = Path.join(dir, "none")
    below = Path.join(file, "below")

    for path <- [dir, file, link, none, below] do
      assert RawFile.stat(path) == File.stat(path, time: :posix)
      assert RawFile.lstat(path) == File.lstat(path, time: :posix)
      assert RawFile.read(path) == File.read(path)
      assert RawFile.read_link(path) == File.read_link(path)
      assert RawFile.exists?(path) == File.exists?(path)
      assert RawFile.dir?(path) == File.dir?(path)
      assert names(RawFile.ls(path)) == names(File.ls(path))
    end

    assert RawFile.read(file) == {:ok, "abc"}
    assert File.stat!(file).mode |> Bitwise.band(0o777) == 0o640
    assert RawFile.chmod(none, 0o600) == {:error, :enoent}
    assert RawFile.append(dir, "a") == {:error, :eisdir}
    assert RawFile.rename(file, moved = Path.join(dir, "moved")) == :ok
    assert RawFile.rename(file, moved) == {:error, :enoent}
    assert RawFile.rm(moved) == :ok
    assert RawFile.rm(moved) == {:error, :enoent}
  end

  defp names({:ok, names}), do: Enum.sort(names)
  defp names(error), do: error

  test "a folder is made with those above it", %{tmp_dir: dir} do
    deep = Path.join(dir, "a/b/c")
    assert RawFile.mkdir_p(deep) == :ok
    assert RawFile.mkdir_p(deep) == :ok
    assert File.dir?(deep)
    File.write!(file = Path.join(dir, "file"), "")
    assert RawFile.mkdir_p(file) == File.mkdir_p(file)
    assert RawFile.mkdir_p(Path.join(file, "a/b")) == File.mkdir_p(Path.join(file, "a/b"))
    assert RawFile.mkdir_p("") == {:error, :enoent}
  end
end
