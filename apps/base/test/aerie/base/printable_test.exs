defmodule Aerie.Base.PrintableTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.{Log, Printable}

  # ANSI, C1, signs of direction (of both kinds), of joining, tags.
  @unseen ["\e", "\x07", "\x7F", "\u0085", "\u009B", "\u061C", "\u200B", "\u200E", "\u200F", "\u2028"] ++
            Enum.map(0x202A..0x202E, &<<&1::utf8>>) ++
            Enum.map(0x2066..0x2069, &<<&1::utf8>>) ++ ["\uFEFF", <<0xE0041::utf8>>]

  test "a line has nothing that is not seen" do
    for sign <- @unseen, do: assert(Printable.line("a#{sign}b") == "a?b")
    assert Printable.line("Flüge 東 \u{1F681} \xE9", "") == "Flüge 東 \u{1F681} "
  end

  test "lines have it as an escape, which JSON reads back" do
    assert Printable.lines(["a\tb\n", "c\r\n"]) == "a\tb\nc\r\n"
    assert Printable.lines("x\u202Egpj.exe") == "x\\u202egpj.exe"

    for sign <- @unseen do
      text = "a#{sign}b"
      lines = Printable.lines([JSON.encode!(text)])
      refute lines =~ sign
      assert JSON.decode!(lines) == text
    end
  end

  test "no line of the log has any" do
    for sign <- @unseen, format <- [:logfmt, :json] do
      text = "a#{sign}b"

      line =
        format |> Log.Formatter.line(1_795_000_000_000_000, :info, text, text: text) |> IO.iodata_to_binary()

      refute line =~ sign
      assert String.valid?(line)
    end
  end

  test "whatever comes can be printed" do
    property =
      :proper.forall(:proper_types.binary(), fn bytes ->
        String.printable?(Printable.line(bytes)) and String.printable?(Printable.lines(bytes))
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 1000]) == true, inspect(:proper.counterexample())
  end
end
