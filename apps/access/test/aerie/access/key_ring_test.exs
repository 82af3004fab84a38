defmodule Aerie.Access.KeyRingTest do
  use ExUnit.Case, async: true

  import Aerie.Patience, only: [eventually: 1]
  import ExUnit.CaptureLog

  alias Aerie.Access.{KeyRing, Keys}

  @moduletag :tmp_dir
  @policy %{keys: KeyRing.nobody(), origins: [], ports: [], hosts: []}

  defp start(dir, configured \\ []) do
    gateway = make_ref()
    options = [gateway: gateway, configured: configured, file: Path.join([dir, "console", "keys"])]
    start_supervised!({KeyRing, options})
    gateway
  end

  defp owner(gateway, text), do: Keys.check(KeyRing.admit(@policy, gateway).keys, text)

  test "keys outlive the gateway by their digests alone, beside the configured ones", %{tmp_dir: dir} do
    {:ok, configured} = Keys.load(%{key: Aerie.Base.Secret.new("a-configured-key-1"), keys_file: nil})
    gateway = start(dir, configured)
    {:ok, wall} = KeyRing.make(gateway, "wall", "viewer", "2099-12-31", "ann")
    {:ok, ops} = KeyRing.make(gateway, "ops", "operator", "", "ann")
    assert {:ok, %{name: "wall", role: :viewer}} = owner(gateway, wall)

    stop_supervised!(KeyRing)
    # Nobody is let in meanwhile, instead of everybody of this machine.
    eventually(fn -> KeyRing.admit(@policy, gateway).keys == KeyRing.nobody() end)
    assert owner(gateway, wall) == {:error, :unknown}

    gateway = start(dir, configured)
    assert {:ok, %{name: "ops", role: :operator}} = owner(gateway, ops)
    assert {:ok, %{name: "api.key"}} = owner(gateway, "a-configured-key-1")

    assert [%{name: "api.key", made: false}, %{name: "wall", made: true, until: until}, _ops] =
             KeyRing.list(gateway)

    assert is_integer(until)
    refute inspect(KeyRing.list(gateway)) =~ "digest"

    assert {:error, "there is a key ops already"} = KeyRing.make(gateway, "ops", "viewer", "", "ann")
    assert {:error, "api.key was not made here" <> _} = KeyRing.revoke(gateway, "api.key", "ann")
    assert :ok = KeyRing.revoke(gateway, "ops", "ann")
    assert owner(gateway, ops) == {:error, :unknown}
    text = File.read!(Path.join([dir, "console", "keys"]))
    assert text =~ ~r/^wall sha256:[0-9a-f]{64} role=viewer expires=2099-12-31$/m
    refute text =~ "ops"
  end

  test "a file that others can read lets nobody in; a damaged one does not either", %{tmp_dir: dir} do
    file = Path.join([dir, "console", "keys"])
    File.mkdir_p!(Path.dirname(file))
    options = [gateway: make_ref(), configured: [], file: file]
    Process.flag(:trap_exit, true)

    # An empty one, as a power cut leaves it, is not one without keys: then every program of this machine could get in.
    for text <- ["wall sha256:abc\n", ""] do
      File.write!(file, text)
      File.chmod!(file, 0o600)

      capture_log(fn ->
        assert {:ok, _pid} = KeyRing.start_link(Keyword.put(options, :gateway, make_ref()))
      end)

      # damaged_files_test.exs has the rest.
      assert File.read!(file) =~ "damaged"
    end

    assert {:ok, _pid} = KeyRing.start_link(options)
    assert [%{name: "damaged"}] = KeyRing.list(options[:gateway])
    File.chmod!(file, 0o644)
    options = [gateway: make_ref(), configured: [], file: file]
    capture_log(fn -> assert {:error, "" <> _mode} = KeyRing.start_link(options) end)
  end

  test "a change that cannot be written does not hold", %{tmp_dir: dir} do
    gateway = start(dir)
    File.write!(Path.join(dir, "console"), "a file in its place")
    assert {:error, text} = KeyRing.make(gateway, "wall", "viewer", "", "ann")
    assert text =~ "console/keys"
    assert KeyRing.list(gateway) == []
    assert {:error, _gone} = KeyRing.make(make_ref(), "wall", "viewer", "", "ann")
  end
end
