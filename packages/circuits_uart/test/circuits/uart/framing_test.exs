defmodule Circuits.UART.FramingTest do
  use ExUnit.Case, async: true

  alias Circuits.UART.Framing.{FourByte, Line, None}

  import Circuits.UART.Test.Generators

  describe "any split of the same bytes gives the same messages:" do
    for {name, framing, args} <- [
          {"None, but for where they are cut", None, []},
          {"FourByte", FourByte, []},
          {"Line", Line, []},
          {"Line with short lines", Line, [max_length: 3]},
          {"Line with two bytes", Line, [separator: "\r\n", max_length: 5]},
          {"Line with a separator that repeats itself", Line, [separator: "\n\n\r", max_length: 2]}
        ] do
      test name do
        property =
          :proper.forall(:proper_types.tuple([line_noise(), splits()]), fn {bytes, splits} ->
            whole = receive_all(unquote(framing), unquote(args), [bytes])
            pieces = receive_all(unquote(framing), unquote(args), cut(bytes, splits))
            same?(unquote(framing), whole, pieces)
          end)

        assert :proper.quickcheck(property, [:quiet, numtests: 500]) == true,
               inspect(:proper.counterexample())
      end
    end
  end

  test "Line: nothing is lost, no message too long, and what is sent is received" do
    property =
      :proper.forall(line_noise(), fn bytes ->
        {messages, {:ok, rest, _state}} = receive_all(Line, [max_length: 3], [bytes])

        put_back = fn
          {:partial, part} -> part
          line -> line <> "\n"
        end

        kept = for {:partial, part} <- rest, do: part

        Enum.map_join(messages, put_back) <> Enum.join(kept) == bytes and
          Enum.all?(messages, fn
            {:partial, part} -> byte_size(part) == 3
            line -> byte_size(line) <= 3 and not String.contains?(line, "\n")
          end)
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 500]) == true, inspect(:proper.counterexample())
  end

  test "Line: messages" do
    {:ok, line} = Line.init([])
    assert {:ok, "ABC\n", ^line} = Line.add_framing("ABC", line)
    assert {:ok, ["", "ABC", "DEF"], ^line} = Line.remove_framing("\nABC\nDEF\n", line)
    assert {:in_frame, ["A"], part} = Line.remove_framing("A\nBC", line)
    assert part.processed == "BC"
    refute Line.buffer_empty?(part)
    assert Line.flush(:transmit, part) == part
    assert Line.flush(:receive, part) == line
    assert Line.flush(:both, part) == line
    assert {:ok, [{:partial, "BC"}], ^line} = Line.frame_timeout(part)
    assert {:ok, [], ^line} = Line.frame_timeout(line)
  end

  test "Line: a long line comes in parts, one of just the length is whole" do
    {:ok, line} = Line.init(max_length: 4)
    assert {:ok, ["ABCD"], ^line} = Line.remove_framing("ABCD\n", line)
    assert {:in_frame, [], part} = Line.remove_framing("EFGH", line)
    assert {:ok, ["EFGH"], ^line} = Line.remove_framing("\n", part)

    assert {:ok, [{:partial, "ABCD"}, {:partial, "EFGH"}, "I"], ^line} =
             Line.remove_framing("ABCDEFGHI\n", line)
  end

  test "Line: arguments that mean nothing" do
    for args <- [
          [max_length: 0],
          [max_length: "4"],
          [separator: ""],
          [separator: nil],
          [seperator: "\n"],
          :none
        ] do
      assert {args, Line.init(args)} == {args, {:error, :einval}}
    end
  end

  test "FourByte: a rest is told or dropped" do
    {:ok, state} = FourByte.init([])
    assert {:ok, "AB", ^state} = FourByte.add_framing("AB", state)
    assert {:in_frame, ["ABCD"], "E"} = FourByte.remove_framing("BCDE", "A")
    assert FourByte.frame_timeout("E") == {:ok, ["E"], ""}
    assert FourByte.frame_timeout("") == {:ok, [], ""}
    assert FourByte.flush(:transmit, "E") == "E"
    assert FourByte.flush(:receive, "E") == ""
  end

  test "None: bytes as they come" do
    {:ok, state} = None.init([])
    assert None.add_framing("A", state) == {:ok, "A", state}
    assert None.remove_framing("AB", state) == {:ok, ["AB"], state}
    assert None.frame_timeout(state) == {:ok, [], state}
    assert None.flush(:both, state) == state
  end

  defp receive_all(framing, args, pieces) do
    {:ok, state} = framing.init(args)

    {messages, state} =
      Enum.reduce(pieces, {[], state}, fn piece, {messages, state} ->
        {status, more, state} = framing.remove_framing(piece, state)
        # :ok says that nothing is left over.
        if status == :ok, do: {:ok, [], _} = framing.frame_timeout(state)
        {[messages, more], state}
      end)

    {List.flatten(messages), framing.frame_timeout(state)}
  end

  defp same?(None, {whole, _}, {pieces, _}), do: Enum.join(whole) == Enum.join(pieces)
  defp same?(_framing, whole, pieces), do: whole == pieces
end
