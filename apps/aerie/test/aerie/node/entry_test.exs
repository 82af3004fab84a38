defmodule Aerie.Node.EntryTest do
  use ExUnit.Case, async: true

  import Bitwise

  alias Aerie.Node.Entry
  alias Aerie.CLI.Gateway

  @moduletag :tmp_dir

  defp entry(name, pid, started \\ "2026-01-01T00:00:00Z"),
    do: %{name: name, port: 4000, pid: pid, started: started, http: "http://127.0.0.1:4000", config: nil}

  test "a gateway that runs is found, what a killed one left is removed, damaged files are ignored", %{
    tmp_dir: dir
  } do
    me = String.to_integer(System.pid())
    :ok = Entry.write(dir, entry("aerie-2", me, "2026-01-02T00:00:00Z"))
    :ok = Entry.write(dir, entry("aerie-1", me))
    # No process has the highest id that Linux can give.
    :ok = Entry.write(dir, entry("aerie-4194305", 4_194_305))
    File.write!(Path.join(dir, "aerie-3.gateway"), ~s({"name": "aerie-3", "port": 99999}))
    File.write!(Path.join(dir, "aerie-4.gateway"), String.duplicate("x", 10_000))
    # Its name is longer than any that a gateway makes.
    :ok = Entry.write(dir, entry("aerie-" <> String.duplicate("7", 59), me))
    # A file that says it is another one's.
    File.cp!(Path.join(dir, "aerie-1.gateway"), Path.join(dir, "aerie-5.gateway"))

    assert {:ok, [%{name: "aerie-1"}, %{name: "aerie-2", http: "http://127.0.0.1:4000"}]} = Entry.list(dir)
    refute File.exists?(Path.join(dir, "aerie-4194305.gateway"))
    assert {:error, :enoent} = Entry.list(Path.join(dir, "none"))
  end

  test "the cookie is made once, and only its owner reads it and the folder", %{tmp_dir: dir} do
    dir = Path.join(dir, "shell")
    assert {:ok, cookie} = Entry.cookie(dir)
    assert {:ok, ^cookie} = Entry.cookie(dir)
    assert {:ok, ^cookie} = Entry.read_cookie(Path.join(dir, "cookie"))
    assert cookie |> Atom.to_string() |> byte_size() == 32
    assert (File.stat!(Path.join(dir, "cookie")).mode &&& 0o777) == 0o600
    assert (File.stat!(dir).mode &&& 0o777) == 0o700
  end

  test "of several gateways one must be named" do
    one = entry("aerie-1", 1)
    two = %{entry("aerie-2", 2) | config: "/etc/hub.yaml"}
    assert {3, "no gateway is running" <> _} = Gateway.choose([], nil, "var/shell")
    assert {:ok, ^one} = Gateway.choose([one], nil, "")
    assert {:ok, ^two} = Gateway.choose([one, two], "aerie-2", "")
    assert {:error, text} = Gateway.choose([one, two], nil, "")
    assert text =~ "--gateway aerie-1" and text =~ "/etc/hub.yaml"
    assert {:error, "no gateway aerie-3 is running" <> _} = Gateway.choose([one], "aerie-3", "")
  end
end
