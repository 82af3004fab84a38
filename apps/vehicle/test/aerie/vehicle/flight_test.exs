defmodule Aerie.Vehicle.FlightTest do
  @moduledoc """
  Recorded flights of real firmware through the whole pure core. The times are those of the recordings' own event lists
  (milliseconds of arrival).
  """
  use ExUnit.Case, async: true

  import Aerie.Flight

  alias Aerie.Vehicle.State

  @flight ~w(armed disarmed mode_change takeoff landed failsafe geofence battery.low battery.critical link.lost
             link.restored reboot mission.completed collision gcs_failsafe)

  defp times(events), do: for({type, ms, _data} <- events, do: {type, ms})
  defp modes(events), do: for({"mode_change", _ms, %{"to" => to}} <- events, do: to)

  describe "ArduCopter 4.6.3" do
    setup do: %{run: run(frames("arducopter_flight"))}

    test "gives exactly the events of the flight, in order, when they came", %{run: run} do
      events = pick(run, @flight)

      assert times(events) == [
               {"mode_change", 1_795_213_361_706},
               {"armed", 1_795_213_362_384},
               {"takeoff", 1_795_213_365_411},
               {"mode_change", 1_795_213_395_470},
               {"mode_change", 1_795_213_424_958},
               {"landed", 1_795_213_471_922},
               {"disarmed", 1_795_213_472_394}
             ]

      assert modes(events) == ~w(GUIDED AUTO RTL)
      assert [{"mode_change", _, %{"from" => "STABILIZE"}} | _] = events
    end

    test "reaches its waypoints once each", %{run: run} do
      assert for({_, _, %{"seq" => seq}} <- pick(run, ["mission.reached"]), do: seq) == [1, 2, 3, 4]
    end

    test "gives every status text, that before the first heartbeat too", %{run: run} do
      texts = for {_, _, %{"text" => text}} <- pick(run, ["statustext"]), do: text
      assert length(texts) == 41
      assert "Field Elevation Set: 584m" in texts
      assert List.last(texts) == "Disarming motors"
    end

    test "the first list of 1392 parameters changes nothing, later values do", %{run: run} do
      changed =
        for {_, ms, data} <- pick(run, ["param_changed"]), do: {ms, data["name"], data["from"], data["to"]}

      assert {1_795_213_360_638, "RALLY_TOTAL", 0, 1} in changed
      assert length(changed) < 40
      assert map_size(run.params) > 1380
      refute Enum.any?(changed, fn {_, name, _, _} -> String.starts_with?(name, "STAT_") end)
    end

    test "ends with the state that the last messages say", %{run: run} do
      snapshot = Aerie.Vehicle.Session.Core.snapshot(run.core)
      assert %{autopilot: :ardupilot, vehicle_type: "copter", firmware: "4.6.3", status: :online} = snapshot

      assert %{mode: "RTL", armed: false, in_air: false, landed_state: "ON_GROUND"} =
               snapshot.groups.mode.data

      assert_in_delta snapshot.groups.position.data.lat, -35.363261, 1.0e-5
      assert snapshot.groups.battery.data.remaining == 0.74
      assert snapshot.groups.gps.data.fix_name == "RTK_FIXED"
      assert snapshot.groups.home.data.alt_msl == 584.08
    end

    test "gives the same events however the frames are cut into reads", %{run: run} do
      for batch <- [1, 40, 5000],
          do: assert(run(frames("arducopter_flight"), batch: batch).events == run.events)
    end

    test "position is published about once a second, the mode when it changes", %{run: run} do
      published = for {:publish, group, %{data: data}, at} <- run.actions, do: {group, at, data}
      assert Enum.count(published, &match?({:position, _, _}, &1)) in 150..160
      modes = for {:mode, _at, %{mode: mode}} <- published, do: mode
      assert Enum.dedup(modes) == ~w(STABILIZE GUIDED AUTO RTL)
    end

    test "is shown at most twenty times a second", %{run: run} do
      assert Enum.count(run.actions, &match?({:snapshot, _}, &1)) <= 159 * 20 + 10
    end
  end

  test "MAVLink 1 without EXTENDED_SYS_STATE: takeoff and landing from the heartbeat" do
    events = frames("arducopter_mavlink1") |> run() |> pick(@flight)

    assert times(events) == [
             {"mode_change", 1_795_213_724_450},
             {"armed", 1_795_213_725_415},
             {"takeoff", 1_795_213_728_419},
             {"mode_change", 1_795_213_738_396},
             {"landed", 1_795_213_760_417},
             {"disarmed", 1_795_213_761_415}
           ]

    assert modes(events) == ~w(GUIDED LAND)
  end

  test "a rover drives a mission and never flies" do
    run = frames("ardurover_drive") |> run(system_id: 3)
    events = pick(run, @flight)

    assert times(events) == [
             {"mode_change", 1_795_213_794_603},
             {"mode_change", 1_795_213_834_881},
             {"armed", 1_795_213_835_286},
             {"mode_change", 1_795_213_842_145},
             {"mission.completed", 1_795_213_868_967},
             {"mode_change", 1_795_213_870_985},
             {"disarmed", 1_795_213_873_286}
           ]

    assert modes(events) == ~w(MANUAL GUIDED AUTO HOLD)
    assert for({_, _, %{"seq" => seq}} <- pick(run, ["mission.reached"]), do: seq) == [1, 2, 3, 4]
    assert Aerie.Vehicle.Session.Core.snapshot(run.core).vehicle_type == "rover"
  end

  describe "PX4 1.17" do
    test "a flight with orbit, offboard and a mission that is paused" do
      run = frames("px4_flight") |> run()
      events = pick(run, @flight)

      assert modes(events) ==
               ~w(AUTO_TAKEOFF AUTO_LOITER POSCTL_ORBIT AUTO_LOITER OFFBOARD AUTO_LOITER AUTO_MISSION
                                 AUTO_LOITER AUTO_MISSION AUTO_RTL AUTO_LAND AUTO_LOITER)

      assert times(Enum.reject(events, &match?({"mode_change", _, _}, &1))) == [
               {"armed", 1_795_216_296_801},
               {"takeoff", 1_795_216_298_009},
               {"mission.completed", 1_795_216_392_975},
               {"landed", 1_795_216_435_806},
               {"disarmed", 1_795_216_437_821}
             ]
    end

    test "an item that is said to be reached every second is one event" do
      run = frames("px4_flight") |> run()
      assert for({_, _, %{"seq" => seq}} <- pick(run, ["mission.reached"]), do: seq) == [0, 2, 3, 4, 6]
    end

    test "texts in chunks are put together, also when the last chunk is one sign, and lose the tab at the end" do
      texts = for {_, _, %{"text" => text}} <- frames("px4_flight") |> run() |> pick(["statustext"]), do: text
      assert "RTL: start return at 515 m (25 m above destination)" in texts
      assert "Takeoff detected" in texts
      refute Enum.any?(texts, &String.contains?(&1, "\t"))
      assert length(texts) == 14
    end

    test "an empty battery: low, critical, failsafe with its reason; then refusals that are not events" do
      run = frames("px4_refusals") |> run()
      events = pick(run, ~w(failsafe battery.low battery.critical))

      # By its texts: critical, then an emergency, each with what it does.
      assert [
               {"failsafe", 1_795_216_855_344, %{"type" => "battery", "action" => "hold", "delay" => 5}},
               {"failsafe", 1_795_216_860_382, %{"type" => "battery", "action" => "land"}}
             ] = failsafes(events)

      assert Enum.map(events, &elem(&1, 0)) |> Enum.sort() ==
               ~w(battery.critical battery.low failsafe failsafe)

      texts = for {_, _, %{"text" => text}} <- pick(run, ["statustext"]), do: text
      assert "Arming denied: Resolve system health failures first" in texts
    end

    test "a home at 95 degrees north is refused and counted" do
      run = frames("px4_refusals") |> run()
      assert {:count, :invalid} in run.actions
      home = State.data(State.restore(Aerie.Vehicle.Session.Core.snapshot(run.core)), :home)
      assert_in_delta home.lat, 47.39, 0.1
    end
  end

  defp failsafes(events), do: Enum.filter(events, &match?({"failsafe", _, _}, &1))

  test "frames of another component never make or change a vehicle (H2, H4)" do
    alias MavCodec.Messages.{Heartbeat, Statustext}

    gimbal =
      frame(%Heartbeat{type: 26, autopilot: 8, base_mode: 0x80, custom_mode: 9}, 1_000_000, component: 154)

    run = run([gimbal])
    assert Aerie.Vehicle.Session.Core.snapshot(run.core).groups[:mode] == nil

    copter = frame(%Heartbeat{type: 2, autopilot: 3, custom_mode: 4, base_mode: 1}, 1_000_000)
    gcs = frame(%Heartbeat{type: 6, autopilot: 8, base_mode: 0x80, custom_mode: 9}, 1_100_000, component: 190)
    text = frame(%Statustext{severity: 6, text: "from a camera"}, 1_200_000, component: 100)
    run = run([copter, gcs, gimbal, text, copter])
    assert [%{type: "statustext", data: %{"component" => 100}}] = run.events
    assert %{mode: "GUIDED", armed: false} = Aerie.Vehicle.Session.Core.snapshot(run.core).groups.mode.data
  end
end
