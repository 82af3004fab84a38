defmodule Aerie.Vehicle.Events.Detector.ConditionsTest do
  @moduledoc "What is wrong with a vehicle ends by its state. Each alarm of the table has a case here."
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.{Event, Options}
  alias Aerie.Vehicle.Events.Detector
  alias Aerie.Vehicle.Events.Detector.Observation

  @second 1_000_000
  @flying %{
    mode: "GUIDED",
    armed: true,
    in_air: true,
    failsafe: false,
    remaining: 0.9,
    system_status: "ACTIVE"
  }
  @parked %{@flying | armed: false, in_air: false, system_status: "STANDBY"}

  defp new, do: Detector.new(Options.new(Aerie.Vehicle.Settings.from(%{}), {"main", 1}))

  defp see(detector \\ new(), observations) do
    Enum.flat_map_reduce(observations, detector, fn {at, kind, data}, detector ->
      {detector, events, _params} =
        Detector.observe(detector, Observation.new(kind, at * @second, 1000, data))

      {events, detector}
    end)
  end

  defp flying(at, changes \\ []), do: {at, :state, Map.merge(@flying, Map.new(changes))}
  defp parked(at, changes \\ []), do: {at, :state, Map.merge(@parked, Map.new(changes))}
  defp text(at, text), do: {at, :text, %{severity: 2, text: text}}
  defp types(events), do: for(%{type: type} <- events, type != "statustext", do: type)
  defp held(detector), do: for(condition <- detector.conditions, do: condition.type)

  # What begins each, and then ways by which the state ends it: no text or report says that it is over.
  @cases %{
    "failsafe" => [
      {[flying: [0], flying: [1, [failsafe: true]], settle: [4]], [flying: [5]]},
      # The vehicle's status never showed it; the text that it is over was lost.
      {[flying: [0], text: [1, "Radio Failsafe"], settle: [4]], [parked: [60]]},
      {[parked: [0], text: [1, "Throttle failsafe on"], settle: [4]], []}
    ],
    "geofence" => [
      {[flying: [0, [fence_breach: false]], flying: [1, [fence_breach: true]]],
       [flying: [2, [fence_breach: false]]]},
      {[flying: [0], text: [1, "Fence breached"]], [parked: [60]]},
      {[flying: [0], text: [1, "Fence breached"]], [flying: [60, [fence_breach: false]]]}
    ],
    "battery.low" => [
      {[flying: [0], flying: [1, [remaining: 0.2]]], [flying: [2, [remaining: 0.94]]]},
      {[flying: [0], flying: [1, [charge_state: "LOW"]]], [flying: [2, [charge_state: "OK"]]]}
    ],
    "battery.critical" => [
      {[flying: [0], flying: [1, [remaining: 0.05]]], [flying: [2, [remaining: 0.94]]]},
      {[flying: [0], flying: [1, [charge_state: "CRITICAL"]]], [flying: [2, [charge_state: "OK"]]]}
    ],
    "rc.lost" => [
      {[flying: [0, [rc_receiver: true]], flying: [1, [rc_receiver: false]]],
       [flying: [2, [rc_receiver: true]]]},
      # The receiver's bad health came in the gap, as did the text that it is back.
      {[flying: [0, [rc_receiver: true]], text: [1, "Radio Failsafe"]],
       [flying: [60, [rc_receiver: true, mode: "RTL"]]]}
    ],
    "gps.lost" => [
      {[flying: [0, [gps: "OK"]], flying: [1, [gps: "NO_FIX"]]], [flying: [2, [gps: "OK"]]]},
      {[flying: [0, [gps: "OK"]], flying: [1, [gps: "NO_FIX"]]], [parked: [2, [gps: "NO_FIX"]]]}
    ],
    "position.lost" => [
      {[flying: [0, [position: true]], flying: [1, [position: false]]], [flying: [2, [position: true]]]},
      {[flying: [0, [position: true]], flying: [1, [position: false]]], [parked: [2, [position: false]]]}
    ],
    "kill_switch.engaged" => [
      {[flying: [0], text: [1, "Kill-switch engaged"], flying: [2, [system_status: "FLIGHT_TERMINATION"]]],
       [parked: [3]]},
      {[parked: [0], text: [1, "RC: Motor E-Stop HIGH"]], [parked: [60, [armed: true]]]},
      {[parked: [0, [armed: true]], text: [1, "RC: Motor E-Stop HIGH"]], [flying: [60]]}
    ],
    "gcs.lost" => [
      {[
         flying: [0],
         gcs: [1, {:lost, %{system: 255, timeout_s: 5, enabled: true}}]
       ], [gcs: [2, {:back, %{system: 255}}]]}
    ]
  }

  defp observation({:flying, arguments}), do: apply(&flying/2, Enum.take(arguments ++ [[]], 2))
  defp observation({:parked, arguments}), do: apply(&parked/2, Enum.take(arguments ++ [[]], 2))
  defp observation({:text, [at, text]}), do: text(at, text)
  defp observation({:settle, [at]}), do: {at, :settle, nil}
  defp observation({:gcs, [at, data]}), do: {at, :gcs, data}

  test "each alarm that an event begins has an event that ends it, says what else does, and ends by the state" do
    rows = Event.Types.all()
    begun = for %{begins: {_kind, _severity, _text}} = row <- rows, do: row
    assert Enum.sort(for(row <- begun, do: row.type)) == Enum.sort(Map.keys(@cases))

    for %{begins: {kind, _severity, _text}} = row <- begun do
      assert Enum.any?(rows, &(&1.ends == kind)), "no event ends #{row.type}"
      assert is_binary(row.over), "#{row.type} does not say what else ends it"

      for {begins, ends} <- @cases[row.type] do
        {events, detector} = begins |> Enum.map(&observation/1) |> see_all(new())
        assert row.type in types(events), "#{row.type} did not begin: #{inspect(begins)}"
        if ends != [], do: assert(row.type in held(detector))
        {_events, detector} = ends |> Enum.map(&observation/1) |> see_all(detector)
        refute row.type in held(detector), "#{row.type} goes on after #{inspect(ends)}"
      end
    end
  end

  defp see_all(observations, detector), do: see(detector, observations)

  test "a condition knows since when it holds, and what its event said" do
    {[_low, event], detector} = see([flying(0), flying(7, remaining: 0.05)])
    assert [%{type: "battery.critical", since: 7_000_000, subject: nil, data: data}] = detector.conditions
    assert Map.take(data, Map.keys(event.data)) == event.data

    {_events, detector} = see([flying(0), flying(1, fence_breach: true, fence_breach_type: "MAXALT")])
    assert [%{type: "geofence", data: %{"breach" => "MAXALT"}}] = detector.conditions
  end

  test "after a reboot nothing of the flight before goes on" do
    {_events, detector} =
      see([
        flying(0, gps: "OK", position: true),
        flying(1, gps: "NO_FIX", position: false, failsafe: true),
        text(2, "RC: Motor E-Stop HIGH"),
        text(3, "Radio Failsafe"),
        {8, :reboot, nil},
        parked(9, gps: "NO_FIX", position: false)
      ])

    assert held(detector) == []
  end

  describe "batteries" do
    defp two(at, first, other),
      do:
        flying(at,
          battery: 0,
          remaining: first,
          charge_state: "OK",
          batteries: [%{id: 1, remaining: other, charge_state: "OK"}]
        )

    defp levels(detector),
      do: for(%{type: "battery." <> level} = one <- detector.conditions, do: {one.subject, level})

    test "one of two recovers, the other does not" do
      {_events, detector} = see([two(0, 0.9, 0.9), two(1, 0.2, 0.05)])
      assert levels(detector) == [{nil, "low"}, {1, "critical"}]
      {[event], detector} = see(detector, [two(2, 0.8, 0.05)])
      assert %{type: "battery.recovered", data: %{"battery" => 0, "level" => "ok", "duration" => 1.0}} = event
      assert levels(detector) == [{1, "critical"}]
      {[%{data: %{"battery" => 1, "level" => "low"}}], detector} = see(detector, [two(3, 0.8, 0.2)])
      assert levels(detector) == [{1, "low"}]
    end

    test "one that is taken out ends with itself" do
      {_events, detector} = see([two(0, 0.9, 0.05), flying(1, battery: 0, remaining: 0.9, batteries: [])])
      assert levels(detector) == []
      {events, detector} = see([two(0, 0.05, 0.9), flying(1, battery: 1, remaining: 0.9, batteries: [])])
      assert %{"battery" => 0, "level" => "gone", "remaining" => nil} = List.last(events).data
      assert levels(detector) == []
    end

    test "a percentage that jitters around a limit is one alarm" do
      {events, detector} =
        see([
          flying(0)
          | for(at <- 1..200, do: flying(at, remaining: Enum.at([0.24, 0.26, 0.25, 0.29], rem(at, 4))))
        ])

      assert types(events) == ["battery.low"]
      assert levels(detector) == [{nil, "low"}]
    end

    test "a charge that is not known any more ends nothing, and the vehicle's word counts beside it" do
      {events, detector} =
        see([flying(0), flying(1, battery: 0, remaining: 0.05), flying(2, battery: 0, remaining: :unknown)])

      assert types(events) == ~w(battery.low battery.critical)
      assert [%{data: %{"remaining" => nil, "said" => nil}}] = detector.conditions

      {[recovered], detector} =
        see(detector, [flying(3, battery: 0, remaining: :unknown, charge_state: "OK")])

      assert %{type: "battery.recovered"} = recovered
      assert detector.conditions == []
      {_events, detector} = see(detector, [flying(4, battery: 0, remaining: 0.94, charge_state: "CRITICAL")])
      assert [%{data: %{"remaining" => 0.94, "said" => "CRITICAL"}}] = detector.conditions
    end

    test "the same battery by another message is the same alarm" do
      {events, detector} = see([flying(0, battery: :unknown, remaining: 0.2)])
      assert types(events) == ["battery.low"]
      {[], detector} = see(detector, [flying(1, battery: 0, remaining: 0.2, charge_state: "UNKNOWN")])
      {[], detector} = see(detector, [flying(2, battery: :unknown, remaining: 0.2)])
      assert levels(detector) == [{nil, "low"}]
    end
  end

  describe "failsafes" do
    test "two about the battery end each by itself" do
      enter = fn at, cause ->
        {at, :px4_report, %{name: "commander_failsafe_enter", values: ["mode", "rtl", cause], where: nil}}
      end

      {_events, detector} =
        see([
          flying(0),
          enter.(1, "low_battery_level"),
          enter.(9, "critical_battery_level"),
          flying(10, failsafe: true)
        ])

      assert [{"battery", "critical_battery_level"}, {"battery", "low_battery_level"}] =
               Enum.sort(for(%{type: "failsafe"} = one <- detector.conditions, do: one.subject))
    end

    test "one that was told of a parked vehicle is over when it is armed, and one about the new flight is not" do
      {_events, detector} = see([parked(0), text(1, "Throttle failsafe on"), {4, :settle, nil}])
      {events, detector} = see(detector, [flying(60)])
      assert "failsafe.cleared" in types(events)
      assert held(detector) -- ["rc.lost"] == []
    end
  end

  test "the fence's own failsafe goes with a fence that only texts report" do
    {events, detector} =
      see([flying(0), text(1, "Fence breached"), flying(2, mode: "RTL"), {5, :settle, nil}])

    assert ["fence"] = for(%{type: "failsafe"} = event <- events, do: event.data["type"])
    {_events, detector} = see(detector, [parked(60)])
    assert held(detector) == []
  end
end
