defmodule Aerie.Access.DamagedFilesTest do
  @moduledoc "A damaged file is set aside and named, its process starts, and nobody gets in who did not before."
  use ExUnit.Case, async: true

  import ExUnit.CaptureLog

  alias Aerie.Access.{KeyRing, Keys, Session, Users}

  @moduletag :tmp_dir
  @garbage [<<0, 255, 1>>, "", "{", String.duplicate("x", 70_000)]

  defp file(dir, name, text) do
    path = Path.join(dir, name)
    File.write!(path, text)
    File.chmod!(path, 0o600)
    path
  end

  defp kept(path), do: Path.wildcard(path <> ".damaged-*")

  test "users: nobody can sign in by name, and the address stays closed to others", %{tmp_dir: dir} do
    for garbage <- @garbage do
      path = file(dir, "users.json", garbage)
      assert Users.any?(dir)
      gateway = make_ref()
      log = capture_log(fn -> start_supervised!({Users, gateway: gateway, file: path}) end)
      assert log =~ "#{path} is damaged and was kept as #{path}.damaged-"
      assert Users.list(gateway) == []
      stop_supervised!(Users)
      refute File.exists?(path)
      assert Users.any?(dir)
    end

    assert length(kept(path = Path.join(dir, "users.json"))) == length(@garbage)
    # One that others can read is not damaged.
    File.chmod!(file(dir, "users.json", "{"), 0o644)
    assert {:error, _text} = capture_exit(fn -> Users.start_link(gateway: make_ref(), file: path) end)
  end

  defp capture_exit(fun) do
    Process.flag(:trap_exit, true)
    fun.()
  end

  test "keys: none of those that were made opens anything, also after restarts", %{tmp_dir: dir} do
    path = file(dir, "keys", <<0, 255, 1>>)
    policy = %{keys: [], origins: [], ports: [], hosts: []}

    for _start <- 1..2 do
      gateway = make_ref()
      capture_log(fn -> start_supervised!({KeyRing, gateway: gateway, configured: [], file: path}) end)
      assert [_nobodys] = keys = KeyRing.admit(policy, gateway).keys

      for text <- ["", "damaged", String.duplicate("0", 64)],
          do: assert({:error, :unknown} = Keys.check(keys, text))

      assert [%{name: "damaged", role: nil, made: true}] = KeyRing.list(gateway)
      stop_supervised!(KeyRing)
    end

    assert [_one] = kept(path)
  end

  test "the secret: everybody signs in again", %{tmp_dir: dir} do
    path = file(dir, "secret", "short")

    assert capture_log(fn -> assert {:ok, <<_::256>>} = Session.secret(make_ref(), dir) end) =~
             "sign in again"

    assert [_one] = kept(path)
    assert {:ok, secret} = Session.secret(make_ref(), dir)
    assert File.read!(path) == secret
  end
end
