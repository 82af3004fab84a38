defmodule Aerie.Fleet.Shadow.Documents.LeaseNumbersTest do
  use ExUnit.Case, async: true

  alias Aerie.Fleet.Shadow.Documents.LeaseNumbers

  @ttl 10_000

  test "a word counts once, an older one never, and ours is newer than all that was seen, whatever the clock says" do
    numbers = LeaseNumbers.new("me", @ttl)
    assert {:new, numbers} = LeaseNumbers.seen(numbers, {:vehicle, "V"}, 7)
    assert {:same, numbers} = LeaseNumbers.seen(numbers, {:vehicle, "V"}, 7)
    assert {:old, numbers} = LeaseNumbers.seen(numbers, {:vehicle, "V"}, 6)
    assert {8, numbers} = LeaseNumbers.next(numbers, {:vehicle, "V"}, 3)
    assert {1_000, _numbers} = LeaseNumbers.next(numbers, {:vehicle, "V"}, 1_000)
  end

  test "after a start a gateway is believed for a while, and then only if it names a number of ours that is recent" do
    numbers = LeaseNumbers.new("me", @ttl) |> LeaseNumbers.sent(500, 0)
    assert {true, numbers} = LeaseNumbers.alive(numbers, "silent", nil, 1)
    assert {true, numbers} = LeaseNumbers.alive(numbers, "echoes", 500, 1)
    assert {true, numbers} = LeaseNumbers.alive(numbers, "late", nil, 1)
    assert {false, numbers} = LeaseNumbers.alive(numbers, "silent", nil, 30_002)
    assert {true, numbers} = LeaseNumbers.alive(numbers, "echoes", nil, 30_002)
    # What it says has been recorded, however new its number.
    assert {false, numbers} = LeaseNumbers.alive(numbers, "late", 500, 30_002)
    # During a gap others may have recorded everything.
    numbers = numbers |> LeaseNumbers.gap() |> LeaseNumbers.sent(900, 60_000)
    assert {true, numbers} = LeaseNumbers.alive(numbers, "echoes", nil, 60_000)
    assert {false, numbers} = LeaseNumbers.alive(numbers, "echoes", nil, 90_001)
    assert {false, _numbers} = LeaseNumbers.alive(numbers, "echoes", 900, 90_001)
  end

  test "a clock that was set back is noticed by what others have seen of us" do
    {_alive?, numbers} = LeaseNumbers.alive(LeaseNumbers.new("me", @ttl), "other", 5_000, 0)
    assert {5_001, _numbers} = LeaseNumbers.next(numbers, {:gateway, "me"}, 100)
  end

  test "a sign of life names all others in turn, and no more than it has room for" do
    numbers =
      Enum.reduce(10..59, LeaseNumbers.new("me", @ttl), fn n, numbers ->
        {:new, numbers} = LeaseNumbers.seen(numbers, {:gateway, "0123456789abcd#{n}"}, 1_700_000_000_000)
        numbers
      end)

    {echoes, _numbers} = Enum.map_reduce(1..4, numbers, fn _turn, numbers -> LeaseNumbers.echo(numbers) end)
    assert echoes |> Enum.flat_map(&Map.keys/1) |> Enum.uniq() |> length() == 50
    assert Enum.all?(echoes, &(byte_size(JSON.encode!(&1)) < 700))
  end
end
