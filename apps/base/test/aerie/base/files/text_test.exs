defmodule Aerie.Base.Files.TextTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.Files.Text

  test "lines have their numbers, without comments, empty lines and the mark of Windows" do
    text = "\uFEFFQGC WPL 110\r\n\n  # a comment\n1\t0 # home\r2"
    assert Text.lines(text) == {:ok, [{"QGC WPL 110", 1}, {"1\t0", 4}, {"2", 5}]}
    assert Text.lines("") == {:ok, []}
  end

  test "Latin-1 is allowed in comments only" do
    assert Text.lines("1 # Z\xFCrich") == {:ok, [{"1", 1}]}
    assert Text.lines("Z\xFCrich") == {:error, "the file is not text in UTF-8"}
  end

  test "decimal numbers, also as other programs write them" do
    for {text, value} <- [
          {"7", 7},
          {"-3", -3},
          {".5", 0.5},
          {"50.", 50.0},
          {"+1.5e3", 1500.0},
          {"2e2", 200.0}
        ],
        do: assert(Text.number(text) == {:ok, value})

    for bad <- ["", ".", "1x", "nan", "inf", "0x10", "1e999", "--1", "1 2", String.duplicate("1", 65)],
        do: assert(Text.number(bad) == :error)
  end
end
