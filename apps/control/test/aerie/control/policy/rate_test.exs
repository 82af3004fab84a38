defmodule Aerie.Control.Policy.RateTest do
  use ExUnit.Case, async: true

  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.Rate

  @second 1_000_000
  @minute 60 * @second

  defp policy(rates) do
    {:ok, policy} = Policy.compile(%{rates: rates})
    policy
  end

  # How many of `n` at once are allowed.
  defp burst(rate, policy, n, now, {source, vehicle, type} \\ {"olga", "VID-001", "goto"}) do
    Enum.reduce(1..n, {rate, 0}, fn _time, {rate, allowed} ->
      case Rate.take(rate, policy, source, vehicle, type, now) do
        {:ok, rate} -> {rate, allowed + 1}
        {:deny, :rate, _text} -> {rate, allowed}
      end
    end)
  end

  test "a command without a name in the table is named as MAVLink does" do
    policy = policy([%{per_minute: 6, burst: 1}])
    {rate, 1} = burst(Rate.new(), policy, 1, 0, {"olga", "VID-001", "mav_cmd_16"})

    assert {:deny, :rate, "olga may command NAV_WAYPOINT of" <> _} =
             Rate.take(rate, policy, "olga", "VID-001", "mav_cmd_16", 0)
  end

  test "so many at once, then one in so long, for each type" do
    policy = policy([%{types: ["goto"], per_minute: 6, burst: 3}])
    {rate, 3} = burst(Rate.new(), policy, 10, 0)

    assert Rate.take(rate, policy, "olga", "VID-001", "goto", 4 * @second) ==
             {:deny, :rate,
              "olga may command goto of VID-001 6 times a minute, 3 at once; the next one is allowed in 6 s"}

    {rate, 1} = burst(rate, policy, 10, 10 * @second)

    assert {_, 5} = burst(rate, policy, 5, 0, {"olga", "VID-001", "land"})
  end

  test "rules name sources and vehicles, and all that apply must agree" do
    policy =
      policy([
        %{sources: ["script"], per_minute: 60, burst: 2},
        %{vehicles: ["VID-007"], types: ["takeoff"], per_minute: 1, burst: 1}
      ])

    assert {_, 2} = burst(Rate.new(), policy, 9, 0, {"script", "VID-001", "takeoff"})
    assert {_, 1} = burst(Rate.new(), policy, 9, 0, {"script", "VID-007", "takeoff"})
    assert {_, 9} = burst(Rate.new(), policy, 9, 0, {"olga", "VID-001", "takeoff"})
  end

  test "a token that is put back may be taken again" do
    policy = policy([%{types: ["goto"], per_minute: 1, burst: 2}])
    {rate, 2} = burst(Rate.new(), policy, 3, 0)
    rate = Rate.put_back(rate, policy, "olga", "VID-001", "goto")
    assert {_rate, 1} = burst(rate, policy, 3, 0)
    # Nothing was taken of it.
    assert Rate.put_back(Rate.new(), policy, "olga", "VID-001", "goto") == Rate.new()
  end

  test "out of the box a flood does not pass, but set-points and transfers, unless a rule names them" do
    {:ok, policy} = Policy.compile(%{})
    {rate, allowed} = burst(Rate.new(), policy, 1000, 0)
    assert allowed == 100

    Enum.reduce(1..200, rate, fn n, rate ->
      {:ok, rate} = Rate.take(rate, policy, "olga", "VID-001", "goto", n * 20_000)
      rate
    end)

    for type <- ~w(setpoint_position rc_override mission_upload set_parameter) do
      assert {_, 1000} = burst(Rate.new(), policy, 1000, 0, {"olga", "VID-001", type})
    end

    named = policy([%{types: ["rc_override"], per_minute: 60, burst: 5}])
    assert {_, 5} = burst(Rate.new(), named, 1000, 0, {"olga", "VID-001", "rc_override"})

    {:ok, free} = Policy.compile(%{rates: []})
    assert {_, 1000} = burst(Rate.new(), free, 1000, 0)
  end

  test "made-up types fill no memory" do
    policy = policy([%{per_minute: 1, burst: 1}])
    rate = %Rate{buckets: Map.new(1..1_000, &{{"mav_cmd_#{&1}", @minute, 1}, @minute})}
    assert {:deny, :rate, "olga commanded too many" <> _} = Rate.take(rate, policy, "olga", "v", "arm", 1)
    assert {:ok, %{buckets: buckets}} = Rate.take(rate, policy, "olga", "v", "arm", 61 * @second)
    assert map_size(buckets) == 1
  end

  test "never more than the burst and what has come since, whatever the order of times" do
    property =
      :proper.forall(:proper_types.list(:proper_types.integer(0, 3_000_000)), fn steps ->
        policy = policy([%{per_minute: 60, burst: 5}])

        {_rate, _now, taken} =
          Enum.reduce(steps, {Rate.new(), 0, []}, fn step, {rate, now, taken} ->
            now = now + step

            case Rate.take(rate, policy, "s", "v", "arm", now) do
              {:ok, rate} -> {rate, now, [now | taken]}
              {:deny, :rate, _text} -> {rate, now, taken}
            end
          end)

        Enum.all?(taken, fn from ->
          within = Enum.count(taken, &(&1 >= from and &1 < from + 10 * @second))
          within <= 15
        end)
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 200]) == true, inspect(:proper.counterexample())
  end
end
