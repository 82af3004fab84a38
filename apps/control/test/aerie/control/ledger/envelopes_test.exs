defmodule Aerie.Control.Ledger.EnvelopesTest do
  @moduledoc "A ledger that is looked at is not changed, whatever is in it."
  use ExUnit.Case, async: true

  alias Aerie.Control.Ledger.{Envelopes, Journal}

  @moduletag :tmp_dir

  defp written(dir, records) do
    {:ok, journal, [], 0} = Journal.open(dir, [], &[&1 | &2])
    {:ok, journal} = Journal.append(journal, records)
    :ok = Journal.close(journal)
  end

  defp new(id, at, envelope), do: ["new", id, "digest", at, envelope]

  test "commands in the order in which they came, and what is missing", %{tmp_dir: dir} do
    written(dir, [
      new("b", 2, %{"type" => "rtl"}),
      ["sent", "b", 3],
      new("a", 1, %{"type" => "arm"}),
      new("old", 0, nil)
    ])

    File.write!(Journal.path(dir), "00000000 [\"new\",\"x\",\"d\",4,{}]\n[torn", [:append])
    before = File.read!(Journal.path(dir))

    assert {:ok, ledger} = Envelopes.read(dir)
    assert [%{id: "a", at: 1, envelope: %{"type" => "arm"}}, %{id: "b", at: 2}] = ledger.entries
    assert ledger.forgotten == [0]
    assert ledger.damaged == 1

    assert File.read!(Journal.path(dir)) == before
    assert File.ls!(dir) == ["ledger"]
  end

  test "what is not a ledger is an error with its path", %{tmp_dir: dir} do
    assert {:error, text} = Envelopes.read(Path.join(dir, "none"))
    assert text =~ "none/ledger: no such file"
    refute File.exists?(Path.join(dir, "none"))

    File.write!(Journal.path(dir), "a letter\n")
    assert {:error, text} = Envelopes.read(dir)
    assert text =~ "not a ledger"
    File.write!(Journal.path(dir), "aerie-ledger 2\n")
    assert {:error, text} = Envelopes.read(dir)
    assert text =~ "newer"
  end
end
