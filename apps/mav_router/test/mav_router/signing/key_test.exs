defmodule MavRouter.Signing.KeyTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.Secret
  alias MavRouter.Signing.Key

  @moduletag :tmp_dir
  @key :crypto.hash(:sha256, "a passphrase")

  defp parsed(text) do
    {:ok, secret} = Key.parse(text)
    Secret.reveal(secret)
  end

  test "hexadecimal, base64, a passphrase, raw bytes" do
    assert parsed(Base.encode16(@key)) == @key
    assert parsed(Base.encode16(@key, case: :lower) <> "\n") == @key
    assert parsed(Base.encode64(@key)) == @key
    assert parsed("a passphrase\n") == @key
    assert parsed(@key) == @key
    # 32 letters are a passphrase as well as 32 bytes.
    assert parsed(String.duplicate("x", 32)) == :crypto.hash(:sha256, String.duplicate("x", 32))
  end

  test "a prefix says what it is" do
    assert parsed("hex:" <> Base.encode16(@key)) == @key
    assert parsed("base64:" <> Base.encode64(@key)) == @key
    digits = Base.encode16(@key)
    assert parsed("passphrase:" <> digits) == :crypto.hash(:sha256, digits)
    assert {:error, "the key must be 64 hexadecimal digits after hex:"} = Key.parse("hex:12")
    assert {:error, "the key must be base64 of 32 bytes after base64:"} = Key.parse("base64:eHh4")
  end

  test "an empty key, zeros, and bytes that are not text are refused" do
    assert {:error, "the key is empty"} = Key.parse(" \n")
    assert {:error, "the passphrase is empty"} = Key.parse("passphrase:")
    assert {:error, _} = Key.parse("hex:" <> String.duplicate("0", 64))
    assert {:error, _} = Key.parse(<<255, 254, 253>>)
  end

  test "a file that others can get at is refused, whatever is in it", c do
    path = Path.join(c.tmp_dir, "key")
    File.write!(path, "a passphrase")

    for mode <- [0o644, 0o640, 0o604, 0o620, 0o611] do
      File.chmod!(path, mode)
      assert {:error, text} = Key.read({:file, path})
      assert text =~ "its mode is 0#{Integer.to_string(mode, 8)}"
      assert text =~ "chmod 600 #{path}"
      refute text =~ "passphrase"
    end

    for mode <- [0o600, 0o400] do
      File.chmod!(path, mode)
      assert {:ok, secret} = Key.read({:file, path})
      assert Secret.reveal(secret) == @key
      refute inspect(secret) =~ Base.encode16(@key)
    end
  end

  test "what is not a file", c do
    assert {:error, text} = Key.read({:file, Path.join(c.tmp_dir, "nowhere")})
    assert text =~ "no such file"
    assert {:error, text} = Key.read({:file, c.tmp_dir})
    assert text =~ "is not a file"
    long = Path.join(c.tmp_dir, "long")
    File.write!(long, String.duplicate("x", 5000))
    File.chmod!(long, 0o600)
    assert {:error, text} = Key.read({:file, long})
    assert text =~ "too long"
  end

  test "the environment" do
    name = "AERIE_TEST_KEY_#{System.unique_integer([:positive])}"
    assert {:error, text} = Key.read({:env, name})
    assert text == "environment variable #{name} is not set"
    System.put_env(name, "a passphrase")
    on_exit(fn -> System.delete_env(name) end)
    assert {:ok, secret} = Key.read({:env, name})
    assert Secret.reveal(secret) == @key
  end

  test "same? compares keys" do
    {:ok, one} = Key.parse("one")
    {:ok, again} = Key.parse("one")
    assert Key.same?(one, again)
    refute Key.same?(one, Key.generate())
    refute Key.same?(one, nil)
    assert Key.same?(nil, nil)
  end
end
