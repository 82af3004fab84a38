defmodule Aerie.Vehicle.Events.Detector.ArdupilotFailsafesTest do
  @moduledoc """
  How the vehicles of ArduPilot show their failsafes: each has its own words, and some show nothing but a change of the
  mode.
  """
  use ExUnit.Case, async: true

  import Aerie.Flight, only: [frame: 2, run: 2]

  alias MavCodec.Enums.MavSysStatusSensor
  alias MavCodec.Messages, as: M

  @second 1_000_000
  @start 1_795_000_000 * @second
  @fence MavSysStatusSensor.value(:MAV_SYS_STATUS_GEOFENCE)
  # The type of the vehicle, and numbers of its modes.
  @copter {2, %{auto: 3, guided: 4, loiter: 5, rtl: 6, land: 9}}
  @plane {1, %{auto: 10, circle: 7, rtl: 11, guided: 15, fbwa: 5}}
  @rover {10, %{guided: 15, hold: 4, rtl: 11}}

  # {seconds, what}: a mode is a heartbeat with it, {mode, :critical} one with a failsafe, a text a status text.
  defp play({type, modes}, story) do
    frames =
      for {second, what} <- story, do: frame(message(what, type, modes), @start + round(second * @second))

    for event <- run(frames, batch: 1).events, do: {(event.time - @start) / @second, event.type, event.data}
  end

  defp message(text, _type, _modes) when is_binary(text), do: %M.Statustext{severity: 4, text: text}
  defp message({:disarmed, mode}, type, modes), do: beat(type, modes[mode], 81, 3)
  defp message({mode, :critical}, type, modes), do: beat(type, modes[mode], 81 + 128, 5)

  defp message({:breach, breach_type}, _type, _modes),
    do: %M.FenceStatus{breach_status: if(breach_type == 0, do: 0, else: 1), breach_type: breach_type}

  defp message({:fence, on?}, _type, _modes) do
    enabled = if on?, do: @fence, else: 0
    %M.SysStatus{onboard_control_sensors_present: @fence, onboard_control_sensors_enabled: enabled}
  end

  defp message({:param, name, value}, _type, _modes),
    do: %M.ParamValue{param_id: name, param_value: value, param_type: 9, param_index: 65_535}

  defp message(mode, type, modes) when is_atom(mode), do: beat(type, modes[mode], 81 + 128, 4)

  defp beat(type, mode, base, status),
    do: %M.Heartbeat{type: type, autopilot: 3, base_mode: base, custom_mode: mode, system_status: status}

  defp failsafes(vehicle, story) do
    for {at, type, data} <- play(vehicle, story),
        type in ~w(failsafe failsafe.cleared),
        do: {at, type, data["type"], data["action"] || data["by"]}
  end

  defp fences(vehicle, story) do
    for {at, "geofence" <> rest, data} <- play(vehicle, story), do: {at, rest, data["breach"]}
  end

  # AP_BattMonitor::check_failsafes sends the text; what follows is up to the vehicle's handle_battery_failsafe.
  describe "a battery" do
    test "that is low, and of a vehicle that says nothing more" do
      for {vehicle, from, to} <- [{@rover, :guided, :hold}, {@plane, :auto, :rtl}, {@rover, :guided, :rtl}],
          status <- [:active, :critical] do
        to_beat = if status == :critical, do: {to, :critical}, else: to

        story = [
          {0, from},
          {5, "Battery 1 is low 10.17V used 144 mAh"},
          {5.01, to_beat},
          {6, to_beat},
          {8, to_beat}
        ]

        assert failsafes(vehicle, story) == [{5.0, "failsafe", "battery", to_string(to)}]
      end
    end

    test "with no action (BATT_FS_LOW_ACT 0), and a critical one a moment later" do
      story = [
        {0, :guided},
        {5, "Battery 2 is low 10.4V used 100 mAh"},
        {6, :guided},
        {6.5, "Battery 2 is critical 9.9V used 120 mAh"},
        {6.6, :rtl},
        {9, :rtl},
        {20, {:disarmed, :rtl}}
      ]

      assert failsafes(@rover, story) == [
               {5.0, "failsafe", "battery", "none"},
               {6.5, "failsafe", "battery", "rtl"},
               {20.0, "failsafe.cleared", "battery", "disarmed"},
               {20.0, "failsafe.cleared", "battery", "disarmed"}
             ]
    end

    test "of a vehicle on the ground: nothing is done" do
      story = [{0, {:disarmed, :guided}}, {5, "Battery 1 is low 10.1V used 3 mAh"}, {9, {:disarmed, :guided}}]
      assert failsafes(@rover, story) == []
    end

    test "whose failsafe the status never showed goes on when the status is normal again" do
      story = [
        {0, :guided},
        {5, "Battery 1 is low 10.17V used 144 mAh"},
        {5.1, :hold},
        {12, "Radio Failsafe"},
        {12.1, {:hold, :critical}},
        {20, :hold},
        {22, :hold}
      ]

      assert failsafes(@rover, story) == [
               {5.0, "failsafe", "battery", "hold"},
               {12.0, "failsafe", "rc", "none"},
               {20.0, "failsafe.cleared", "rc", "status"}
             ]
    end
  end

  # ekf_check of ArduCopter, Rover and the quadplane: "EKF variance", then the action's text if the mode needs a
  # position.
  test "an estimator without a position is what fails, though the GNSS was lost just before" do
    lost = fn fix -> %M.GpsRawInt{fix_type: fix, satellites_visible: 9} end
    [critical, over] = [{:land, :critical}, "EKF Failsafe Cleared"]
    beats = [{0, :loiter}, {1, :loiter}]

    for text <- ["EKF variance", "EKF variance: vel 1.2 pos 1.4"] do
      story =
        beats ++
          [{5, text}, {5.02, critical}, {5.03, "EKF Failsafe: changed to LAND Mode"}, {9, over}, {10, :land}]

      assert failsafes(@copter, story) == [
               {5.0, "failsafe", "ekf", "land"},
               {9.0, "failsafe.cleared", "ekf", "text"}
             ]
    end

    {type, modes} = @copter
    gps = [{0.5, 3}, {4, 1}]

    frames =
      for {at, message} <-
            Enum.sort_by(
              [{5, message("EKF variance", type, modes)}, {5.9, message(critical, type, modes)}] ++
                for({at, mode} <- beats ++ [{9, :land}], do: {at, message(mode, type, modes)}) ++
                for({at, fix} <- gps, do: {at, lost.(fix)}),
              &elem(&1, 0)
            ),
          do: frame(message, @start + round(at * @second))

    assert [%{"type" => "ekf", "text" => "EKF variance", "action" => "land"}] =
             for(%{type: "failsafe", data: data} <- run(frames, batch: 1).events, do: data)
  end

  describe "a lost remote control" do
    test "takes the mode from the next heartbeat, which may come a second later" do
      for delay <- [0.01, 0.9, 1.3, 2.1] do
        story = [{0, :loiter}, {5, "Radio Failsafe"}, {5 + delay, {:rtl, :critical}}, {8, {:rtl, :critical}}]
        assert failsafes(@copter, story) == [{5.0, "failsafe", "rc", "rtl"}]
      end
    end

    test "of a plane in a mission: first nothing, then RTL, however soon" do
      for long <- [6.2, 7.5, 11] do
        story = [
          {0, :auto},
          {5, "Throttle failsafe on"},
          {5.5, "RC Short Failsafe On"},
          {5.6, {:auto, :critical}},
          {long, "RC Long Failsafe On: switched to RTL"},
          {long + 0.01, {:rtl, :critical}},
          {15, {:rtl, :critical}}
        ]

        assert {_at, "failsafe", "rc", "rtl"} = @plane |> failsafes(story) |> List.last()
      end

      story = [{0, :fbwa}, {5, "RC Short Failsafe: switched to CIRCLE"}, {9, {:circle, :critical}}]
      assert failsafes(@plane, story) == [{5.0, "failsafe", "rc", "circle"}]
    end
  end

  # Copter::fence_check and Plane::fence_check set the mode; no status and no text speaks of a failsafe.
  describe "a fence" do
    test "that makes the vehicle return is a failsafe, whichever message comes first" do
      for {vehicle, from, to} <- [
            {@copter, :guided, :rtl},
            {@plane, :auto, :rtl},
            {@rover, :guided, :hold},
            {@copter, :loiter, :land}
          ],
          order <- [[0, 0.4, 0.5], [0.4, 0, 0.4], [0.6, 0.7, 0], [1.4, 1.5, 0]] do
        [breach, text, mode] = order
        signs = [{5 + breach, {:breach, 3}}, {5 + text, "Polygon fence breached"}, {5 + mode, to}]

        story =
          [{0, from}, {1, {:breach, 0}}] ++
            Enum.sort_by(signs, &elem(&1, 0)) ++ [{12, {:breach, 0}}, {13, to}]

        assert [{_at, "failsafe", "fence", action}, {12.0, "failsafe.cleared", "fence", "fence"}] =
                 failsafes(vehicle, story)

        assert action == to_string(to)
      end
    end

    test "that is only reported, or broken long before the pilot returns, does not count" do
      assert failsafes(@copter, [{0, :loiter}, {1, {:breach, 0}}, {5, {:breach, 1}}, {9, :rtl}, {12, :rtl}]) ==
               []

      assert failsafes(@copter, [{0, :rtl}, {1, {:breach, 0}}, {5, {:breach, 1}}, {9, :rtl}]) == []
      # Nor does a fence change the mode to this one.
      assert failsafes(@copter, [
               {0, :guided},
               {1, {:breach, 0}},
               {5, {:breach, 1}},
               {5.2, :loiter},
               {9, :loiter}
             ]) == []
    end

    # Copter::fence_send_mavlink_status and its siblings send FENCE_STATUS only of a fence that is enabled.
    test "that is switched off and on again outside is broken again" do
      ways = [
        [{10, {:fence, false}}, {14, {:fence, true}}],
        [{10, {:param, "FENCE_ENABLE", 0}}, {14, {:param, "FENCE_ENABLE", 1}}],
        [
          {9.9, {:param, "FENCE_ENABLE", 0}},
          {10, {:fence, false}},
          {14, {:param, "FENCE_ENABLE", 1}},
          {14, {:fence, true}}
        ]
      ]

      for [{off, _how} | _rest] = way <- ways, between <- [[], [{12, :rtl}]] do
        story =
          [{0, :loiter}, {1, {:fence, true}}, {1, {:breach, 0}}, {5, {:breach, 3}}] ++
            Enum.sort_by(way ++ between, &elem(&1, 0)) ++
            [{14.5, {:breach, 3}}, {20, {:breach, 0}}, {21, :loiter}]

        assert fences(@copter, story) == [
                 {5.0, "", "BOUNDARY"},
                 {off / 1, ".cleared", "BOUNDARY"},
                 {14.5, "", "BOUNDARY"},
                 {20.0, ".cleared", "BOUNDARY"}
               ]
      end
    end

    # AC_Fence::sys_status_enabled is false if it is only to report.
    test "that only reports is never shown as enabled, and its breach is one" do
      story = [
        {0, :loiter},
        {1, {:fence, false}},
        {2, {:breach, 0}},
        {5, {:breach, 1}},
        {6, {:fence, false}},
        {7, {:breach, 1}}
      ]

      assert fences(@copter, story) == [{5.0, "", "MINALT"}]
    end
  end
end
