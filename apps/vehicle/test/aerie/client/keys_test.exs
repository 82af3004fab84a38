defmodule Aerie.Client.KeysTest do
  use ExUnit.Case, async: true

  alias Aerie.Client.Keys
  alias Aerie.Secret

  @moduletag :tmp_dir

  defp file(dir, text, mode \\ 0o600) do
    path = Path.join(dir, "keys")
    File.write!(path, text)
    File.chmod!(path, mode)
    path
  end

  test "keys of the configuration and of the file let in under their names", %{tmp_dir: dir} do
    path = file(dir, "# keys\nalice 0123456789abcdef\n\nfedcba9876543210fed # no name\n")
    {:ok, keys} = Keys.load(%{key: Secret.new("a-long-enough-key"), keys_file: path})
    assert Keys.check(keys, "a-long-enough-key") == {:ok, "api.key"}
    assert Keys.check(keys, "0123456789abcdef") == {:ok, "alice"}
    assert Keys.check(keys, "fedcba9876543210fed") == {:ok, "line 4"}

    for wrong <- ["", "0123456789abcde", "0123456789abcdef ", "alice", nil, String.duplicate("x", 100_000)],
        do: assert(Keys.check(keys, wrong) == :error)
  end

  test "no key stays readable in memory", %{tmp_dir: dir} do
    {:ok, keys} = Keys.load(%{key: nil, keys_file: file(dir, "alice 0123456789abcdef\n")})
    refute inspect(keys, limit: :infinity) =~ "0123456789abcdef"
  end

  test "without keys nothing is let in" do
    assert Keys.load(%{key: nil, keys_file: nil}) == {:ok, []}
    assert Keys.check([], "anything-at-all-here") == :error
  end

  test "a file that others can read is refused, with what to do about it", %{tmp_dir: dir} do
    for mode <- [0o644, 0o640, 0o604, 0o620] do
      assert {:error, text} = Keys.load(%{key: nil, keys_file: file(dir, "k 0123456789abcdef\n", mode)})
      assert text =~ "chmod 600"
    end
  end

  test "a wrong line is told by its number and never shown", %{tmp_dir: dir} do
    for line <- ["short-key", "a b c0123456789abcdef", String.duplicate("k", 600)] do
      assert {:error, text} = Keys.load(%{key: nil, keys_file: file(dir, "# x\n#{line}\n")})
      assert text =~ "line 2"
      refute text =~ "c0123456789abcdef"
      refute text =~ "short-key"
    end

    assert {:error, _text} = Keys.load(%{key: nil, keys_file: Path.join(dir, "absent")})
    assert {:error, _text} = Keys.load(%{key: nil, keys_file: dir})
  end

  test "which addresses are this machine's own" do
    for ip <- [{127, 0, 0, 1}, {127, 9, 9, 9}, {0, 0, 0, 0, 0, 0, 0, 1}, {0, 0, 0, 0, 0, 0xFFFF, 0x7F00, 1}],
        do: assert(Keys.loopback?(ip))

    for ip <- [
          {10, 0, 0, 1},
          {0, 0, 0, 0, 0, 0xFFFF, 0x0A00, 1},
          {0xFE80, 0, 0, 0, 0, 0, 0, 1},
          {0, 0, 0, 0, 0, 0, 0, 0}
        ],
        do: refute(Keys.loopback?(ip))
  end
end
