defmodule Aerie.Control.Params.FileTest do
  use ExUnit.Case, async: true

  alias Aerie.Control.Params
  alias Aerie.Control.Params.{File, Param, Table}
  alias MavCodec.Message.ParamValue

  @table Table.new([
           %Param{name: "A", value: 5, type: 4},
           %Param{name: "B", value: ParamValue.float32(0.1), type: 9},
           %Param{name: "C", value: ParamValue.float32(1.0e-30), type: 9},
           %Param{name: "D", value: -2_147_483_648, type: 6}
         ])

  test "Mission Planner's, MAVProxy's and QGroundControl's lines are read" do
    assert {:ok, [%{name: "A", value: 5, type: nil, line: 2}, %{name: "B", value: 0.25}]} =
             File.parse("# comment\r\nA,5\r\nB,0.25 # a note\r\n")

    assert {:ok, [%{name: "ACRO_BAL_PITCH", value: 1.0, decimals: 6}]} =
             File.parse("ACRO_BAL_PITCH   1.000000\n")

    assert {:ok, [%{name: "A", value: 5, type: 6}]} =
             File.parse("# Vehicle-Id Component-Id Name Value Type\n1\t1\tA\t5\t6\n")
  end

  test "what is written is read back, value for value" do
    for format <- [:param, :params] do
      {:ok, entries} = File.parse(File.format(@table, format, {1, 1}))
      assert Params.differing(entries, @table) == {[], []}
      assert Enum.map(entries, & &1.name) == Enum.sort(Map.keys(@table.params))
      if format == :params, do: assert(Enum.map(entries, & &1.type) == [4, 9, 9, 6])
    end

    property =
      :proper.forall(:proper_types.float(), fn float ->
        table = Table.new([%Param{name: "X", value: ParamValue.float32(float), type: 9}])
        {:ok, [entry]} = File.parse(File.format(table, :param, {1, 1}))
        ParamValue.same?(entry.value, float)
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 1000]) == true, inspect(:proper.counterexample())
  end

  test "every error has the number of its line" do
    text = "A,1\nB\nA,2,3\nVERYLONGNAMEOF17C,1\nC,abc\n1\t1\tD\t300\t2\n1\t1\tE\t1\t77\n"
    assert {:error, errors} = File.parse(text)
    assert Enum.sort(Enum.map(errors, &elem(&1, 0))) == [2, 3, 4, 5, 6, 7]
    assert {6, "D: expected an integer of -128 to 127, got 300"} in errors
  end

  test "files have bounds" do
    assert {:error, [{nil, "the file has no parameters"}]} = File.parse("# nothing\n")
    assert {:error, [{nil, "the file has 1048577 bytes" <> _}]} = File.parse(String.duplicate("x", 1_048_577))
    assert {:error, [{nil, "the file is not text in UTF-8"}]} = File.parse(<<255, 254>>)
    assert {:error, [{nil, "5001 parameters" <> _}]} = File.parse(Enum.map_join(1..5001, &"P#{&1},1\n"))
    assert {:error, errors} = File.parse(String.duplicate("bad\n", 100))
    assert length(errors) == 20
  end

  test "a file is not a crash, whatever is in it" do
    property =
      :proper.forall(:proper_types.binary(), fn bytes -> elem(File.parse(bytes), 0) in [:ok, :error] end)

    assert :proper.quickcheck(property, [:quiet, numtests: 500]) == true, inspect(:proper.counterexample())
  end

  test "what differs of a vehicle, and what it does not have; rounding does not count" do
    {:ok, entries} = File.parse("A,6\nB,0.100000\nE,1\nD,-2147483648\n")
    assert {[%{name: "A", value: 6}], ["E"]} = Params.differing(entries, @table)

    # Few digits mean what they say.
    {:ok, entries} = File.parse("B,0\n")
    assert {[%{name: "B", value: 0}], []} = Params.differing(entries, @table)
  end
end
