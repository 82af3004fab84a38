defmodule Aerie.Control.Policy.Fence.KeptTest do
  use ExUnit.Case, async: true

  alias Aerie.Control.Policy.Fence.Kept
  alias Protocols.Mission.{Item, Onboard, Plan}
  alias Aerie.Vehicle.Firmware

  # A square of so many metres around a place, and a circle.
  defp square(metres, {lat, lon} \\ {47.0, 8.0}) do
    {north, east} = {round(metres / 0.0111), round(metres / 0.00757)}
    {lat, lon} = {round(lat * 1.0e7), round(lon * 1.0e7)}
    {:polygon, for({n, e} <- [{-1, -1}, {-1, 1}, {1, 1}, {1, -1}], do: {lat + n * north, lon + e * east})}
  end

  defp circle(metres, {lat, lon} \\ {47.0, 8.0}),
    do: {:circle, {round(lat * 1.0e7), round(lon * 1.0e7)}, metres / 1}

  defp items(zones, back \\ nil),
    do: Onboard.items(%Plan{fence: zones, fence_return: back}, 1, Firmware.of(:px4))

  defp kept?(new, old), do: Kept.by?(items(new), items(old))

  test "a fence keeps what an equal or a narrower one kept" do
    inside = [{:inclusion, square(500)}]
    assert kept?(inside, [])
    assert kept?([], [])
    assert kept?(inside, inside)
    assert kept?([{:inclusion, square(400)}], inside)
    assert kept?([{:inclusion, circle(400)}], inside)
    assert kept?([{:inclusion, circle(499)}], [{:inclusion, circle(500)}])
    assert kept?([{:inclusion, square(300)}], [{:inclusion, circle(500)}])
    assert kept?([{:inclusion, square(400)}, {:exclusion, circle(50)}], inside)

    tower = [{:exclusion, circle(50)}]
    assert kept?([{:exclusion, circle(60)}], tower)
    assert kept?([{:exclusion, square(60)} | inside], tower)
    assert kept?(inside ++ tower, tower ++ inside)
  end

  test "one that lets the vehicle go where it could not go before does not" do
    inside = [{:inclusion, square(500)}]
    tower = [{:exclusion, circle(50)}]

    for {old, new} <- [
          # Tried: a circle of a metre far away, one of 100 km, a return point alone.
          {inside, [{:exclusion, circle(1, {10.0, 10.0})}]},
          {inside, [{:inclusion, circle(100_000)}]},
          {inside, []},
          {tower, []},
          {tower, inside},
          {tower, [{:exclusion, circle(40)}]},
          {tower, [{:exclusion, circle(60, {47.001, 8.0})}]},
          {inside, [{:inclusion, square(510)}]},
          {inside, [{:inclusion, square(400, {47.002, 8.0})}]},
          # One of several is enough for PX4, all of them are needed for ArduPilot.
          {inside, [{:inclusion, square(400)}, {:inclusion, square(400, {47.1, 8.0})}]},
          {inside ++ [{:inclusion, circle(300)}], inside},
          {inside ++ tower, inside},
          # An inclusion in the place of an exclusion.
          {tower, [{:inclusion, circle(50)}]}
        ],
        do: refute(kept?(new, old), inspect({new, old}))

    refute Kept.by?(items([], {{470_000_000, 80_000_000}, 20.0}), items(inside))
  end

  test "what is not understood is kept by the same only" do
    home = %Item{command: 5005, frame: 0, params: {300.0, 0.0, 0.0, 0.0}, x: 0, y: 0}
    old = [home | items([{:inclusion, square(500)}])]
    assert Kept.by?(old, old)
    refute Kept.by?(items([{:inclusion, square(400)}]), old)
    refute Kept.by?(tl(old), old)
    refute Kept.by?([home], items([{:inclusion, square(500)}]))
  end

  test "a fence of many zones is compared by equal ones only" do
    many = for n <- 1..40, do: {:exclusion, circle(n)}
    assert kept?(many, many)
    assert kept?(Enum.reverse(many), many)
    refute kept?([{:exclusion, circle(100)} | tl(many)], many)
  end
end
