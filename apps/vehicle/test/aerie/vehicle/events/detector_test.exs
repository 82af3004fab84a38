defmodule Aerie.Vehicle.Events.DetectorTest do
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.{Event, Options, State}
  alias Aerie.Vehicle.Events.Detector
  alias Aerie.Vehicle.Events.Detector.{Observation, StatusTexts}

  @second 1_000_000
  @ground %{mode: "STABILIZE", armed: false, in_air: false, failsafe: false, remaining: 0.9}

  defp new, do: Detector.new(Options.new(Aerie.Vehicle.Settings.from(%{}), {"main", 1}))

  # Observations with their times in seconds; the events as {type, data}.
  defp observe(observations, detector \\ new(), known \\ %{}) do
    {events, {detector, _known}} =
      Enum.map_reduce(observations, {detector, known}, fn observation, {detector, known} ->
        {detector, events, params} = Detector.observe(detector, observation, &Map.fetch(known, &1))
        {events, {detector, Map.merge(known, params)}}
      end)

    {List.flatten(events), detector}
  end

  defp types(observations, detector \\ new()) do
    {events, _detector} = observe(observations, detector)
    Enum.map(events, & &1.type)
  end

  defp state(seconds, changes),
    do: Observation.new(:state, round(seconds * @second), 1000, Map.merge(@ground, Map.new(changes)))

  defp text(seconds, text),
    do: Observation.new(:text, round(seconds * @second), 1000, %{severity: 4, text: text})

  defp settle(seconds), do: Observation.new(:settle, round(seconds * @second), 1000)

  defp without_texts(observations),
    do: types(observations) -- for(%{kind: :text} <- observations, do: "statustext")

  test "the first state is not an event" do
    assert types([state(0, armed: true, in_air: true, mode: "AUTO")]) == []
  end

  test "a whole flight: one event each, numbered, with the times of their sources" do
    {events, _} =
      observe([
        state(0, []),
        state(1, mode: "GUIDED"),
        state(2, mode: "GUIDED", armed: true),
        state(3, mode: "GUIDED", armed: true, in_air: true),
        state(3, mode: "GUIDED", armed: true, in_air: true),
        state(4, mode: "GUIDED", armed: true),
        state(5, mode: "STABILIZE")
      ])

    assert Enum.map(events, &{&1.seq, &1.type, div(&1.time, @second)}) == [
             {1, "mode_change", 1},
             {2, "armed", 2},
             {3, "takeoff", 3},
             {4, "landed", 4},
             {5, "mode_change", 5},
             {6, "disarmed", 5}
           ]

    assert hd(events).data == %{"from" => "STABILIZE", "to" => "GUIDED"}
    assert hd(events).vehicle_time_ms == 1000
    assert Enum.all?(events, &(&1.vehicle == "VID-001"))
  end

  test "a value that becomes known or unknown is not an event" do
    assert types([
             state(0, armed: nil, in_air: nil),
             state(1, armed: true, in_air: true),
             state(2, armed: nil, in_air: nil)
           ]) == []

    assert types([state(0, armed: true), state(1, armed: nil), state(2, armed: false)]) == ["disarmed"]
  end

  test "an event has the position" do
    where = %{"lat" => 47.4, "lon" => 8.5, "alt_msl" => 500.0, "alt_rel" => 0.0}
    {[event], _} = observe([state(0, []), state(1, armed: true, where: where)])
    assert event.data["position"] == where
  end

  describe "failsafe" do
    test "with the reason that was named just before" do
      {events, _} =
        observe([
          state(0, armed: true),
          text(1, "Radio Failsafe - RTL"),
          state(2, armed: true, failsafe: true)
        ])

      assert [%{type: "statustext"}, %{type: "rc.lost"}, %{type: "failsafe", data: data}] = events
      assert %{"type" => "rc", "reason" => "rc", "text" => "Radio Failsafe - RTL"} = data
    end

    test "an old reason does not count; a general text does not replace a reason" do
      {events, _} = observe([state(0, []), text(1, "Battery low"), state(9, failsafe: true), settle(10)])
      assert List.last(events).data["reason"] == "unknown"

      {events, _} =
        observe([
          state(0, []),
          text(1, "Low battery"),
          text(2, "Failsafe activated"),
          state(3, failsafe: true),
          settle(4)
        ])

      assert %{"type" => "battery", "reason" => "low_battery_level"} = List.last(events).data
    end

    test "each one is an event, its staying is not" do
      assert types([
               state(0, []),
               state(1, failsafe: true),
               state(2, failsafe: true, mode: "RTL"),
               state(3, [])
             ]) ==
               ~w(failsafe mode_change mode_change failsafe.cleared)
    end
  end

  describe "battery" do
    test "low and critical by charge, with hysteresis" do
      at = fn remaining -> state(0, remaining: remaining) end
      assert types(Enum.map([0.3, 0.25, 0.26, 0.24, 0.29, 0.2], at)) == ["battery.low"]

      assert types(Enum.map([0.3, 0.25, 0.31, 0.25], at)) ==
               ["battery.low", "battery.recovered", "battery.low"]

      assert types(Enum.map([0.3, 0.2, 0.1, 0.12, 0.09], at)) == ["battery.low", "battery.critical"]
      assert types(Enum.map([0.3, 0.05], at)) == ["battery.low", "battery.critical"]

      assert types(Enum.map([0.3, 0.05, 0.2, 0.05], at)) ==
               ~w(battery.low battery.critical battery.recovered battery.critical)
    end

    test "by the charge state" do
      assert types([state(0, charge_state: "OK"), state(1, charge_state: "LOW")]) == ["battery.low"]

      assert types([
               state(0, charge_state: "OK"),
               state(1, charge_state: "EMERGENCY"),
               state(2, charge_state: "EMERGENCY")
             ]) ==
               ["battery.low", "battery.critical"]
    end

    test "each battery has its own events" do
      other = fn remaining ->
        [batteries: [%{id: 1, remaining: remaining, charge_state: "OK"}], battery: 0]
      end

      {events, _} =
        observe([state(0, other.(0.3)), state(1, other.(0.2)), state(2, [remaining: 0.2] ++ other.(0.2))])

      assert [{"battery.low", %{"battery" => 1}}, {"battery.low", %{"battery" => 0}}] =
               Enum.map(events, &{&1.type, &1.data})
    end

    test "a battery that is low at first is an event; one that is not measured is not" do
      assert types([state(0, remaining: 0.2)]) == ["battery.low"]
      assert types([state(0, remaining: nil), state(1, remaining: nil)]) == []
    end

    test "thresholds are configured" do
      options =
        Options.new(
          Aerie.Vehicle.Settings.from(%{events: %{battery_low: 0.5, battery_critical: 0.3}}),
          {"main", 1}
        )

      assert types([state(0, remaining: 0.45), state(1, remaining: 0.29)], Detector.new(options)) ==
               ["battery.low", "battery.critical"]
    end
  end

  describe "geofence" do
    test "by FENCE_STATUS, once per breach; its text is not a second event" do
      breach = [fence_breach: true, fence_breach_type: "BOUNDARY"]

      assert without_texts([
               state(0, fence_breach: false),
               state(1, breach),
               text(1, "Fence Breached"),
               state(2, breach),
               state(3, fence_breach: false),
               state(4, breach)
             ]) == ["geofence", "geofence.cleared", "geofence"]
    end

    test "by text without FENCE_STATUS, not again within ten seconds" do
      assert without_texts([state(0, []), text(1, "Geofence violation"), text(2, "Geofence violation")]) == [
               "geofence"
             ]

      assert without_texts([text(1, "Polygon fence breached"), text(30, "Polygon fence breached")]) ==
               ~w(geofence geofence)
    end

    test "a text just before the first FENCE_STATUS is the same breach" do
      assert without_texts([state(0, []), text(1, "Fence Breached"), state(2, fence_breach: true)]) == [
               "geofence"
             ]

      assert without_texts([state(0, []), state(2, fence_breach: true)]) == ["geofence"]
    end

    test "a complaint about a fence is not a breach" do
      for complaint <- [
            "PreArm: Polygon fence breached",
            "Geofence invalid, doesn't contain Home position",
            "Fence Indexed OK"
          ] do
        refute StatusTexts.fence?(complaint)
      end
    end
  end

  test "gcs_failsafe once until the ground station is back" do
    lost = text(1, "GCS Failsafe")

    assert without_texts([state(0, []), lost, lost, text(2, "GCS Failsafe Cleared"), lost]) == [
             "gcs_failsafe",
             "failsafe",
             "failsafe.cleared",
             "gcs_failsafe"
           ]

    assert without_texts([lost, state(1, []), state(2, failsafe: true), state(3, []), lost]) ==
             ["gcs_failsafe", "failsafe", "failsafe.cleared", "gcs_failsafe"]

    assert StatusTexts.gcs("Lost connection to GCS") == :lost
    assert StatusTexts.gcs("Connection to ground station lost") == :lost
    assert StatusTexts.gcs("Connection to ground control station regained") == :back
    assert StatusTexts.gcs("PreArm: GCS failsafe on") == nil
    assert StatusTexts.gcs("Arming motors") == nil
  end

  test "ArduPlane's words for the end: a ground station that is back is not lost, nor is the remote control" do
    lost = text(1, "GCS Failsafe On: switched to RTL")
    off = text(4, "GCS Failsafe Off")

    assert without_texts([state(0, []), lost, state(2, failsafe: true), state(3, []), off, settle(6)]) ==
             ["gcs_failsafe", "failsafe", "failsafe.cleared"]

    # Its status may stay critical for another reason.
    assert without_texts([state(0, []), lost, state(2, failsafe: true), off, text(9, "GCS Failsafe On")]) ==
             ["gcs_failsafe", "failsafe", "failsafe.cleared", "gcs_failsafe"]

    for {on, off} <- [
          {"RC Short Failsafe: switched to CIRCLE", "Short Failsafe Cleared"},
          {"RC Short Failsafe On", "RC Short Failsafe Cleared"},
          {"RC Long Failsafe On: switched to RTL", "RC Long Failsafe Cleared"},
          {"Long Failsafe On", "Long Failsafe Off"}
        ] do
      assert {StatusTexts.rc(on), StatusTexts.rc(off)} == {:lost, :back}, on
      assert {StatusTexts.activation(on), StatusTexts.activation(off)} == {{:begins, "rc"}, {:over, "rc"}}, on

      assert without_texts([state(0, []), text(1, on), text(4, off)]) ==
               ~w(rc.lost failsafe rc.restored failsafe.cleared)
    end
  end

  test "reasons that texts name" do
    for {text, reason} <- [
          {"Battery 1 is low 10.40V used 3100 mAh", "battery"},
          {"EKF Failsafe: changed to LAND Mode", "ekf"},
          {"Failsafe: Radio lost", "rc"},
          {"Manual control lost", "rc"},
          {"GCS Failsafe", "gcs"},
          {"Vibration compensation ON failsafe", "vibration"},
          {"Failsafe activated", "unknown"},
          {"PreArm: Radio failsafe on", nil},
          {"Arming denied: Resolve system health failures first", nil},
          {"Arming motors", nil}
        ] do
      assert StatusTexts.failsafe(text) == reason, text
    end
  end

  describe "mission" do
    defp mission(seconds, seq, state),
      do: state(seconds, mission_seq: seq, mission_total: 4, mission_state: state)

    defp reached(seconds, seq), do: Observation.new(:reached, round(seconds * @second), 1000, seq)

    test "an item that is reached without a mission does not count" do
      assert types([state(0, mode: "GUIDED"), reached(1, 0)]) == []
      assert types([state(0, mode: "HOLD", mission_total: 0), reached(1, 0)]) == []
      assert types([state(0, mode: "AUTO_MISSION", mission_total: 3), reached(1, 0)]) == ["mission.reached"]
    end

    test "PX4 repeats every second that an item is reached: one event; much later it is another one" do
      assert types([reached(0, 2), reached(1, 2), reached(2, 2), reached(3, 3), reached(60, 3)]) ==
               List.duplicate("mission.reached", 3)
    end

    test "completed once, at its end and not before" do
      assert types([
               mission(0, 0, "ACTIVE"),
               mission(1, 0, "COMPLETE"),
               mission(2, 0, "ACTIVE"),
               reached(3, 3),
               mission(4, 3, "COMPLETE"),
               mission(5, 3, "ACTIVE"),
               mission(6, 3, "COMPLETE")
             ]) == ["mission.reached", "mission.completed"]
    end

    test "completed again when it is flown again" do
      flight = fn t -> [mission(t, 1, "ACTIVE"), reached(t + 1, 3), mission(t + 2, 3, "COMPLETE")] end

      assert types(flight.(0) ++ flight.(10)) ==
               List.flatten(List.duplicate(["mission.reached", "mission.completed"], 2))
    end

    test "by text, and not a second time by state" do
      assert without_texts([
               mission(0, 4, "ACTIVE"),
               reached(1, 4),
               text(1, "Mission Complete"),
               mission(2, 4, "COMPLETE")
             ]) == ["mission.reached", "mission.completed"]

      assert StatusTexts.mission_completed?("Mission finished, loitering")
      refute StatusTexts.mission_completed?("Mission: 4 WP")
    end
  end

  test "statustext with the name of its severity" do
    {[event], _} = observe([Observation.new(:text, 5, nil, %{severity: 2, text: "Arming denied"})])
    assert event.data == %{"severity" => 2, "severity_name" => "CRITICAL", "text" => "Arming denied"}
    {[event], _} = observe([Observation.new(:text, 5, nil, %{severity: 99, text: "?"})])
    assert event.data["severity_name"] == "SEVERITY(99)"
  end

  test "parameters: a new one is learned, a changed one is an event, an unchanged one is nothing" do
    params = fn values -> Observation.new(:params, @second, 1, values) end

    {events, _} =
      observe([
        params.([{"A", 1, 0}, {"B", 2.5, 1}]),
        params.([{"A", 1, nil}]),
        params.([{"A", 7, nil}, {"A", 8, nil}, {"A", 8, nil}])
      ])

    assert Enum.map(events, & &1.data) == [
             %{"name" => "A", "from" => 1, "to" => 7, "index" => nil},
             %{"name" => "A", "from" => 7, "to" => 8, "index" => nil}
           ]
  end

  test "lost and restored alternate" do
    lost = Observation.new(:lost, 5 * @second, 1, 5 * @second)
    restored = Observation.new(:restored, 9 * @second, 2)
    assert types([restored, lost, lost, restored, restored, lost]) == ~w(link.lost link.restored link.lost)
    {[event | _], _} = observe([lost])
    assert event.data == %{"silent_s" => 5.0}
  end

  test "a reboot is one event, even if it is seen again after a crash; the next one is another event" do
    reboot = fn at, boot_ms -> Observation.new(:reboot, at * @second, boot_ms) end
    assert types([reboot.(100, 2000), reboot.(103, 5000), reboot.(200, 2000)]) == ["reboot", "reboot"]
  end

  test "a collision once while it lasts" do
    two = %{sign: "uid", links: [["a"], ["b"]]}
    collision = fn at -> Observation.new(:collision, at * @second, 1, two) end

    assert types([collision.(0), collision.(10), collision.(65), collision.(200)]) == [
             "collision",
             "collision"
           ]
  end

  test "every type of event is one that can be published and says what its fields mean" do
    assert Enum.uniq(Event.Types.names()) == Event.Types.names()
    assert Enum.all?(Event.Types.names(), &(&1 =~ ~r/\A[a-z_]+(\.[a-z_]+)?\z/))
    fields = for type <- Event.Types.all(), field <- type.fields, do: field

    assert Enum.all?(
             fields,
             &(&1.meaning != "" and &1.type in ~w(string number integer boolean list object any)a)
           )
  end

  test "a digest has no value that changes all the time" do
    refute Enum.any?(
             Map.keys(Detector.Digest.of(%State{})),
             &(&1 in [:lat, :lon, :voltage, :at, :time_boot_ms])
           )
  end

  describe "properties" do
    defp observation_gen do
      :proper_types.oneof([
        {:state, :proper_types.oneof([true, false, nil]), :proper_types.oneof([true, false, nil]),
         :proper_types.oneof(["A", "B", nil]), :proper_types.oneof([true, false])},
        :lost,
        :restored,
        {:reached, :proper_types.range(0, 3)},
        {:text, :proper_types.oneof(["hello", "GCS Failsafe", "Mission Complete"])}
      ])
    end

    defp real({:state, armed, in_air, mode, failsafe}, n) do
      digest = %{armed: armed, in_air: in_air, mode: mode, failsafe: failsafe}
      Observation.new(:state, n * 1000, n, digest)
    end

    defp real(:lost, n), do: Observation.new(:lost, n * 1000, n, 1000)
    defp real(:restored, n), do: Observation.new(:restored, n * 1000, n)
    defp real({:reached, seq}, n), do: Observation.new(:reached, n * 1000, n, seq)
    defp real({:text, text}, n), do: Observation.new(:text, n * 1000, n, %{severity: 6, text: text})

    defp alternate?(types, a, b) do
      types
      |> Enum.filter(&(&1 in [a, b]))
      |> Enum.chunk_every(2, 1, :discard)
      |> Enum.all?(fn [x, y] -> x != y end)
    end

    test "pairs alternate, numbers have no gap, ids are unique, and repeated observations give nothing" do
      prop =
        :proper.forall(:proper_types.list(observation_gen()), fn observations ->
          real =
            observations |> Enum.with_index(1) |> Enum.map(fn {observation, n} -> real(observation, n) end)

          {events, _} = observe(real)
          types = Enum.map(events, & &1.type)
          # Each state twice, as after a crash of the session.
          doubled = Enum.flat_map(real, fn o -> if o.kind == :state, do: [o, o], else: [o] end)
          {same, _} = observe(doubled)

          alternate?(types, "armed", "disarmed") and alternate?(types, "takeoff", "landed") and
            alternate?(types, "link.lost", "link.restored") and
            Enum.map(events, & &1.seq) == Enum.to_list(1..length(events)//1) and
            length(Enum.uniq_by(events, & &1.id)) == length(events) and same == events
        end)

      assert :proper.quickcheck(prop, [:quiet, numtests: 300]) == true, inspect(:proper.counterexample())
    end
  end
end
