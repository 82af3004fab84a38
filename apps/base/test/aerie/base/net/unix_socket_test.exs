defmodule Aerie.Base.Net.UnixSocketTest do
  use ExUnit.Case, async: true

  import Bitwise

  alias Aerie.Base.Net.UnixSocket
  alias Aerie.ShortDir

  defp mode(path), do: File.stat!(path).mode &&& 0o777

  test "the default folder: the session's, that of a service, or beside the other files" do
    assert UnixSocket.default_dir(%{"XDG_RUNTIME_DIR" => "/run/user/7"}, fn _dir -> true end) ==
             "/run/user/7/aerie"

    assert UnixSocket.default_dir(%{"XDG_RUNTIME_DIR" => "relative"}, fn _dir -> true end) == "/run/aerie"
    assert UnixSocket.default_dir(%{}, &(&1 == "/run")) == "/run/aerie"
    assert UnixSocket.default_dir(%{}, &(&1 == "/run/aerie")) == "/run/aerie"
    # An ordinary user's gateway, without a session of its own: a container, `su`.
    assert UnixSocket.default_dir(%{}, fn _dir -> false end) == "var/run"
    assert UnixSocket.dir("a") == Path.expand("a")
  end

  test "its folder is made for its owner only, and the socket is open to its group" do
    dir = Path.join(ShortDir.new(), "run")
    path = Path.join(dir, "state.sock")
    assert {:ok, socket, identity} = UnixSocket.listen(path)
    assert {mode(dir), mode(path)} == {0o700, 0o660}
    # Nothing is left of where it was bound.
    assert File.ls!(dir) == ["state.sock"]
    assert {:ok, client} = :gen_tcp.connect({:local, path}, 0, [:binary])
    :gen_tcp.close(client)
    assert UnixSocket.present?(path, identity)
    :gen_tcp.close(socket)
    UnixSocket.remove(path, identity)
    refute File.exists?(path)
  end

  test "one left behind is replaced, one that is served is not, a file is never touched" do
    path = Path.join(ShortDir.new(), "state.sock")
    {:ok, socket, first} = UnixSocket.listen(path)
    assert {:error, words} = UnixSocket.listen(path)
    assert words == "#{path} is served by another program"
    :gen_tcp.close(socket)
    assert {:ok, socket, second} = UnixSocket.listen(path)
    # The file of another one stays.
    UnixSocket.remove(path, first)
    assert UnixSocket.present?(path, second)
    :gen_tcp.close(socket)

    File.rm!(path)
    File.write!(path, "a text")
    assert UnixSocket.listen(path) == {:error, "#{path} is there and is not a socket"}
    UnixSocket.remove(path, second)
    assert File.read!(path) == "a text"
    refute UnixSocket.present?(path, second)

    # A file system gives a new file the inode of one that was removed.
    %File.Stat{major_device: device, inode: inode, mtime: made} = File.lstat!(path, time: :posix)
    UnixSocket.remove(path, {device, inode, made})
    assert File.read!(path) == "a text"
    {_device, _inode, was} = second
    File.rm!(path)
    {:ok, socket, {device, inode, made}} = UnixSocket.listen(path)
    assert made >= was
    UnixSocket.remove(path, {device, inode, made - 1})
    assert UnixSocket.present?(path, {device, inode, made})
    :gen_tcp.close(socket)
  end

  test "a place that cannot be used is named with the reason" do
    dir = ShortDir.new()
    long = Path.join(dir, String.duplicate("x", 100))
    assert {:error, words} = UnixSocket.listen(Path.join(long, "state.sock"))
    assert words =~ "the name is too long" and words =~ long
    file = Path.join(dir, "file")
    File.write!(file, "")
    assert {:error, words} = UnixSocket.listen(Path.join(file, "state.sock"))
    assert words =~ file
  end
end
