defmodule Msp.Params.LineTest do
  @moduledoc "Settings by name: what real firmware says of them, in any form, and what is asked."
  use ExUnit.Case, async: true

  alias Msp.Params.Line

  test "numbers, words and what is neither" do
    assert {:ok, %{type: :u16, low: 0, high: 1000, words: []}} =
             Line.read("pgn=10\ntype=uint16\nmin=0\nmax=1000\ndefault=250")

    assert {:ok, %{type: :i8, low: -100, high: 100}} =
             Line.read("pgn=1\r\ntype=int8\r\nmin=-100\r\nmax=100\r\n")

    assert {:ok, %{type: :u8, low: 0, high: 2, words: ~w(OFF ON AUTO)}} =
             Line.read("type=lookup\nvalues=OFF,ON, AUTO\n")

    assert {:ok, %{high: 1}} = Line.read("type=bitset\nvalues=OFF,ON")
    for text <- ["type=string\nminlength=1", "type=uint8[]\nlength=8"], do: assert(Line.read(text) == :text)

    for text <- ["", "nothing", "type=uint8\nmin=x\nmax=2", "min=1\nmax=2"],
        do: assert(Line.read(text) == :error)

    assert Line.read("type=lookup\nvalues=") == :text
  end

  test "its value is that of the line with exactly its name" do
    number = %Line{type: :u8, low: 0, high: 9}
    words = %Line{type: :u8, low: 0, high: 1, words: ~w(OFF ON)}
    assert Line.value(number, "p_roll", "p_roll_limit = 7\nP_ROLL = 5\n") == {:ok, 5}
    assert Line.value(words, "x", "x = on" <> <<0, 0>>) == {:ok, 1}
    for text <- ["", "x", "x = ", "x = many", "y = 1"], do: assert(Line.value(number, "x", text) == :error)
    assert Line.value(words, "x", "x = MAYBE") == :error
  end

  test "any bytes are an answer or none" do
    property =
      :proper.forall(:proper_types.binary(), fn bytes ->
        with {:ok, line} <- Line.read("type=uint8\nmin=0\nmax=9\n" <> bytes), do: Line.value(line, "x", bytes)
        match?(result when result in [:text, :error] or is_tuple(result), Line.read(bytes))
      end)

    assert :proper.quickcheck(property, [:quiet, {:numtests, 300}]) == true
  end

  test "a reading has NULs for the answer and fits into a request; a write is one line" do
    {"MSP2_CLI_SETTING", %{line: line}} = Line.get("p_roll")
    assert line == "p_roll" <> :binary.copy(<<0>>, 100)
    assert {_, %{line: long}} = Line.get(String.duplicate("n", 64))
    assert byte_size(long) == 164
    refute Enum.any?(["a b", "a=b", "", "a\n", "ä", String.duplicate("n", 65)], &Line.name?/1)
    words = %Line{type: :u8, low: 0, high: 1, words: ~w(OFF ON)}
    assert Line.set(words, "osd", 1.0) == {:ok, {"MSP2_CLI_SETTING", %{line: "osd = ON"}}}
    assert Line.set(words, "osd", 2) == {:error, "it goes from 0 to 1"}
  end
end
