defmodule Aerie.Vehicle.Services.ReportsTest do
  @moduledoc """
  EVENT messages (X3), with what PX4 1.17 sent in two recordings: `px4_refusals_reports` (what it refuses) and
  `px4_flight_reports`, the heartbeats, EVENTs and STATUSTEXTs of those recordings.
  """
  use ExUnit.Case, async: true

  import Aerie.Flight, only: [frame: 3, frames: 1, options: 1, pick: 2, run: 1, run: 2, step: 2]

  alias Aerie.Vehicle.State
  alias Aerie.Vehicle.Events.Detector
  alias Aerie.Vehicle.Session.Core
  alias Aerie.Vehicle.Services.Reports
  alias Aerie.Vehicle.Services.Reports.{Checks, Names}
  alias MavCodec.Messages, as: M

  @px4 %M.Heartbeat{type: 2, autopilot: 12, base_mode: 81, system_status: 3}
  @second 1_000_000

  # The ids of `priv/px4_events.json` with their names.
  @names for {space, component} <-
               JSON.decode!(File.read!(Application.app_dir(:vehicle, "priv/px4_events.json")))["components"],
             {id, event} <- component["events"],
             into: %{},
             do: {String.to_integer(space) * 0x1000000 + String.to_integer(id), event["name"]}

  describe "names" do
    test "an id is the namespace and the hash of the name" do
      # As PX4 1.17 sent them.
      assert Names.name(0x0102089D) == "commander_arm_denied_resolve_failures"
      assert Names.name(0x01414569) == "commander_takeoff_detected"
      assert Names.name(1103) == "cal_done"
      assert Names.name(0x02414569) == nil
      assert Names.name(0x01000001) == nil
    end

    test "all of PX4 1.18 and those that only 1.17 has are known" do
      assert map_size(@names) == 375
      assert Enum.all?(@names, fn {id, name} -> Names.name(id) == name end)
      assert Names.name(0x01A4B458) == "commander_gcs_lost"
      assert Names.name(id("commander_transition_denied")) == "commander_transition_denied"
    end

    test "arguments are read by their types: enums and bit fields by their labels" do
      hold = id("commander_failsafe_enter_hold")
      assert Names.values(hold, <<0, 0, 4, 3, 6, 2, 0, 2>>) == [50_593_792, "rtl", 2, "gcs_connection_loss"]
      # A value without a label stays a number; trailing zeros may be missing, and more bytes may follow.
      assert Names.values(hold, <<0, 0, 4, 3, 77>>) == [50_593_792, 77, 0, "generic"]
      assert Names.values(hold, <<0::320>>) == [0, "none", 0, "generic"]

      assert Names.values(id("check_modes_global_pos"), <<0x38, 0, 0, 0, 24>>) ==
               [["mission", "loiter", "rtl"], 24]

      assert Names.values(id("check_battery_low"), <<255, 255, 255, 255, 11>>) == [["all"], 11]
      assert Names.values(id("commander_rc_regained"), <<0, 0, 0xC0, 0x3F>>) == [1.5]
      assert Names.values(id("commander_rc_regained"), <<0, 0, 0xC0, 0x7F>>) == [nil]
      assert Names.values(id("vrtl_return_at"), <<0xF9, 1, 0, 0, 0xFF, 0xFF, 0xFF, 0xFF>>) == [505, -1]
    end

    test "an event without arguments has an empty list; one with an unknown layout has only its bytes" do
      assert Names.values(id("commander_gcs_lost"), <<0::320>>) == []
      assert Names.values(id("commander_transition_denied"), <<1, 2>>) == nil
      assert Names.values(0x02000001, <<1, 2>>) == nil
    end

    test "any bytes can be read" do
      property =
        :proper.forall({:proper_types.elements(Map.keys(@names)), :proper_types.binary()}, fn {id, bytes} ->
          is_list(Names.values(id, bytes)) or Names.values(id, "") == nil
        end)

      assert :proper.quickcheck(property, [:quiet, numtests: 500]) == true, inspect(:proper.counterexample())
    end

    test "no two names have the same id" do
      names = Map.values(@names)
      assert Enum.uniq(names) == names
    end
  end

  describe "recordings" do
    test "every event of PX4's flight also came as a text, and is shown once, as the text" do
      run = frames("px4_flight_reports") |> run()
      assert pick(run, ["report"]) == []
      texts = for {_, _, %{"text" => text}} <- pick(run, ["statustext"]), do: text
      assert "Armed by external command" in texts and "Disarmed by landing" in texts
      shown = Core.snapshot(run.core).reports
      assert shown.lost == 0

      assert %{
               id: "0x01F46777",
               name: "commander_disarmed_by",
               text: "Disarmed by landing",
               arguments: "06",
               severity: 6,
               sequence: 27
             } = hd(shown.recent)

      # Its text has two chunks and comes after it.
      assert Enum.any?(
               shown.recent,
               &match?(
                 %{name: "vrtl_return_at", text: "RTL: start return at 515 m (25 m above destination)"},
                 &1
               )
             )
    end

    test "a report without a text is an event, with both levels and its arguments" do
      run = frames("px4_refusals_reports") |> run()

      assert [{_, _, no_takeoff}, {_, _, far}] = pick(run, ["report"])

      assert no_takeoff == %{
               "id" => "0x0153D6E2",
               "name" => "navigator_mis_takeoff_missing",
               "severity" => 3,
               "severity_name" => "ERROR",
               "internal_severity" => 6,
               "arguments" => "",
               "values" => [],
               "component" => 1,
               "sequence" => 17
             }

      assert %{
               "name" => "navigator_mis_first_wp_far",
               "arguments" => "0e75",
               "values" => [29_966],
               "severity" => 4
             } = far
    end

    test "texts are held back while no ground station is there; events are not" do
      run = frames("px4_refusals_reports") |> Enum.reject(&(&1.id == 253)) |> run()
      names = for {_, _, data} <- pick(run, ["report"]), do: data["name"]
      assert "commander_arm_denied_resolve_failures" in names
      assert "commander_failsafe_enter_hold" in names
      assert Enum.count(names, &(&1 == "commander_armed_by")) == 2
    end

    test "the result is the same however the frames are cut into reads, and with all of them twice on two links" do
      frames = frames("px4_refusals_reports")
      once = frames |> run() |> pick(["report"])
      assert frames |> run(batch: 1) |> pick(["report"]) == once
      assert frames |> run(batch: 100) |> pick(["report"]) == once

      both = fn frames, run -> Enum.reduce(["a", "b"], run, &step(&2, {:frames, &1, frames})) end

      start = %{
        core: Core.new(options([])),
        detector: Detector.new(options([])),
        events: [],
        actions: [],
        params: %{}
      }

      twice = frames |> Enum.chunk_every(3) |> Enum.reduce(start, both)
      assert twice.events |> Enum.reverse() |> pick(["report"]) == once
    end

    test "what keeps the vehicle from being armed is one list, updated as it changes" do
      run = frames("px4_refusals_reports") |> run()

      lists =
        for {:publish, :health, %{data: %{arming_checks: [_ | _] = checks}}, _at} <- run.actions,
            do: Enum.map(checks, & &1.name)

      assert ["check_modes_local_pos", "check_modes_global_pos", "check_modes_mission" | _] = hd(lists)
      assert Enum.any?(lists, &("check_battery_critical" in &1))

      assert State.data(run.core.state, :health).arming_checks == [
               %{id: "0x0105C2D9", name: "check_modes_mission", severity: 6},
               %{id: "0x012F1DC7", name: "check_modes_offboard_signal", severity: 3},
               %{id: "0x0106ED29", name: "check_modes_manual_control", severity: 4}
             ]
    end

    test "lost events are requested, and shown when they come (X3)" do
      frames = frames("px4_refusals_reports")
      lost? = &match?(%{id: 410, payload: <<_::64, s::little-16, _::binary>>} when s in [17, 19], &1)
      {lost, heard} = Enum.split_with(frames, lost?)
      assert length(lost) == 2
      run = run(heard)
      requests = for {:send, %M.RequestEvent{} = request, 2} <- run.actions, do: request

      assert %M.RequestEvent{target_system: 1, target_component: 1, first_sequence: 17, last_sequence: 17} in requests
      assert length(requests) == 6
      assert Core.snapshot(run.core).reports.lost == 2
      assert pick(run, ["report"]) == []

      # The vehicle answers after half a second.
      answered =
        Enum.sort_by(heard ++ Enum.map(lost, &%{&1 | at: &1.at + 800_000}), & &1.at)

      assert for({_, _, data} <- answered |> run() |> pick(["report"]), do: data["sequence"]) == [17, 19]
    end

    test "nothing is requested if requests are disabled, and nothing by high-latency links (X6)" do
      heard = Enum.reject(frames("px4_refusals_reports"), &match?(%{id: 410}, &1))
      asked = fn run -> for {:send, %M.RequestEvent{}, _} <- run.actions, do: :asked end
      assert asked.(run(heard)) != []
      assert asked.(run(heard, request_streams: false)) == []

      start = %{
        core: Core.new(options([])),
        detector: Detector.new(options([])),
        events: [],
        actions: [],
        params: %{}
      }

      start = step(start, {:link, "link", %{high_latency: true}})
      high = heard |> Enum.chunk_every(7) |> Enum.reduce(start, &step(&2, {:frames, "link", &1}))
      assert asked.(high) == []
      refute :describe_events in high.actions
    end
  end

  describe "rules" do
    defp event(sequence, fields \\ []) do
      struct!(
        %M.Event{id: 0x01000007, sequence: sequence, event_time_boot_ms: 5000, log_levels: 0x66},
        fields
      )
    end

    defp at(seconds), do: round(seconds * @second)

    # Heartbeats go on, so that time does.
    defp said(messages) do
      beats = for s <- 0..20, do: frame(@px4, at(s), seq: s)

      said =
        for {seconds, message, component} <- messages, do: frame(message, at(seconds), component: component)

      (beats ++ said) |> Enum.sort_by(& &1.at) |> run()
    end

    test "an event of a camera is also the vehicle's; each component has its own numbers (X3)" do
      run =
        said([{1.1, event(5), 1}, {1.2, event(5), 100}, {1.3, event(6), 1}, {1.4, event(6), 100}])

      assert for({_, _, data} <- pick(run, ["report"]), do: {data["component"], data["sequence"]}) ==
               [{1, 5}, {100, 5}, {1, 6}, {100, 6}]

      assert [] = for({:send, %M.RequestEvent{}, _} <- run.actions, do: :asked)
    end

    test "what the vehicle itself says about its events is asked for once per boot, by its first one" do
      asked = fn run -> Enum.count(run.actions, &(&1 == :describe_events)) end
      assert asked.(said([])) == 0
      assert asked.(said([{1.1, event(5), 100}])) == 0
      assert asked.(said([{1.1, event(5), 1}, {1.2, event(6), 1}])) == 1

      boot = fn ms -> %M.Attitude{time_boot_ms: ms} end
      before = [{1.1, boot.(600_000), 1}, {1.2, event(5), 1}, {2.1, boot.(601_000), 1}]
      later = for n <- 0..10, do: {3 + n, boot.(500 + n * 1000), 1}
      assert asked.(said(before ++ later ++ [{15, event(6), 1}])) == 2
      assert asked.(run([frame(@px4, 0, []), frame(event(5), @second, [])], request_streams: false)) == 0
    end

    test "what the vehicle itself says about its events wins" do
      definitions = %{events: %{0x01000007 => {"its_own", [{:unsigned, 8}]}}, enums: %{}}
      run = said([{1.1, event(5, arguments: <<7>>), 1}])
      run = step(run, {:event_definitions, definitions})
      run = step(run, {:frames, "link", [frame(event(6, arguments: <<7>>), at(21), seq: 21)]})
      run = step(run, {:event_definitions, Reports.Definitions.none()})
      run = step(run, {:frames, "link", [frame(event(7, arguments: <<7>>), at(22), seq: 22)]})
      run = step(run, {:tick, at(25)})

      assert [{5, nil, nil}, {6, "its_own", [7]}, {7, nil, nil}] =
               Enum.sort(
                 for {"report", _, data} <- pick(run, ["report"]),
                     do: {data["sequence"], data["name"], data["values"]}
               )
    end

    test "reports come in their order, each with the time when it happened and how late it came" do
      clock = fn second -> {second, %M.SystemTime{time_boot_ms: round(second * 1000)}, 1} end

      run =
        said(
          [
            {1.1, event(5, event_time_boot_ms: 1100), 1},
            {4.1, event(8, event_time_boot_ms: 4100), 1},
            # Those between were lost, and come when they are requested.
            {4.6, event(7, event_time_boot_ms: 3300), 1},
            {5.2, event(6, event_time_boot_ms: 1300), 1}
          ] ++ for(s <- 0..10, do: clock.(s + 0.05))
        )

      assert [
               {_, 1100, %{"sequence" => 5} = five},
               {_, then, %{"sequence" => 6, "late_s" => late}},
               seven,
               eight
             ] =
               pick(run, ["report"])

      refute is_map_key(five, "late_s")
      assert_in_delta then, 1300, 1000
      assert_in_delta late, 3.9, 1.0
      assert {{_, 4600, %{"sequence" => 7}}, {_, 4100, %{"sequence" => 8}}} = {seven, eight}
    end

    test "that are said to be an hour old by turns with fresh ones have no more than their budget" do
      clock = {0.5, %M.SystemTime{time_boot_ms: 4_000_000}, 1}

      flood =
        for n <- 1..200, do: {1 + n / 20, event(n, event_time_boot_ms: 4_001_000 - rem(n, 2) * 3_000_000), 1}

      reports = pick(said([clock | flood]), ["report"])
      # The whole bucket, and two a second for the ten seconds that they take.
      assert length(reports) in 60..82
      assert [_ | _] = for({_, _, %{"late_s" => late}} <- reports, do: assert_in_delta(late, 3000, 20))
    end

    test "events that are not for display or not for us are not shown, and not missing either" do
      run =
        said([
          {1.1, event(1), 1},
          {1.2, event(2, log_levels: 0x88), 1},
          {1.3, event(3, destination_system: 77), 1},
          {1.4, event(4, destination_system: Aerie.Flight.options().own_system, destination_component: 191),
           1},
          {1.5, event(5, log_levels: 0x29), 1}
        ])

      assert for({_, _, data} <- pick(run, ["report"]), do: data["sequence"]) == [1, 4]
      assert [] = for({:send, %M.RequestEvent{}, _} <- run.actions, do: :asked)
    end

    test "a text without a tab, or of a component without events, doubles no event" do
      run =
        said([
          {1.1, %M.Statustext{severity: 6, text: "tab without events\t"}, 1},
          {2.1, event(1), 1},
          {2.2, %M.Statustext{severity: 6, text: "no tab"}, 1}
        ])

      assert [{"report", _, %{"name" => nil, "id" => "0x01000007"}}] = pick(run, ["report"])
    end

    test "more than eight components are not followed" do
      reports =
        Enum.reduce(1..20, Reports.new(), fn component, reports ->
          {reports, _said} = Reports.message(reports, component, event(1), {245, 191}, 0)
          reports
        end)

      assert map_size(reports.components) == 8
    end
  end

  test "a batch of checks: in any order, with other events in between, and without its end" do
    [first, last] = for name <- ~w(commander_arming_check_summary commander_health_summary), do: id(name)
    reason = id("check_battery_low")
    feed = fn checks, events -> Enum.map_reduce(events, checks, &feed/2) end

    {said, nil} =
      feed.(nil, [
        {65_534, first, 0},
        {65_535, reason, :a},
        {0, id("commander_armed_by"), 0},
        {1, 0x01FFFFFF, :b},
        {2, last, 0}
      ])

    assert said == [{:taken, nil}, {:taken, nil}, {:other, nil}, {:taken, nil}, {:taken, [:a, :b]}]

    {said, nil} = feed.(nil, [{7, first, 0}, {10, last, 0}, {9, reason, :b}, {8, reason, :a}])
    assert List.last(said) == {:taken, [:a, :b]}

    {_, open} = feed.(nil, [{7, first, 0}, {8, reason, :a}])
    assert Checks.expire(open, 4 * @second) == {open, nil}
    assert Checks.expire(open, 5 * @second) == {nil, nil}
    {_, open} = feed.(open, [{10, last, 0}])
    assert Checks.expire(open, 5 * @second) == {nil, [:a]}
    assert {[{:other, nil}], nil} = feed.(nil, [{3, reason, :a}])
  end

  defp feed({number, id, what}, checks) do
    {verdict, checks, list} = Checks.event(checks, number, Names.name(id), what, 0)
    {{verdict, list}, checks}
  end

  defp id(name), do: Enum.find_value(@names, fn {id, known} -> if known == name, do: id end)
end
