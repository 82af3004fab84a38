Code.require_file("../../bin/lib/checks/words.exs", __DIR__)

defmodule Aerie.Gate.WordsTest do
  use ExUnit.Case, async: true

  @turns [
    {"A command without a name is none.", "is none", "is not one"},
    {"With another key none is.", "none is", "say what is not"},
    {"Its gateway told none.", "told none", "reported no"},
    {"It waits, for who may fly it.", "for who may", "anybody who"},
    {"The turn of who has it.", "of who has", "of the one who"},
    {"It is open; who has it may read.", "; who has it", "with it"},
    {"Who moves home needs a permission.", "Who moves", "name it"},
    {"A lease. Who commands, as it was proved.", ". Who commands", "name it"},
    {"A port: who reaches it is a client.", ": who reaches it is ", "name it"},
    {"who may not send a plan is refused", "who may not send a plan is ", "name it"},
    {"The rest is dropped, too.", ", too", "also"},
    {"The rest, too (W6)", ", too", "also"},
    {"It ends. Of the rest nothing is kept.", ". Of the", "begin with the subject"},
    {"The vehicle is not told.", "is not told", "hears"},
    {"The end can be told.", "be told", "hears"},
    {"It ends in time.", "in time", "before its deadline"},
    {"To mend it: start it again.", "To mend it", "fix"},
    {"Does what the words say.", "Does what the words say", "say what it does"},
    {"The rows stand below each other.", "stand below each other", "line up"},
    {"This is for nobody.", "is for nobody", "say what is refused"},
    {"A stone is no vehicle.", "is no vehicle", "is not a"},
    {"It goes by NATS.", "by NATS", "over NATS"},
    {"It begins anew.", "anew", "again"},
    {"It ceased.", "ceased", "stop"},
    {"This belongs into docs.", "belongs into", "belongs in"},
    {"Whoever asks.", "Whoever", "anyone who"},
    {"The parts thereof.", "thereof", "plain words"},
    {"It is silent, wherefore it waits.", "wherefore", "plain words"},
    {"It tells of a failure.", "tells of", "reports"}
  ]

  @good [
    "There is none, or it is none of these. A release has none, and here are none.",
    "Anybody who may fly it, and the user who asked. It says who may fly it; who it is decides the policy.",
    "| `by` | who asked for it |\n\n- who set it, and when\n\n## Who may do what\n\nWho sends it?",
    "It is too late, and the other one knows it too. Too many, too long.",
    "Of course. Most of the time it is a part of the rest.",
    "They are told apart by their ids, and it runs until it is told otherwise. It told the user.",
    "A point in time, and a step back in time. It did not answer in time. At the time when it came.",
    "There is no vehicle; it is no longer there. It runs by night."
  ]

  defp find(text, kind \\ :page), do: Words.find(kind, text, Words.patterns())

  test "each turn is found, with what to write instead" do
    for {text, says, instead} <- @turns do
      assert [{1, ^says, advice}] = find(text)
      assert advice =~ instead
    end
  end

  test "there is an example of each pattern" do
    patterns = for {_part, pattern, _instead} <- Words.patterns(), do: pattern
    texts = Enum.map(@turns, &elem(&1, 0))
    assert for(pattern <- patterns, not Enum.any?(texts, &(&1 =~ pattern)), do: pattern) == []
  end

  test "good sentences pass" do
    for text <- @good, do: assert(find(text) == [])
  end

  test "a turn may go over the end of a line, not over the end of a paragraph or a cell" do
    assert [{2, "is none", _}] = find("One\nthat is\nnone.")
    assert [{3, "Of a", _}] = find("Text.\n\nOf a boat.")
    assert find("It is\n\nnone") == []
    assert find("- it is\n- none") == []
    assert find("| it is | none |") == []
  end

  test "of code, its comments, documentation and texts are read, and nothing else" do
    code = ~S'''
    defmodule Kite do
      @moduledoc """
      A kite.

      It can be told.
      """

      # A line that
      # is none.
      @text ~H"""
      Text.
      It is told.
      """
      @other """
      #{1} was none.
      """
      def fold(x), do: "#{x} is none, #{x} is no #{x}"
      def who_may, do: :is_none
    end
    '''

    assert code |> find(:code) |> Enum.map(&{elem(&1, 0), elem(&1, 1)}) |> Enum.sort() ==
             [
               {5, "be told"},
               {9, "is none"},
               {12, "is told"},
               {15, "was none"},
               {17, "is no …"},
               {17, "is none"}
             ]
  end

  test "of tests, their names are read" do
    code = ~s(  describe "who waits is told" do\n    test "one is none", c do\n      assert "this is none"\n)

    assert [{1, "who waits is ", _}, {1, "is told", _}, {2, "is none", _}] =
             find(code, :test)
  end
end
