defmodule Aerie.Console.Pages.Vehicle.PartsTest do
  @moduledoc "What the vehicle's page shows, out of snapshots and events made by hand."
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.{Event, Snapshot}
  alias Aerie.Console.Pages.Vehicle.View
  alias Aerie.Console.Pages.Vehicle.Fly.{Doing, Instruments, Line}
  alias Aerie.Console.Pages.Vehicle.LinkTable.Links
  alias Aerie.Console.Pages.Vehicle.Charts.Series
  alias Aerie.Console.Pages.Vehicle.Events.Timeline

  @now 1_800_000_000_000_000
  defp vehicle(groups, more \\ %{}),
    do:
      Map.merge(
        %{
          id: "VID-001",
          system_id: 7,
          links: [],
          groups: Map.new(groups, fn {name, data} -> {name, %{at: @now, data: data}} end)
        },
        more
      )

  defp event(type, data, age_s \\ 0), do: Event.new("VID-001", type, 1, @now - age_s * 1_000_000, nil, data)

  test "instruments show the present or nothing" do
    groups = [
      attitude: %{roll: 1.23456, pitch: -2.0, yaw: -90.0},
      velocity: %{groundspeed: 5, airspeed: nil, climb: :nan}
    ]

    assert %{
             vehicle: "VID-001",
             roll: 1.235,
             pitch: -2.0,
             heading: 270.0,
             speed: 5.0,
             airspeed: nil,
             climb: nil,
             height: nil
           } =
             Instruments.sample(vehicle(groups), @now)

    assert %{roll: nil, heading: nil, speed: nil} = Instruments.sample(vehicle(groups), @now + 3_000_001)
    assert %{heading: 12.5} = Instruments.sample(vehicle([position: %{heading: 12.5}] ++ groups), @now)
  end

  @flying [
    mode: %{armed: true, in_air: true, mode: "GUIDED"},
    position: %{lat: 47.0, lon: 8.0, alt_rel: 12.4},
    velocity: %{groundspeed: 5.0},
    home: %{lat: 47.001, lon: 8.0}
  ]
  defp doing(groups, entries \\ [], courses \\ %{}, status \\ :online) do
    vehicle = vehicle(Keyword.merge(@flying, groups), %{status: status, vehicle_type: "copter"})
    Doing.of(%View{vehicle: vehicle, now: @now, silent_us: 0}, entries, courses)
  end

  test "what it does now, in one sentence: by its command, else by its mode" do
    mode = fn changes -> [mode: Map.merge(@flying[:mode], Map.new(changes))] end
    assert doing([]) == "Flying in GUIDED, 12 m above home"

    for velocity <- [%{groundspeed: 0.6}, %{}],
        do: assert(doing(velocity: velocity) == "Waiting for a command, 12 m above home")

    assert doing(mode.(mode: "RTL")) == "Returning, 111 m from home, 22 s"
    assert doing(mode.(mode: "AUTO_LAND")) == "Landing, 12 m above home"
    assert doing([mission: %{seq: 2, total: 3}] ++ mode.(mode: "AUTO")) == "Flying the mission, item 2 of 3"
    assert doing(mode.(mode: "ACRO")) == "Flying in ACRO, 12 m above home"
    assert doing(mode.(mode: nil)) == "Flying, mode unknown, 12 m above home"
    assert doing(mode.(in_air: false)) == "Armed on the ground"
    assert doing(mode.(in_air: false, armed: false)) == "On the ground, disarmed"
    assert doing(mode: %{}, position: %{}) == "State unknown"
    assert doing([position: %{}, home: %{}] ++ mode.(mode: "RTL")) == "Returning"

    course = %{stage: :going, label: "On its way", text: "118 m to go", at: nil}
    entries = [%{id: "b"}, %{id: "a"}]
    assert doing([], entries, %{"a" => course, "b" => %{course | stage: :ended}}) == "On its way, 118 m to go"
    assert doing([], entries, %{"a" => course}, :lost) == "Last known: On its way, 118 m to go"
  end

  test "the line over the map: what is known, what is low, and what is unknown" do
    items = fn groups, events ->
      view = %View{vehicle: vehicle(groups, %{vehicle_type: "copter"}), now: @now, silent_us: 0}
      for item <- Line.items(view, events), into: %{}, do: {item.name, {item.text, item.more, item.tone}}
    end

    groups = [
      battery: %{remaining: 0.12, voltage: 11.26, time_remaining: 540},
      gps: %{satellites: 10, fix: 6, fix_name: "RTK_FIXED"}
    ]

    took_off = event("takeoff", %{}, 252)

    assert items.(@flying ++ groups, [event("landed", %{}, 900), took_off, event("armed", %{}, 3)]) == %{
             "Height" => {"12.4 m", [], nil},
             "Speed" => {"5.0 m/s", [], nil},
             "Home" => {"111 m", [], nil},
             "Battery" => {"12 %", ["11.3 V", "9 min left"], :bad},
             "Satellites" => {"10", ["RTK fixed"], nil},
             "Flight" => {"04:12", [], nil}
           }

    assert %{"Flight" => {nil, [], nil}} = items.(@flying, [took_off, event("landed", %{}, 3)])
    assert %{"Flight" => {"–", [], nil}} = items.([mode: %{in_air: false}], [took_off])
    assert %{"Flight" => {"1:01:05", [], nil}} = items.(@flying, [event("takeoff", %{}, 3665)])

    assert for({_name, {text, more, tone}} <- items.([], []), uniq: true, do: {text, more, tone}) == [
             {nil, [], nil}
           ]

    assert %{"Satellites" => {"0", ["no fix"], :bad}} =
             items.([gps: %{satellites: 0, fix: 1, fix_name: "NO_FIX"}], [])
  end

  test "numbers as text: as many decimals as are asked for, and no minus before a zero" do
    groups = [velocity: %{groundspeed: 8.567, climb: -0.004}]
    view = %View{vehicle: vehicle(groups), now: @now, silent_us: 0}
    assert View.text(view, [:velocity, :groundspeed], %{decimals: 1}) == "8.6 m/s"
    assert View.text(view, [:velocity, :climb]) == "0.00 m/s"
    assert View.text(view, [:velocity, :airspeed]) == "–"
    assert View.number(-0.6, 0) == "-1"
    assert View.number(-0.06, 1) == "-0.1"
  end

  test "series: numbers of the state, by keys from outside" do
    keys = Enum.map(Series.all(), & &1.key)
    assert keys == Enum.uniq(keys)

    for key <- ~w(position.alt_rel battery.voltage health.ekf.compass health.vibration.z rc.channels.18),
        do: assert(key in keys)

    refute "mode.mode" in keys

    chosen =
      Series.choose([
        "battery.voltage",
        "no.such",
        "health.vibration.z",
        "health.ekf.compass",
        "battery.voltage"
      ])

    assert ["battery.voltage", "health.vibration.z", "health.ekf.compass"] == Enum.map(chosen, & &1.key)
    assert length(Series.choose(keys)) == Series.max()

    vehicle = vehicle(battery: %{voltage: 12.1}, health: %{vibration: [1, 2, 3.5], ekf: nil})

    assert %{"battery.voltage" => 12.1, "health.vibration.z" => 3.5, "health.ekf.compass" => nil} ==
             Series.sample(vehicle, chosen, @now)

    assert %{"battery.voltage" => nil} = Series.sample(vehicle, chosen, @now + 6_000_000)
  end

  test "series: what the tracks have of them, without what was old then" do
    keys = Enum.map(Series.all(), & &1.key)
    for {_name, preset} <- Series.presets(), do: assert(preset -- keys == [])

    series = Series.choose(~w(position.alt_rel battery.voltage battery.remaining))
    sample = %{at: 1_500_000, age: 0, height: 12.5, battery: 0.5, speed: 3.0}

    assert Series.history(
             [sample, %{sample | at: 2_500_000, age: 6}, %{sample | at: 3_500_000, age: nil}],
             series
           ) == [
             {1.5, %{"position.alt_rel" => 12.5, "battery.remaining" => 0.5}},
             {2.5, %{"position.alt_rel" => nil, "battery.remaining" => nil}},
             {3.5, %{"position.alt_rel" => nil, "battery.remaining" => nil}}
           ]

    assert Series.history([sample], Series.choose(["battery.voltage"])) == []
  end

  test "what keeps it from arming: checks, texts of the last half minute, sensors" do
    events = [
      event("statustext", %{"text" => "PreArm: old complaint", "severity" => 2}, 60),
      event("statustext", %{"text" => "PreArm: Compass not calibrated", "severity" => 2}, 20),
      event("statustext", %{"text" => "hello", "severity" => 6}),
      event("statustext", %{"text" => "PreArm: no map", "severity" => 2, "component" => 191}),
      event("statustext", %{"text" => "Arm: Throttle too high", "severity" => 2})
    ]

    health = %{
      ready_to_arm: false,
      unhealthy: ["3d_gyro", "gps"],
      arming_checks: [%{name: "check_no_rc", id: "1"}]
    }

    assert %{
             ready: false,
             reasons: [
               "check no rc",
               "Throttle too high",
               "Compass not calibrated",
               "3D gyro is unhealthy",
               "gps is unhealthy"
             ]
           } = Snapshot.arming(vehicle(health: health, mode: %{armed: false}), events, @now)

    assert %{reasons: []} = Snapshot.arming(vehicle(health: health, mode: %{armed: true}), events, @now)
    assert %{ready: nil, reasons: []} = Snapshot.arming(vehicle([]), [], @now)
  end

  test "the time line: newest first, by severity and text" do
    events = [
      event("statustext", %{"text" => "EKF3 IMU0 is using GPS", "severity" => 6}),
      event("mode_change", %{"from" => nil, "to" => "GUIDED"}),
      event("failsafe", %{
        "type" => "battery",
        "reason" => "critical_battery_level",
        "action" => "rtl",
        "text" => nil
      }),
      event("battery.low", %{"remaining" => 0.2, "voltage" => nil}),
      event("param_changed", %{"name" => "RTL_ALT", "from" => 1500.0, "to" => 2000})
    ]

    assert [
             "RTL_ALT: 1500 → 2000",
             "battery low: 20 %",
             "failsafe: critical battery level → rtl",
             "mode unknown → GUIDED",
             "EKF3 IMU0 is using GPS"
           ] ==
             events |> Timeline.lines() |> Enum.map(& &1.text)

    assert ["battery.low", "failsafe"] == events |> Timeline.lines("warning") |> Enum.map(& &1.type)
    assert ["failsafe"] == events |> Timeline.lines("error") |> Enum.map(& &1.type)
    assert ["mode_change"] == events |> Timeline.lines("all", "guided") |> Enum.map(& &1.type)
    assert [%{tone: :bad, name: "critical"}] = Timeline.lines(events, "error")
    assert length(Timeline.lines(List.duplicate(hd(events), 300))) == 200
  end

  test "links: loss of this vehicle's frames by each, all components together" do
    links = [
      %{
        id: "a",
        url: "udpin:0.0.0.0:14550",
        label: nil,
        status: :up,
        text: "listening",
        quality: %{rtt_ms: 20, score: 90.0, carries: true},
        sources: %{
          {7, 1} => %{received: 90, lost: 5},
          {7, 100} => %{received: 5, lost: 0},
          {8, 1} => %{received: 1, lost: 99}
        }
      },
      %{id: "b", url: "serial:/dev/ttyUSB0", label: "radio", status: :idle, text: "", sources: %{}}
    ]

    assert [
             %{id: "b", url: "radio", latest: true, loss: nil, round_trip_ms: nil},
             %{id: "a", latest: false, loss: 0.05, received: 95, lost: 5, round_trip_ms: 20, carries: true}
           ] = Links.of(vehicle([], %{links: ["b", "gone", "a"]}), links)
  end
end
