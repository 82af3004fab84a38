defmodule MavCodec.Meaning.RowsTest do
  @moduledoc """
  What the rows say is what the tables have, each row stands once, and its numbers are read as firmwares read them.
  """
  use ExUnit.Case, async: true

  alias MavCodec.Meaning.Commands
  alias MavCodec.Meaning.Commands.{Flight, Numbers, Payload, Row, Upkeep}
  alias MavCodec.Meaning.Messages

  test "the rows of each part are in the table, and none is in two parts" do
    parts = for part <- [Flight, Payload, Upkeep], do: length(part.rows())
    assert Enum.sum(parts) == length(Commands.all())
    assert Enum.all?(parts, &(&1 > 20))
    ids = for row <- Commands.all(), do: row.id
    assert ids == Enum.uniq(ids)
    for row <- Commands.all(), do: assert(row.permission in Row.permissions(), row.name)
  end

  test "the rows of messages are those of the table" do
    rows = Messages.Rows.all()
    assert length(rows) > 100
    assert Messages.row(0x00FF_FFFF) == nil
  end

  test "numbers by the definitions: an enumeration, flags, an index; a row may say otherwise" do
    for row <- Commands.all(), {index, kind} <- row.numbers do
      assert index in 1..7
      assert Numbers.text(kind) =~ ~r/\A(one of|0 or 1|an integer)/, row.name
    end

    kinds = for row <- Commands.all(), {_index, kind} <- row.numbers, uniq: true, do: elem(kind, 0)
    assert Enum.sort(kinds) == [:flags, :index, :values]
    id = Enum.find(Commands.all(), &(&1.numbers != [])).id
    [{index, _kind} | _others] = Numbers.of(id, [])
    assert {index, {:index, 0, 3}} in Numbers.of(id, [{index, {:index, 0, 3}}])
    refute List.keymember?(Numbers.of(id, [{index, :any}]), index, 0)
  end

  test "a number that firmwares may read in different ways is an error" do
    assert Numbers.read(2.0, {:values, [1, 2]}) == {:ok, 2}
    assert Numbers.read(:nan, {:flags, 3}) == {:ok, 0}
    assert Numbers.read({:nan, 1}, {:index, 0, 9}) == {:ok, 0}
    assert Numbers.read(5, {:index, 0, 9}) == {:ok, 5}

    for {value, kind} <- [
          {2.5, {:values, [2]}},
          {3, {:values, [2]}},
          {4, {:flags, 3}},
          {10, {:index, 0, 9}},
          {:inf, {:index, 0, 9}}
        ],
        do: assert(Numbers.read(value, kind) == :error)

    assert Numbers.text({:flags, 1}) == "0 or 1"
  end
end
