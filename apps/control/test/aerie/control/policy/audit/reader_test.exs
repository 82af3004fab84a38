defmodule Aerie.Control.Policy.Audit.ReaderTest do
  use ExUnit.Case, async: true

  alias Aerie.Control.Policy.Audit.{Log, Reader}

  @moduletag :tmp_dir

  defp write(dir, entries, max_bytes \\ 1_000_000) do
    {:ok, log} = Log.open(dir, max_bytes, 1_000_000)

    log =
      Enum.reduce(entries, log, fn entry, log ->
        {:ok, log} = Log.append(log, entry, 2_000_000)
        log
      end)

    Log.close(log)
  end

  defp numbers({:ok, page}), do: Enum.map(page.records, & &1["k"])

  test "pages are newest first, and follow each other without gap or copy", %{tmp_dir: dir} do
    write(dir, for(k <- 1..25, do: %{"type" => "decision", "k" => k}))
    {:ok, %{next: next} = page} = Reader.page(dir, %{limit: 10})
    assert numbers({:ok, page}) == Enum.to_list(25..16//-1)
    {:ok, %{next: next} = page} = Reader.page(dir, %{limit: 10, before: next})
    assert numbers({:ok, page}) == Enum.to_list(15..6//-1)
    assert {:ok, %{next: nil} = page} = Reader.page(dir, %{limit: 10, before: next})
    # The last is the record that the log was opened.
    assert numbers({:ok, page}) == [5, 4, 3, 2, 1, nil]
  end

  test "pages go over several files", %{tmp_dir: dir} do
    write(
      dir,
      for(k <- 1..40, do: %{"type" => "decision", "k" => k, "fill" => String.duplicate("x", 4_000)}),
      1_000_000
    )

    assert length(Reader.files(dir)) > 1
    assert numbers(Reader.page(dir, %{limit: 40})) == Enum.to_list(40..1//-1)
  end

  test "filters: type, decision, text in any value", %{tmp_dir: dir} do
    write(dir, [
      %{"type" => "decision", "decision" => "allow", "vehicle" => "VID-001", "k" => 1},
      %{"type" => "decision", "decision" => "deny", "reason" => "outside the fence", "k" => 2},
      %{"type" => "result", "vehicle" => "VID-002", "k" => 3, "list" => ["Fence"]}
    ])

    assert numbers(Reader.page(dir, %{type: "decision"})) == [2, 1]
    assert numbers(Reader.page(dir, %{decision: "deny"})) == [2]
    assert numbers(Reader.page(dir, %{text: "FENCE"})) == [3, 2]
    assert numbers(Reader.page(dir, %{text: "vid-001"})) == [1]
    assert numbers(Reader.page(dir, %{text: "nowhere", type: ""})) == []
  end

  test "a folder that is not there, and one with a damaged file", %{tmp_dir: dir} do
    assert {:error, text} = Reader.page(Path.join(dir, "none"), %{})
    assert text =~ "no such file"
    assert Reader.files(Path.join(dir, "none")) == []
    write(dir, [%{"type" => "decision", "k" => 1}])
    [{path, _size}] = Reader.files(dir)
    File.write!(path, "no record\n", [:append])
    assert numbers(Reader.page(dir, %{})) == [1, nil]
  end
end
