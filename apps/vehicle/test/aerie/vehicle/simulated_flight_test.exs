defmodule Aerie.Vehicle.SimulatedFlightTest do
  @moduledoc """
  Events that no recording has, from frames as ArduPilot and PX4 send them: a heartbeat a second, texts in between, through
  the whole pure core.
  """
  use ExUnit.Case, async: true

  import Aerie.Flight

  alias MavCodec.Messages, as: M

  @second 1_000_000

  # A flight as {second, message}; a heartbeat with what `script` says of it, every second in between.
  defp flight(seconds, script, firmware \\ :ardupilot) do
    Enum.flat_map(seconds, fn second ->
      {changes, messages} = Enum.split_with(Map.get(script, second, []), &is_tuple/1)
      Process.put(:beat, Keyword.merge(Process.get(:beat, []), changes))

      for message <- messages ++ [heartbeat(firmware, Process.get(:beat))],
          do: frame(message, second * @second)
    end)
  end

  defp heartbeat(:ardupilot, changes) do
    armed = if changes[:armed], do: 0x80, else: 0
    mode = changes[:mode] || 4

    %M.Heartbeat{
      type: 2,
      autopilot: 3,
      base_mode: 81 + armed,
      custom_mode: mode,
      system_status: changes[:status] || 3
    }
  end

  defp heartbeat(:px4, changes) do
    armed = if changes[:armed], do: 0x80, else: 0

    %M.Heartbeat{
      type: 2,
      autopilot: 12,
      base_mode: 29 + armed,
      custom_mode: 50_593_792,
      system_status: changes[:status] || 3
    }
  end

  defp text(text, severity \\ 4), do: %M.Statustext{severity: severity, text: text}
  defp times(run), do: for(e <- run.events, e.type != "statustext", do: {div(e.time, @second), e.type})
  defp data(run, type), do: Enum.find_value(run.events, &(&1.type == type && &1.data))

  @airborne [armed: true, status: 4]

  test "ArduPilot loses its ground station: gcs_failsafe, failsafe with its reason, RTL; again after it came back" do
    run =
      run(
        flight(1..40, %{
          2 => @airborne,
          10 => [text("GCS Failsafe - RTL"), {:status, 5}, {:mode, 6}],
          20 => [text("GCS Failsafe Cleared"), {:status, 4}],
          30 => [text("GCS Failsafe - RTL"), {:status, 5}]
        })
      )

    assert times(run) == [
             {2, "armed"},
             {2, "takeoff"},
             {10, "gcs_failsafe"},
             {10, "mode_change"},
             {10, "failsafe"},
             {20, "failsafe.cleared"},
             {30, "gcs_failsafe"},
             {30, "failsafe"}
           ]

    assert %{
             "type" => "gcs",
             "reason" => "gcs",
             "action" => "rtl",
             "text" => "GCS Failsafe - RTL",
             "mode" => "RTL"
           } =
             data(run, "failsafe")
  end

  test "ArduPilot leaves its fence: FENCE_STATUS says so, and the text is not a second event" do
    breach = %M.FenceStatus{breach_status: 1, breach_count: 1, breach_type: 3}

    run =
      run(
        flight(1..30, %{
          2 => @airborne ++ [%M.FenceStatus{}],
          10 => [text("Polygon Fence Breached"), breach],
          11 => [breach],
          20 => [%M.FenceStatus{breach_count: 1}],
          25 => [%{breach | breach_count: 2}]
        })
      )

    assert for({second, "geofence"} <- times(run), do: second) == [10, 25]
    assert data(run, "geofence") == %{"breach" => "BOUNDARY"}
  end

  test "PX4 leaves its fence and says so in a text only" do
    run = run(flight(1..30, %{2 => @airborne, 10 => [text("Geofence violation\t", 2)]}, :px4))
    assert {10, "geofence"} in times(run)
  end

  test "PX4 loses its ground station" do
    run =
      run(
        flight(
          1..30,
          %{2 => @airborne, 10 => [text("Connection to ground station lost\t", 2), {:status, 5}]},
          :px4
        )
      )

    assert {10, "gcs_failsafe"} in times(run)
    assert data(run, "failsafe")["reason"] == "gcs"
  end

  test "a battery that drains" do
    drain = Map.new(1..90, &{&1, [%M.SysStatus{voltage_battery: 12_000, battery_remaining: 91 - &1}]})
    run = run(flight(1..90, drain))
    assert times(run) == [{66, "battery.low"}, {81, "battery.critical"}]
    assert data(run, "battery.low")["remaining"] == 0.25
  end

  test "a parameter that somebody sets" do
    value =
      &%M.ParamValue{
        param_id: "RTL_ALT",
        param_value: &1,
        param_type: 6,
        param_count: 900,
        param_index: 0xFFFF
      }

    run = run(flight(1..10, %{2 => [value.(1500.0)], 5 => [value.(2000.0), value.(2000.0)]}))
    assert times(run) == [{5, "param_changed"}]
    assert %{"name" => "RTL_ALT", "from" => 1500, "to" => 2000} = data(run, "param_changed")
  end

  test "a vehicle that is silent, comes back, and has been restarted meanwhile" do
    boot = fn second, since -> {second, [%M.SystemTime{time_boot_ms: (second - since) * 1000}]} end
    before = Map.new(1..20, &boot.(&1, -600))
    later = Map.new(60..70, &boot.(&1, 58))
    run = run(flight(Enum.concat(1..20, 60..70), Map.merge(before, later)))
    assert times(run) == [{25, "link.lost"}, {60, "link.restored"}, {62, "reboot"}]
  end

  test "events say where the vehicle was" do
    here = %M.GlobalPositionInt{
      time_boot_ms: 5000,
      lat: 473_977_415,
      lon: 85_455_929,
      alt: 490_000,
      relative_alt: 1000
    }

    run = run(flight(1..5, %{2 => [here], 3 => @airborne}))

    assert data(run, "armed")["position"] == %{
             "lat" => 47.3977415,
             "lon" => 8.5455929,
             "alt_msl" => 490.0,
             "alt_rel" => 1.0
           }

    assert Enum.find(run.events, &(&1.type == "armed")).vehicle_time_ms == 5000
  end
end
