defmodule Aerie.Base.Files.FormatTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.Files.Format

  @moduletag :tmp_dir

  test "a folder without a mark is the first version or new; a marked one is known again", %{tmp_dir: dir} do
    assert Format.check(dir, {"outbox", 1}) == :ok
    assert Format.mark(dir, {"outbox", 1}) == :ok
    file = Path.join(dir, "FORMAT")
    assert File.read!(file) == "aerie-outbox 1\n"
    before = File.stat!(file)
    assert Format.mark(dir, {"outbox", 1}) == :ok
    assert File.stat!(file).inode == before.inode
    # The next version reads this one, and marks it as its own.
    assert Format.mark(dir, {"outbox", 2}) == :ok
    assert File.read!(file) == "aerie-outbox 2\n"
  end

  test "what is newer, of another kind or damaged is refused, and stays as it is", %{tmp_dir: dir} do
    for {text, words} <- [
          {"aerie-outbox 3\n", "newer version of Aerie (outbox 3; this one reads 2 and older)"},
          {"aerie-shadow 1\n", "is a folder for shadow"},
          {"", "damaged"},
          {"aerie-outbox x\n", "damaged"},
          {String.duplicate("x", 1000), "damaged"},
          {<<0xFF, 0xFE>>, "damaged"}
        ] do
      File.write!(Path.join(dir, "FORMAT"), text)
      assert {:error, error} = Format.mark(dir, {"outbox", 2})
      assert error =~ words and error =~ dir
      assert File.read!(Path.join(dir, "FORMAT")) == text
    end
  end
end
