defmodule Aerie.Access.KeysTest do
  use ExUnit.Case, async: true

  alias Aerie.Access.Keys
  alias Aerie.Base.{Principal, Secret}

  @moduletag :tmp_dir

  defp file(dir, text, mode \\ 0o600) do
    path = Path.join(dir, "keys")
    File.write!(path, text)
    File.chmod!(path, mode)
    path
  end

  defp name(keys, presented) do
    {:ok, %Principal{kind: :key, name: name, role: nil, permissions: []}} = Keys.check(keys, presented)
    name
  end

  test "a key may have a role, permissions and a last day, and be in the file by its digest only", %{
    tmp_dir: dir
  } do
    digest = :sha256 |> :crypto.hash("victor's secret key") |> Base.encode16(case: :lower)

    path =
      file(dir, """
      olga 0123456789abcdef role=operator permissions=force_disarm,terminate expires=2026-11-22 # for a day
      victor sha256:#{digest} role=viewer
      """)

    {:ok, keys} = Keys.load(%{key: nil, keys_file: path})
    at = fn time -> DateTime.to_unix(time, :microsecond) end

    assert {:ok, %{name: "olga", role: :operator, permissions: [:force_disarm, :terminate]}} =
             Keys.check(keys, "0123456789abcdef", at.(~U[2026-11-22 23:59:59Z]))

    assert Keys.check(keys, "0123456789abcdef", at.(~U[2026-11-23 00:00:00Z])) ==
             {:error, {:expired, ~D[2026-11-22]}}

    assert {:ok, %{name: "victor", role: :viewer, may: []}} = Keys.check(keys, "victor's secret key")
    assert Keys.check(keys, "sha256:" <> digest) == {:error, :unknown}

    for {fields, words} <- [
          {"role=boss", "role= expects viewer, operator, pilot, admin"},
          {"permissions=fly,all", "permissions= expects"},
          {"expires=soon", "expires= expects a day"},
          {"colour=red", "expected KEY, NAME KEY"},
          {"more", "expected KEY, NAME KEY"}
        ] do
      assert {:error, text} =
               Keys.load(%{key: nil, keys_file: file(dir, "olga 0123456789abcdef #{fields}\n")})

      assert text =~ "line 1: #{words}"
    end

    assert {:error, text} = Keys.load(%{key: nil, keys_file: file(dir, "olga sha256:abc\n")})
    assert text =~ "64 hexadecimal digits"
  end

  test "keys of the configuration and of the file let in under their names", %{tmp_dir: dir} do
    path = file(dir, "# keys\nalice 0123456789abcdef\n\nfedcba9876543210fed # no name\n")
    {:ok, keys} = Keys.load(%{key: Secret.new("a-long-enough-key"), keys_file: path})
    assert name(keys, "a-long-enough-key") == "api.key"
    assert name(keys, "0123456789abcdef") == "alice"
    assert name(keys, "fedcba9876543210fed") == "line 4"

    for wrong <- ["", "0123456789abcde", "0123456789abcdef ", "alice", nil, String.duplicate("x", 100_000)],
        do: assert(Keys.check(keys, wrong) == {:error, :unknown})
  end

  test "no key stays readable in memory", %{tmp_dir: dir} do
    {:ok, keys} = Keys.load(%{key: nil, keys_file: file(dir, "alice 0123456789abcdef\n")})
    refute inspect(keys, limit: :infinity) =~ "0123456789abcdef"
  end

  test "without keys nothing is let in" do
    assert Keys.load(%{key: nil, keys_file: nil}) == {:ok, []}
    assert Keys.check([], "anything-at-all-here") == {:error, :unknown}
  end

  test "a file that others can read is refused, with what to do about it", %{tmp_dir: dir} do
    for mode <- [0o644, 0o640, 0o604, 0o620] do
      assert {:error, text} = Keys.load(%{key: nil, keys_file: file(dir, "k 0123456789abcdef\n", mode)})
      assert text =~ "chmod 600"
    end
  end

  test "an error names the number of a wrong line, and never shows the line", %{tmp_dir: dir} do
    for line <- ["short-key", "a b c0123456789abcdef", String.duplicate("k", 600)] do
      assert {:error, text} = Keys.load(%{key: nil, keys_file: file(dir, "# x\n#{line}\n")})
      assert text =~ "line 2"
      refute text =~ "c0123456789abcdef"
      refute text =~ "short-key"
    end

    assert {:error, _text} = Keys.load(%{key: nil, keys_file: Path.join(dir, "absent")})
    assert {:error, _text} = Keys.load(%{key: nil, keys_file: dir})
  end
end
