defmodule Aerie.Fleet.Shadow.GatewayLease.NumbersTest do
  use ExUnit.Case, async: true

  alias Aerie.Fleet.Shadow.GatewayLease.Numbers

  @ttl 10_000

  test "a word counts once, an older one never, and ours is newer than all that was seen, whatever the clock says" do
    numbers = Numbers.new("me", @ttl)
    assert {:new, numbers} = Numbers.seen(numbers, {:vehicle, "V"}, 7)
    assert {:same, numbers} = Numbers.seen(numbers, {:vehicle, "V"}, 7)
    assert {:old, numbers} = Numbers.seen(numbers, {:vehicle, "V"}, 6)
    assert {8, numbers} = Numbers.next(numbers, {:vehicle, "V"}, 3)
    assert {1_000, _numbers} = Numbers.next(numbers, {:vehicle, "V"}, 1_000)
  end

  test "after a start a gateway is believed for a while, and then only if it names a number of ours that is recent" do
    numbers = Numbers.new("me", @ttl) |> Numbers.sent(500, 0)
    assert {true, numbers} = Numbers.alive(numbers, "silent", nil, 1)
    assert {true, numbers} = Numbers.alive(numbers, "echoes", 500, 1)
    assert {true, numbers} = Numbers.alive(numbers, "late", nil, 1)
    assert {false, numbers} = Numbers.alive(numbers, "silent", nil, 30_002)
    assert {true, numbers} = Numbers.alive(numbers, "echoes", nil, 30_002)
    # What it says has been recorded, however new its number.
    assert {false, numbers} = Numbers.alive(numbers, "late", 500, 30_002)
    # During a gap others may have recorded everything.
    numbers = numbers |> Numbers.gap() |> Numbers.sent(900, 60_000)
    assert {true, numbers} = Numbers.alive(numbers, "echoes", nil, 60_000)
    assert {false, numbers} = Numbers.alive(numbers, "echoes", nil, 90_001)
    assert {false, _numbers} = Numbers.alive(numbers, "echoes", 900, 90_001)
  end

  test "a clock that was set back is noticed by what others have seen of us" do
    {_alive?, numbers} = Numbers.alive(Numbers.new("me", @ttl), "other", 5_000, 0)
    assert {5_001, _numbers} = Numbers.next(numbers, {:gateway, "me"}, 100)
  end

  test "a sign of life names all others in turn, and no more than it has room for" do
    numbers =
      Enum.reduce(10..59, Numbers.new("me", @ttl), fn n, numbers ->
        {:new, numbers} = Numbers.seen(numbers, {:gateway, "0123456789abcd#{n}"}, 1_700_000_000_000)
        numbers
      end)

    {echoes, _numbers} = Enum.map_reduce(1..4, numbers, fn _turn, numbers -> Numbers.echo(numbers) end)
    assert echoes |> Enum.flat_map(&Map.keys/1) |> Enum.uniq() |> length() == 50
    assert Enum.all?(echoes, &(byte_size(JSON.encode!(&1)) < 700))
  end
end
