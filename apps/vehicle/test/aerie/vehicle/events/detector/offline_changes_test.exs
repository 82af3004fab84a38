defmodule Aerie.Vehicle.Events.Detector.OfflineChangesTest do
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.Events.Detector
  alias Aerie.Vehicle.Events.Detector.Observation

  @minute 60_000_000
  @since 1_795_213_361_000_000

  defp detector(found),
    do: %{id: "V", battery_low: 0.2, battery_critical: 0.1} |> Detector.new() |> Detector.remember(found)

  defp run(found, digests, after_us \\ @minute) do
    {_detector, events} =
      Enum.reduce(digests, {detector(found), []}, fn digest, {detector, events} ->
        {detector, new, %{}} =
          Detector.observe(detector, Observation.new(:state, @since + after_us, nil, digest))

        {detector, events ++ new}
      end)

    for event <- events, do: {event.type, Map.drop(event.data, ["since", "mode"])}
  end

  defp flying, do: %{mode: "AUTO", armed: true, in_air: true, since: @since}

  test "what changed while the gateway was not running is reported once, as found, in the natural order" do
    here = %{mode: "LAND", armed: false, in_air: false}

    assert run(flying(), [here, here]) == [
             {"mode_change", %{"from" => "AUTO", "to" => "LAND", "found" => true}},
             {"landed", %{"found" => true}},
             {"disarmed", %{"found" => true}}
           ]

    assert run(Map.put(here, :since, @since), [%{mode: "LAND", armed: true, in_air: true}]) == [
             {"armed", %{"found" => true}},
             {"takeoff", %{"found" => true}}
           ]
  end

  test "the event has the last time of the old value" do
    observation = Observation.new(:state, @since + @minute, nil, %{armed: false})
    {_, [event], _} = %{armed: true, since: @since} |> detector() |> Detector.observe(observation)
    assert event.data["since"] == "2026-11-20T22:22:41.000Z"
    assert event.seq == 1
  end

  test "an unchanged value gives no event, and later changes are normal events" do
    here = %{mode: "AUTO", armed: true, in_air: true}

    assert run(flying(), [here, %{here | mode: "RTL"}]) == [
             {"mode_change", %{"from" => "AUTO", "to" => "RTL"}}
           ]
  end

  test "a value is compared when it is first known, and is not false before that" do
    here = %{mode: "AUTO", armed: true, in_air: nil}
    assert run(flying(), [here, %{in_air: true}]) == []
    assert run(flying(), [here, %{in_air: false}]) == [{"landed", %{"found" => true}}]
    assert run(%{armed: true, since: @since}, [%{mode: "AUTO", armed: true, in_air: false}]) == []
  end

  test "a mode whose name is not known yet may be the same one" do
    assert run(%{mode: "Orbit", since: @since}, [%{mode: "EXTERNAL1"}]) == []
    assert run(%{mode: "Orbit", since: @since}, [%{mode: "MODE(42)"}]) == []
    assert [{"mode_change", _}] = run(%{mode: "Orbit", since: @since}, [%{mode: "AUTO"}])
  end

  test "no event without a stored value, or from one that is too old or in the future" do
    here = %{mode: "LAND", armed: false, in_air: false}
    assert run(nil, [here]) == []
    assert run(flying(), [here], 61 * @minute) == []
    assert run(flying(), [here], -@minute) == []
  end
end
