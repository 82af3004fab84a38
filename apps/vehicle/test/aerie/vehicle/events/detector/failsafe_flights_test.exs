defmodule Aerie.Vehicle.Events.Detector.FailsafeFlightsTest do
  @moduledoc """
  Failsafes that real firmware flew (PX4 1.18, ArduCopter 4.8, Rover 4.7): each with what it is about, why, what the vehicle does, and
  when it is over. Times are seconds since the recording's first frame.
  """
  use ExUnit.Case, async: true

  import Aerie.Flight, only: [frames: 1, run: 2]

  alias Aerie.Vehicle.State

  defp events(recording) do
    [first | _] = frames = frames(recording)
    for event <- run(frames, batch: 1).events, do: {Float.round((event.time - first.at) / 1.0e6, 1), event}
  end

  # {time, event, type, reason, action, delay}, and for the end the duration.
  defp story(events), do: Enum.flat_map(events, fn {at, event} -> told(at, event.type, event.data) end)

  defp told(at, "failsafe", d), do: [{at, "failsafe", d["type"], d["reason"], d["action"], d["delay"]}]
  defp told(at, "failsafe.cleared", d), do: [{at, "cleared", d["type"], d["by"], d["duration"]}]
  defp told(at, "geofence", d), do: [{at, "geofence", d["breach"]}]
  defp told(at, "geofence.cleared", d), do: [{at, "inside", d["breach"], d["duration"]}]

  defp told(at, type, d) when type in ~w(rc.lost gps.lost position.lost gcs_failsafe),
    do: [{at, type, d["report"] || d["text"] || d["fix_name"]}]

  defp told(at, type, d) when type in ~w(rc.restored gps.restored position.restored),
    do: [{at, type, d["duration"]}]

  defp told(_at, _type, _data), do: []

  test "PX4: ground station lost and back, remote control lost until the pilot takes over, fence" do
    assert story(events("px4_118_failsafes_a")) == [
             {21.5, "gcs_failsafe", "commander_gcs_lost"},
             {21.5, "failsafe", "gcs", "gcs_connection_loss", "rtl", 2},
             {31.5, "cleared", "gcs", "status", 10.0},
             {36.5, "rc.lost", nil},
             {36.5, "failsafe", "rc", "manual_control_loss", "rtl", 2},
             {43.9, "cleared", "rc", "report", 7.4},
             {55.0, "geofence", "MAX_HOR_DIST"},
             # Its own argument says manual control; the check just before is right.
             {55.0, "failsafe", "fence", "check_gf_violation_max_hor_dist", "rtl", nil},
             {58.0, "inside", "MAX_HOR_DIST", 3.0}
           ]
  end

  test "PX4: GNSS lost and back; battery critical, then an emergency with the same status" do
    assert story(events("px4_118_failsafes_b")) == [
             {15.3, "gps.lost", "NO_GPS"},
             {20.4, "failsafe", "gps", "gps", "descend", nil},
             {21.0, "position.lost", nil},
             {24.5, "gps.restored", 9.2},
             {26.1, "position.restored", 5.0},
             {27.1, "cleared", "gps", "status", 6.6},
             {31.9, "failsafe", "battery", "critical_battery_level", "rtl", 2},
             {33.9, "failsafe", "battery", "emergency_battery_level", "land", nil}
           ]

    modes = for {_at, %{type: "mode_change", data: data}} <- events("px4_118_failsafes_b"), do: data["to"]
    assert "AUTO_DESCEND" in modes
  end

  test "PX4 1.17, texts and reports: each failsafe once" do
    assert for({_, "failsafe", _, _, _, _} = one <- story(events("px4_refusals_reports")), do: one)
           |> Enum.map(&Tuple.delete_at(&1, 0)) == [
             {"failsafe", "battery", "critical_battery_level", "rtl", 5},
             {"failsafe", "battery", "emergency_battery_level", "land", nil}
           ]
  end

  test "all that PX4 1.18 reports has a name and its arguments" do
    for recording <- ~w(px4_118_failsafes_a px4_118_failsafes_b) do
      flight = run(frames(recording), batch: 1)
      reports = for %{type: "report", data: data} <- flight.events, do: data
      assert reports != [] and Enum.all?(reports, &(is_binary(&1["name"]) and is_list(&1["values"])))
      checks = State.data(flight.core.state, :health).arming_checks
      assert checks != [] and Enum.all?(checks, &is_binary(&1.name))
    end
  end

  test "each has the position where it began" do
    for recording <- ~w(px4_118_failsafes_a px4_118_failsafes_b arducopter_48_failsafes),
        {_at, %{type: "failsafe", data: data}} <- events(recording),
        do: assert(%{"lat" => _, "alt_rel" => _} = data["position"])
  end

  test "PX4 says who armed" do
    assert [%{data: %{"reason" => "command_external"}}] =
             for({_at, %{type: "armed"} = event} <- events("px4_118_failsafes_a"), do: event)
  end

  test "ArduCopter: the text comes after the heartbeat; three failsafes, one of which stays active" do
    assert story(events("arducopter_48_failsafes")) == [
             {64.0, "gcs_failsafe", "GCS Failsafe"},
             {64.0, "failsafe", "gcs", "gcs", "rtl", nil},
             {68.0, "cleared", "gcs", "text", 4.0},
             {73.0, "failsafe", "battery", "low_battery_level", "none", nil},
             {78.0, "failsafe", "battery", "critical_battery_level", "land", nil},
             {84.1, "rc.lost", "Radio Failsafe"},
             {84.1, "failsafe", "rc", "rc", "rtl", nil},
             {88.1, "rc.restored", 4.1},
             {88.1, "cleared", "rc", "text", 4.1},
             {90.2, "geofence", "MAXALT"},
             {94.2, "inside", "MAXALT", 4.1},
             {96.8, "gps.lost", "NO_FIX"},
             {103.8, "gps.restored", 7.0}
           ]

    texts =
      for {_at, %{type: "failsafe", data: data}} <- events("arducopter_48_failsafes"), do: data["text"]

    assert "Battery 1 is critical 9.80V used 211 mAh; Battery Failsafe" in texts
  end

  test "Rover: the battery's failsafe shows in a text and the mode, not in the status; the estimator's is not the GNSS's" do
    assert story(events("ardurover_47_failsafes")) == [
             {2.8, "rc.lost", nil},
             {4.5, "failsafe", "rc", "rc", "hold", nil},
             {10.0, "cleared", "rc", "status", 5.5},
             {10.0, "rc.restored", 7.2},
             {36.4, "failsafe", "battery", "low_battery_level", "hold", nil},
             {45.6, "gps.lost", "NO_FIX"},
             {53.2, "failsafe", "ekf", "ekf", "none", nil},
             {55.6, "gps.restored", 10.0},
             {56.4, "cleared", "ekf", "text", 3.2}
           ]
  end

  test "a quadplane's transitions and landings are not failsafes" do
    assert story(events("arduplane_47_quadplane_vtol")) == []
  end
end
