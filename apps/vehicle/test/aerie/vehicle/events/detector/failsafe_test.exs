defmodule Aerie.Vehicle.Events.Detector.FailsafeTest do
  @moduledoc "Failsafes, losses and the reasons of arming in the detector."
  use ExUnit.Case, async: true

  import Aerie.Flight, only: [frame: 2, frame: 3, run: 1]

  alias Aerie.Base.Json
  alias Aerie.Vehicle.Options
  alias Aerie.Vehicle.Events.Detector
  alias Aerie.Vehicle.State.Fields
  alias Aerie.Vehicle.Events.Detector.{Observation, StatusTexts}
  alias MavCodec.Messages, as: M

  @second 1_000_000
  @flying %{mode: "GUIDED", armed: true, in_air: true, failsafe: false, system_status: "ACTIVE"}

  # {seconds, what}: a list is a change of the state, a text a status text, a tuple a report, :settle the end of the wait.
  defp events(story) do
    story = [{0, []} | story]

    {events, _} =
      Enum.flat_map_reduce(
        story,
        Detector.new(Options.new(Aerie.Vehicle.Settings.from(%{}), {"main", 1})),
        fn {seconds, what}, detector ->
          {detector, events, _params} =
            Detector.observe(detector, observation(round(seconds * @second), what))

          {events, detector}
        end
      )

    for event <- events, event.type not in ~w(statustext mode_change), do: {event.time / @second, event}
  end

  defp observation(at, changes) when is_list(changes),
    do: Observation.new(:state, at, nil, Map.merge(@flying, Map.new(changes)))

  defp observation(at, text) when is_binary(text),
    do: Observation.new(:text, at, nil, %{severity: 4, text: text})

  defp observation(at, :settle), do: Observation.new(:settle, at, nil)
  defp observation(at, {:param, name, value}), do: Observation.new(:params, at, nil, [{name, value, nil}])
  defp observation(at, {:reached, seq}), do: Observation.new(:reached, at, nil, seq)
  defp observation(at, :reboot), do: Observation.new(:reboot, at, 1000)

  defp observation(at, {:late_report, late_s}),
    do: Observation.new(:report, at - late_s * @second, nil, %{"severity" => 6}, at)

  defp observation(at, {name, values}),
    do: Observation.new(:px4_report, at, nil, %{name: name, values: values, where: nil})

  defp types(story), do: for({_at, event} <- events(story), do: event.type)
  defp failsafes(story), do: for({at, %{type: "failsafe", data: data}} <- events(story), do: {at, data})

  describe "a failsafe" do
    test "that is active at first has found: true" do
      detector = Detector.new(Options.new(Aerie.Vehicle.Settings.from(%{}), {"main", 1}))
      {detector, [], _} = Detector.observe(detector, observation(0, failsafe: true, mode: "RTL"))
      {_detector, [event], _} = Detector.observe(detector, observation(@second, :settle))
      assert %{type: "failsafe", time: 0, data: data} = event
      assert %{"found" => true, "type" => "unknown", "action" => nil, "mode" => "RTL"} = data
    end

    test "by a report whose arguments are not as in Aerie's own file harms nothing" do
      odd = [[], [1], [1, nil], [1, ["a"], ["b"]], [1, 2.5, "soon", 7], ["x", "y", ["z"]]]

      for name <-
            ~w(commander_failsafe_enter commander_failsafe_enter_hold commander_failsafe_enter_generic_hold
                     commander_failsafe_enter_generic commander_armed_by commander_rc_lost),
          values <- odd do
        assert is_list(events([{1, {name, values}}, {2, [failsafe: true]}, {4, :settle}]))
      end
    end

    test "by the heartbeat alone waits a second for its cause, then its cause is unknown" do
      assert failsafes([{1, [failsafe: true]}]) == []

      assert [{1.0, %{"type" => "unknown", "action" => "none"} = data}] =
               failsafes([{1, [failsafe: true]}, {2, :settle}])

      refute is_map_key(data, "found")
    end

    test "by the heartbeat takes its cause from the text after it, and its time from the heartbeat" do
      assert [{1.0, %{"type" => "rc", "action" => "land", "text" => "Radio Failsafe"}}] =
               failsafes([{1, [failsafe: true, mode: "LAND"]}, {1.01, "Radio Failsafe"}])
    end

    test "goes on waiting when a report comes that tells what was an hour ago" do
      story = [
        {5000, [failsafe: true, mode: "LAND"]},
        {5000.1, {:late_report, 3000}},
        {5000.2, "Radio Failsafe"}
      ]

      assert [{5000.0, %{"type" => "rc", "action" => "land", "text" => "Radio Failsafe"}}] = failsafes(story)
    end

    test "during another one is shown by its text, and by the mode that it forces" do
      latched = [failsafe: true, system_status: "CRITICAL"]

      assert [{1.0, %{"type" => "battery", "action" => "none"}}, {5.5, %{"type" => "rc", "action" => "rtl"}}] =
               failsafes([
                 {1, "Battery Failsafe"},
                 {1.1, latched},
                 {2.2, :settle},
                 {5, [mode: "RTL"] ++ latched},
                 {5.5, "Radio Failsafe"}
               ])
    end

    test "ends for itself, and all end when the status is normal" do
      story = [
        {1, "Battery Failsafe"},
        {1.1, [failsafe: true, mode: "RTL"]},
        {3, "Radio Failsafe"},
        {4.1, :settle},
        {6, "Radio Failsafe Cleared"},
        {9, []}
      ]

      cleared = for {at, %{type: "failsafe.cleared", data: data}} <- events(story), do: {at, data}

      assert [
               {6.0, %{"type" => "rc", "duration" => 3.0, "by" => "text"}},
               {9.0, %{"type" => "battery", "duration" => 8.0, "by" => "status"}}
             ] = cleared
    end

    test "that the status never showed ends with disarming, and any with a reboot" do
      assert types([{1, "Radio Failsafe"}, {2, :settle}, {8, [armed: false, in_air: false]}]) ==
               ~w(rc.lost failsafe landed disarmed failsafe.cleared)

      assert types([{1, "Radio Failsafe"}, {1.1, [failsafe: true]}, {3, :reboot}]) ==
               ~w(rc.lost failsafe failsafe.cleared reboot)
    end

    test "with a delay is the same when PX4 acts; another cause is another one" do
      hold = {"commander_failsafe_enter_hold", [0, "rtl", 5, "gcs_connection_loss"]}
      enter = {"commander_failsafe_enter", [0, "rtl", "gcs_connection_loss"]}
      land = {"commander_failsafe_enter", [0, "land", "emergency_battery_level"]}

      assert [{1.0, %{"type" => "gcs", "action" => "rtl", "delay" => 5}}, {9.0, %{"type" => "battery"}}] =
               failsafes([{1, hold}, {1.5, [failsafe: true]}, {6, enter}, {6.5, [failsafe: true]}, {9, land}])
    end

    test "is not a warning" do
      assert types([{1, {"commander_failsafe_enter", [0, "warn", "low_battery_level"]}}]) == []
      assert types([{1, {"commander_failsafe_enter_low_bat", []}}, {2, :settle}]) == []
    end

    test "of a vehicle that sends reports is the report; its text is not a second one, whichever comes first" do
      hold = {"commander_failsafe_enter_hold", [0, "rtl", 5, "critical_battery_level"]}

      story = [
        {0.1, [fence_check: false]},
        {0.5, "Low battery"},
        {1, "Failsafe activated: entering Hold for 5 seconds"},
        {1.1, hold},
        {2, "Failsafe activated"},
        {4, :settle}
      ]

      assert [{1.1, %{"reason" => "critical_battery_level", "action" => "rtl", "delay" => 5}}] =
               failsafes(story)
    end

    test "is a mode that only the vehicle chooses" do
      assert [{1.0, %{"type" => "unknown", "action" => "descend"}}] =
               failsafes([{1, [mode: "AUTO_DESCEND"]}, {2, :settle}])

      assert [{1.0, %{"type" => "position", "action" => "descend"}}] =
               failsafes([
                 {0.5, [position: true]},
                 {1, [mode: "AUTO_DESCEND", position: false]},
                 {2, :settle}
               ])
    end

    test "is not a mode that a pilot chooses" do
      assert types([{1, [mode: "RTL"]}, {2, [mode: "LAND"]}, {4, :settle}]) == []
    end
  end

  test "PX4's report of the lost ground station counts; the text that it held back does not come again" do
    story = [
      {1, {"commander_gcs_lost", []}},
      {8, {"commander_dl_regained", []}},
      {8.1, "Connection to ground control station lost"},
      {20, {"commander_gcs_lost", []}}
    ]

    assert for({at, event} <- events(story), do: {at, event.type}) == [
             {1.0, "gcs_failsafe"},
             {20.0, "gcs_failsafe"}
           ]

    {_detector, [], _} = observe_late()
  end

  test "nor do the texts that PX4 held back about the kill switch and the remote control" do
    assert types([
             {0.1, [fence_check: false]},
             {1, {"commander_kill_sw_engaged", []}},
             {2, {"commander_kill_sw_disengaged", []}},
             {9, "Kill-switch engaged"},
             {9.1, "Kill-switch disengaged"}
           ]) == ~w(kill_switch.engaged kill_switch.released)

    assert types([
             {1, {"commander_rc_lost", []}},
             {4, {"commander_rc_regained", [3.0]}},
             {9, "Manual control lost"},
             {9.1, "Manual control regained"}
           ]) == ~w(rc.lost rc.restored)
  end

  defp observe_late do
    detector = Detector.new(Options.new(Aerie.Vehicle.Settings.from(%{}), {"main", 1}))
    {detector, [_], _} = Detector.observe(detector, observation(0, {"commander_gcs_lost", []}))
    Detector.observe(detector, observation(8 * @second, "Connection to ground control station lost"))
  end

  describe "losses" do
    test "remote control, by report, text or the receiver's state: once, with the duration" do
      for {lost, back} <- [
            {{"commander_rc_lost", []}, {"commander_rc_regained", [3.0]}},
            {"Manual control lost", "Manual control regained"},
            {[rc_receiver: false], [rc_receiver: true]}
          ] do
        story = [
          {1, [rc_receiver: true]},
          {2, lost},
          {2.1, [rc_receiver: false]},
          {5, back},
          {5.1, [rc_receiver: true]}
        ]

        assert [{2.0, %{type: "rc.lost"}}, {5.0, %{type: "rc.restored", data: data}}] = events(story)
        assert data["duration"] == 3.0
      end

      # A receiver that was never present is not lost.
      assert types([{1, [rc_receiver: false]}]) == []
      assert types([{1, "PreArm: Radio failsafe on"}, {3, :settle}]) == []
    end

    test "GNSS and position of an armed vehicle" do
      story = [
        {1, [gps: "OK", position: true]},
        {2, [gps: "NO_FIX"]},
        {3, [position: false]},
        {6, [position: true, gps: "2D_FIX"]},
        {7, [gps: "OK"]}
      ]

      assert for({at, e} <- events(story), do: {at, e.type, e.data["duration"]}) == [
               {2.0, "gps.lost", nil},
               {3.0, "position.lost", nil},
               {6.0, "position.restored", 3.0},
               {7.0, "gps.restored", 5.0}
             ]

      assert types([
               {1, [gps: "OK", armed: false, in_air: false]},
               {2, [gps: "NO_FIX", armed: false, in_air: false]}
             ]) ==
               ~w(landed disarmed)
    end

    test "the kill switch" do
      assert types([
               {1, {"commander_kill_sw_engaged", []}},
               {1.1, "Kill switch engaged"},
               {2, {"commander_kill_sw_disengaged", []}}
             ]) ==
               ~w(kill_switch.engaged kill_switch.released)

      assert types([{1, "RC7: MotorEStop HIGH"}, {2, "RC7: MotorEStop LOW"}]) ==
               ~w(kill_switch.engaged kill_switch.released)
    end

    test "fence: PX4's check, and a fence of ArduPilot that is disabled" do
      check = {"MAX_ALT", "check_gf_violation_max_alt"}

      assert [{1.0, %{type: "geofence"}}, {4.0, %{type: "geofence.cleared", data: data}}] =
               events([{1, [fence_check: check]}, {4, [fence_check: false]}])

      assert data == %{"breach" => "MAX_ALT", "duration" => 3.0}

      assert types([
               {0.1, {:param, "FENCE_ENABLE", 1}},
               {1, [fence_breach: true, fence_breach_type: "MAXALT"]},
               {3, {:param, "FENCE_ENABLE", 0}}
             ]) == ~w(geofence geofence.cleared)
    end
  end

  test "a rejected plan is not a broken fence; PX4 1.18's words for a broken one are" do
    for complaint <- ["Geofence violation for waypoint 19", "Mission rejected: Geofence violation"] do
      assert types([{1, complaint}]) == []
      assert StatusTexts.failsafe(complaint) == nil
    end

    assert types([{1, "Geofence: exceeding maximum distance to Home"}]) == ["geofence"]
    assert StatusTexts.failsafe("Geofence: exceeding maximum distance to Home") == "fence"
  end

  test "who armed and disarmed, if the vehicle says so" do
    reasons = fn story ->
      for {_at, e} <- events([{0.1, [armed: false, in_air: false]} | story]), do: e.data["reason"]
    end

    assert reasons.([{1, {"commander_armed_by", ["rc_switch"]}}, {2, [in_air: false]}]) |> List.last() ==
             "rc_switch"

    assert reasons.([{1, "Armed by external command"}, {2, [in_air: false]}]) |> List.last() ==
             "command_external"

    # Long ago, or about the other.
    assert reasons.([{1, {"commander_armed_by", ["rc_switch"]}}, {9, [in_air: false]}]) |> List.last() == nil
    assert reasons.([{1, {"commander_disarmed_by", ["landing"]}}, {2, [in_air: false]}]) |> List.last() == nil
  end

  describe "a mission that ends with its landing" do
    @auto [mode: "AUTO", mission_seq: 4, mission_total: 4, mission_state: "ACTIVE"]

    test "is completed, marked as inferred, when the vehicle has landed and disarmed at its last item" do
      story = [
        {1, @auto},
        {2, {:reached, 3}},
        {9, @auto ++ [in_air: false]},
        {11, @auto ++ [in_air: false, armed: false]}
      ]

      assert types(story) == ~w(mission.reached landed mission.completed disarmed)

      assert [%{"seq" => 4, "total" => 4, "inferred" => true}] =
               for({_at, %{type: "mission.completed", data: data}} <- events(story), do: data)
    end

    test "also if ArduPilot resets it before its heartbeat shows that it is disarmed" do
      over = Keyword.merge(@auto, in_air: false, mission_seq: 0)

      story = [
        {1, @auto},
        {2, {:reached, 4}},
        {9, @auto ++ [in_air: false]},
        {10, over},
        {11, over ++ [armed: false]}
      ]

      assert "mission.completed" in types(story)
      # It went from its last item to an earlier one.
      back = [
        {1, @auto},
        {2, {:reached, 3}},
        {3, Keyword.put(@auto, :mission_seq, 1)},
        {10, over},
        {11, over ++ [armed: false]}
      ]

      refute "mission.completed" in types(back)
    end

    test "is not completed by disarming earlier or in another mode, nor again after the vehicle said so" do
      ends = fn changes -> {11, Keyword.merge(@auto, [in_air: false, armed: false] ++ changes)} end
      refute "mission.completed" in types([{1, @auto}, {2, {:reached, 1}}, ends.(mission_seq: 2)])
      refute "mission.completed" in types([{1, @auto}, {2, {:reached, 3}}, ends.(mode: "LAND")])
      refute "mission.completed" in types([{1, @auto}, ends.([])])
      said = [{1, @auto}, {2, {:reached, 3}}, {3, "Mission Complete"}, ends.([])]
      assert Enum.count(types(said), &(&1 == "mission.completed")) == 1
    end

    test "is not completed by disarming in the air, nor at the item before the last" do
      ends = Keyword.merge(@auto, in_air: false, armed: false)
      # Without EXTENDED_SYS_STATE, whatever is not armed is not in the air.
      refute "mission.completed" in types([{1, @auto}, {2, {:reached, 3}}, {11, ends}])

      before = Keyword.put(@auto, :mission_seq, 3)
      landed = [{9, before ++ [in_air: false]}, {11, Keyword.put(ends, :mission_seq, 3)}]
      refute "mission.completed" in types([{1, before}, {2, {:reached, 2}} | landed])
      # It was reached, and only a command that needs no flight follows.
      assert "mission.completed" in types([{1, before}, {2, {:reached, 3}} | landed])
    end
  end

  describe "whatever comes" do
    @texts [
      "Radio Failsafe",
      "Radio Failsafe Cleared",
      "Battery Failsafe",
      "Failsafe activated",
      "Failsafe off",
      "Kill switch engaged",
      "Kill switch disengaged",
      "Manual control lost",
      "Manual control regained",
      "hello"
    ]
    @reports for enter <- ["commander_failsafe_enter"],
                 action <- ~w(warn rtl land),
                 cause <- ["generic", "manual_control_loss", 77],
                 do: {enter, [0, action, cause]}
    @others [
      {"commander_failsafe_enter_hold", [0, 99, 2, "generic"]},
      {"commander_failsafe_enter_autopilot_disengaged", [0, "descend"]},
      {"commander_failsafe_enter", nil},
      {"commander_gcs_lost", []},
      {"commander_dl_regained", []},
      {"commander_rc_lost", []},
      {"commander_rc_regained", [1.0]},
      {"commander_kill_sw_engaged", []},
      {"failsafe_rc_override", []},
      {"commander_armed_by", ["rc_switch"]},
      {"commander_armed_by", []},
      :settle,
      :reboot,
      {:param, "FENCE_ENABLE", 0},
      {:reached, 3}
    ]

    defp any_state do
      value = fn values -> :proper_types.elements(values) end

      :proper_types.list(
        :proper_types.oneof([
          {:failsafe, value.([true, false, nil])},
          {:armed, value.([true, false])},
          {:in_air, value.([true, false])},
          {:mode, value.(["AUTO", "RTL", "AUTO_DESCEND", nil])},
          {:gps, value.(["OK", "NO_FIX"])},
          {:position, value.([true, false])},
          {:rc_receiver, value.([true, false])},
          {:fence_breach, value.([true, false])},
          {:fence_check, value.([false, {"MAX_ALT", "check_gf_violation_max_alt"}])},
          {:mission_seq, value.([0, 3])},
          {:mission_total, value.([3])}
        ])
      )
    end

    defp alternate?(types, a, b) do
      types
      |> Enum.filter(&(&1 in [a, b]))
      |> Enum.chunk_every(2, 1, :discard)
      |> Enum.all?(fn [x, y] -> x != y end)
    end

    test "losses and their ends alternate, no failsafe ends that did not begin, and every event can be published" do
      what = :proper_types.oneof([any_state(), :proper_types.elements(@texts ++ @reports ++ @others)])

      property =
        :proper.forall(:proper_types.list(what), fn story ->
          events = story |> Enum.with_index(1) |> Enum.map(fn {what, n} -> {n * 0.4, what} end) |> events()
          types = for {_at, event} <- events, do: event.type
          for {_at, event} <- events, do: event |> Fields.event(nil) |> Json.encode!()
          begun = Enum.count(types, &(&1 == "failsafe"))

          Enum.count(types, &(&1 == "failsafe.cleared")) <= begun and
            (:reboot in story or
               (Enum.all?(~w(rc gps position), &alternate?(types, "#{&1}.lost", "#{&1}.restored")) and
                  alternate?(types, "kill_switch.engaged", "kill_switch.released")))
        end)

      assert :proper.quickcheck(property, [:quiet, numtests: 400]) == true, inspect(:proper.counterexample())
    end
  end

  test "a datagram that comes twice is one text; the same text with another sequence number is a second one" do
    beat = frame(%M.Heartbeat{type: 2, autopilot: 3, base_mode: 81, custom_mode: 4}, 0)
    text = fn at, seq -> frame(%M.Statustext{severity: 4, text: "twice"}, round(at * @second), seq: seq) end

    texts = fn frames ->
      for %{type: "statustext"} = event <- run([beat | frames]).events, do: event.time / @second
    end

    assert texts.([text.(1, 7), text.(1.01, 7), text.(1.5, 8)]) == [1.0, 1.5]
    # The number wrapped.
    assert texts.([text.(1, 7), text.(6, 7)]) == [1.0, 6.0]
  end
end
