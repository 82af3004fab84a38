defmodule Aerie.Base.Files.FormatTest do
  use ExUnit.Case, async: true

  import ExUnit.CaptureLog

  alias Aerie.Base.Files.{Damaged, Format}

  @moduletag :tmp_dir

  test "a folder without a mark is the first version or new; a marked one is known again", %{tmp_dir: dir} do
    gateway = make_ref()
    assert Format.check(dir, {"outbox", 1}) == :ok
    assert Format.mark(gateway, dir, {"outbox", 1}) == :ok
    file = Path.join(dir, "FORMAT")
    assert File.read!(file) == "aerie-outbox 1\n"
    before = File.stat!(file)
    assert Format.mark(gateway, dir, {"outbox", 1}) == :ok
    assert File.stat!(file).inode == before.inode
    # The next version reads this one, and marks it as its own.
    assert Format.mark(gateway, dir, {"outbox", 2}) == :ok
    assert File.read!(file) == "aerie-outbox 2\n"
  end

  test "what is newer or of another kind is refused, and stays as it is", %{tmp_dir: dir} do
    for {text, words} <- [
          {"aerie-outbox 3\n", "newer version of Aerie (outbox 3; this one reads 2 and older)"},
          {"aerie-shadow 1\n", "is a folder for shadow"}
        ] do
      File.write!(Path.join(dir, "FORMAT"), text)
      assert {:error, error} = Format.mark(make_ref(), dir, {"outbox", 2})
      assert error =~ words and error =~ dir
      assert File.read!(Path.join(dir, "FORMAT")) == text
    end
  end

  test "what a power cut left of a mark is set aside and named, and the folder is marked again", %{
    tmp_dir: dir
  } do
    gateway = make_ref()
    start_supervised!({Aerie.Base.PubSub, gateway: gateway})
    start_supervised!({Aerie.Base.Store, gateway: gateway})
    mark = Path.join(dir, "FORMAT")
    texts = ["", "aerie-outb", "aerie-outbox x\n", String.duplicate("x", 1000), <<0xFF, 0xFE>>, :folder]

    for text <- texts do
      File.rm_rf!(mark)
      if text == :folder, do: File.mkdir!(mark), else: File.write!(mark, text)
      assert Format.check(dir, {"outbox", 1}) == :ok

      log = capture_log(fn -> assert Format.mark(gateway, dir, {"outbox", 1}) == :ok end)
      assert log =~ "#{mark} is damaged and was kept as #{mark}.damaged-"
      assert File.read!(mark) == "aerie-outbox 1\n"

      assert [%{path: ^mark, kept: kept, words: "the folder is read as one of the first version"}] =
               Damaged.list(gateway)

      assert if(text == :folder, do: File.dir?(kept), else: File.read!(kept) == text)
    end
  end
end
