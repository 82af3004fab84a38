defmodule Aerie.Vehicle.Session.CoreTest do
  use ExUnit.Case, async: true

  import Aerie.Flight

  alias Aerie.Vehicle.Events.Detector
  alias Aerie.Vehicle.Session.Core
  alias MavCodec.Messages, as: M

  @second 1_000_000
  @copter %M.Heartbeat{type: 2, autopilot: 3, base_mode: 81, custom_mode: 4, system_status: 3}

  defp start(extra \\ []) do
    options = options(extra)
    %{core: Core.new(options), detector: Detector.new(options), events: [], actions: [], params: %{}}
  end

  defp frames(run, frames, link \\ "a"), do: step(run, {:frames, link, frames})
  defp beat(run, seconds, link \\ "a"), do: frames(run, [frame(@copter, round(seconds * @second))], link)
  defp tick(run, seconds), do: step(run, {:tick, round(seconds * @second)})
  defp types(run), do: run.events |> Enum.reverse() |> Enum.map(& &1.type)
  defp statuses(run), do: for({:status, _old, new} <- Enum.reverse(run.actions), do: new)

  test "M3: streams are requested again after a link was reconnected, after a short grace period" do
    asked = fn run -> for({:send, %M.CommandLong{command: 511}, _} <- run.actions, do: :asked) end
    run = Enum.reduce(0..40, start(), fn second, run -> run |> beat(10 + second) |> tick(10.5 + second) end)
    before = length(asked.(run))
    run = run |> step({:link_reconnected, "a"}) |> beat(51) |> tick(51.5)
    assert length(asked.(run)) == before
    run = run |> beat(52) |> tick(52.9)
    assert length(asked.(run)) > before
    # Nothing is requested of a vehicle that was never heard.
    assert {_core, []} = Core.handle(Core.new(options([])), {:link_reconnected, "a"})
  end

  test "the BEAM keeps the state as a flat map" do
    assert map_size(Core.new(options([]))) <= 32
  end

  describe "what a vehicle is" do
    @vendor %M.ComponentInformationBasic{vendor_name: "Betaflight"}
    @msp %M.Heartbeat{type: 2, autopilot: 0, base_mode: 0x81, custom_mode: 1, system_status: 4}

    defp say(run, message, seconds, link, options \\ []),
      do: frames(run, [frame(message, round(seconds * @second), options)], link)

    defp what(run), do: run.core |> Core.snapshot() |> Map.take([:autopilot, :type, :component])
    defp armed(run), do: Core.snapshot(run.core).groups.mode.data.armed

    defp msp(run, seconds) do
      run = step(run, {:link, "racer", %{high_latency: false, msp: true}})
      run |> say(@msp, seconds, "racer") |> say(@vendor, seconds, "racer")
    end

    test "is said by its link where that speaks MSP, and by nobody else, however long that one is silent" do
      run = start() |> msp(10)
      known = what(run)
      assert known.autopilot == :betaflight

      for {message, options} <- [
            {@copter, []},
            {%{@msp | type: 1}, []},
            {%M.Heartbeat{type: 2, autopilot: 12}, []},
            {@copter, [component: 5]},
            {%M.HighLatency2{type: 2, autopilot: 3}, []},
            {%M.ComponentInformationBasic{vendor_name: "iNav"}, []}
          ],
          at <- [10.5, 100] do
        run = say(run, message, at, "stranger", options)
        assert what(run) == known
        assert armed(run)
        # Its own go on.
        assert run |> say(%{@msp | base_mode: 1}, at + 1, "racer") |> what() == known
      end
    end

    test "is taken back by its link from a stranger who was first" do
      run = start() |> say(@copter, 9, "stranger") |> msp(10) |> say(@copter, 10.2, "stranger")
      assert what(run).autopilot == :betaflight
    end

    test "changes by the path that proved it only, unless that one is silent" do
      run = start() |> beat(10)
      assert what(run) == %{autopilot: :ardupilot, type: 2, component: 1}

      for other <- [%{@copter | autopilot: 12}, %{@copter | type: 1}, @msp] do
        assert run |> say(other, 10.2, "b") |> what() == what(run)
        # As after another firmware was loaded.
        refute run |> say(other, 14, "a") |> what() == what(run)
        refute run |> say(other, 100, "b") |> what() == what(run)
      end

      # A second radio says the same, and does not become the one that proves it.
      run = run |> say(@copter, 10.1, "b") |> beat(11) |> say(%{@copter | autopilot: 12}, 11.1, "b")
      assert what(run).autopilot == :ardupilot
      # A restarted session knows nobody who proved it, and still what it is.
      restored = %{run | core: Core.new(options([]), Core.snapshot(run.core))}
      assert restored |> say(%{@copter | autopilot: 12}, 12, "b") |> what() == what(run)
      assert restored |> beat(12) |> what() == what(run)
    end
  end

  describe "silence (H1)" do
    test "stale after three seconds, lost after five, exactly then; restored with the next frame" do
      run = start() |> beat(10) |> tick(12.9)
      assert statuses(run) == []
      run = tick(run, 13)
      assert statuses(run) == [:stale]
      run = run |> tick(14.9) |> tick(15.3) |> tick(20)
      assert statuses(run) == [:stale, :lost]
      run = beat(run, 30)
      assert statuses(run) == [:stale, :lost, :online]
      assert [%{type: "link.restored", time: 30_000_000}, %{type: "link.lost", time: 15_000_000}] = run.events
    end

    test "a gap in a recording is found by the next frame's own time" do
      run = start() |> beat(10) |> beat(60)
      assert types(run) == ["link.lost", "link.restored"]
      assert List.last(run.events).time == 15 * @second
    end

    test "a short pause is stale and no event" do
      run = start() |> beat(10) |> tick(14) |> beat(14.5)
      assert {statuses(run), types(run)} == {[:stale, :online], []}
    end

    test "another component's frames do not keep the vehicle alive" do
      gimbal = frame(%M.Heartbeat{type: 26, autopilot: 8}, 16 * @second, component: 154)
      run = start() |> beat(10) |> frames([gimbal])
      assert types(run) == ["link.lost"]
    end

    test "H4: messages of a camera, a gimbal and an on-board computer do not change the vehicle" do
      place = &%M.GlobalPositionInt{lat: &1, lon: 10, relative_alt: 5_000, time_boot_ms: &2}

      # An on-board computer with an estimate of its own and another clock, a gimbal, and a camera that says it is
      # armed.
      others = fn second ->
        at = second * @second

        [
          frame(%M.Heartbeat{type: 18, autopilot: 8, base_mode: 0x80, system_status: 4}, at, component: 191),
          frame(place.(900_000_000, second), at + 1, component: 191),
          frame(%M.Statustext{severity: 3, text: "estimator diverged"}, at + 2, component: 191),
          frame(%M.Heartbeat{type: 26, autopilot: 8}, at + 3, component: 154),
          frame(%M.Attitude{roll: 1.0, time_boot_ms: 5}, at + 4, component: 154),
          frame(%M.Heartbeat{type: 30, autopilot: 8, base_mode: 0x80}, at + 5, component: 100),
          frame(%M.SystemTime{time_boot_ms: 77}, at + 6, component: 100)
        ]
      end

      run =
        Enum.reduce(10..30, start(), fn second, run ->
          run
          |> beat(second)
          |> frames([frame(place.(473_977_415, second * 1000), second * @second)])
          |> frames(others.(second))
        end)

      assert Enum.uniq(types(run)) == ["statustext"]
      snapshot = Core.snapshot(run.core)
      assert %{status: :online, component: 1, collision: nil, time_boot_ms: 30_000} = snapshot
      assert %{lat: lat} = snapshot.groups.position.data
      assert_in_delta lat, 47.3977415, 1.0e-6
      assert %{armed: false} = snapshot.groups.mode.data
      refute is_map_key(snapshot.groups, :attitude)
      # They do not keep it alive either.
      run = Enum.reduce(31..40, run, fn second, run -> frames(run, others.(second)) end)
      assert Enum.uniq(types(run)) == ["statustext", "link.lost"]
    end

    test "a satellite link may be silent for longer (X6)" do
      summary = &frame(%M.HighLatency2{type: 2, autopilot: 3, latitude: 1, longitude: 1}, &1 * @second)
      run = start() |> frames([summary.(10)]) |> tick(170)
      assert statuses(run) == []
      assert run |> tick(191) |> statuses() == [:lost]

      assert start(lost_high_latency_us: 60 * @second) |> frames([summary.(10)]) |> tick(71) |> statuses() ==
               [:lost]
    end
  end

  test "one link fails, the other goes on: nothing is lost; the latest link is first" do
    run = start() |> beat(10, "a") |> beat(10.1, "b") |> beat(14, "b") |> tick(14.1)
    assert types(run) == []
    assert Core.snapshot(run.core).links == ["b", "a"]
  end

  describe "a restart in flight (R6)" do
    defp flying(n, boot_s), do: [frame(%{@copter | base_mode: 81 + 128}, n * @second), clock(n, boot_s)]

    defp clock(n, boot_s),
      do: frame(%M.SystemTime{time_boot_ms: round(boot_s * 1000)}, round(n * @second) + 1)

    defp down(n), do: frame(@copter, round(n * @second))
    defp flown, do: for(n <- 10..20, reduce: start(), do: (run -> frames(run, flying(n, 100 + n))))
    defp event_times(run), do: run.events |> Enum.reverse() |> Enum.map(&{&1.type, div(&1.time, 1_000_000)})

    test "is reported before its consequences" do
      run = frames(flown(), [down(23), down(24), clock(24.5, 3), clock(25, 3.5), clock(25.6, 4.1), down(26)])
      assert event_times(run) == [{"reboot", 25}, {"disarmed", 25}]
    end

    test "that did not happen holds back nothing: disarmed during a gap" do
      run = frames(flown(), [down(23), clock(23.5, 123.5), down(24)])
      assert event_times(run) == [{"disarmed", 23}]
    end

    test "that did not happen: what was held has its own time, although another change comes before the next tick" do
      other_mode = %{@copter | custom_mode: 5}
      run = frames(flown(), [down(23), clock(23.02, 123.02), frame(other_mode, round(23.04 * @second))])

      assert Enum.map(run.events, &{&1.type, &1.time}) == [
               {"mode_change", 23_040_000},
               {"disarmed", 23_000_000}
             ]
    end

    test "does not hold back events for ever if the vehicle shows no clock any more" do
      run = frames(flown(), [down(23), down(24), down(25), down(26), down(27), down(28), down(29)])
      assert event_times(run) == [{"disarmed", 23}]
    end
  end

  test "battery events have the values of one battery from one message, and the source may change" do
    pack = [11_000 | List.duplicate(0xFFFF, 9)]

    battery = fn id, percent, state ->
      %M.BatteryStatus{id: id, voltages: pack, battery_remaining: percent, charge_state: state}
    end

    status = %M.SysStatus{voltage_battery: 12_000, battery_remaining: 36}

    run =
      for {message, n} <- Enum.with_index([status, battery.(0, 80, 1), status, battery.(1, 13, 3), status]),
          reduce: beat(start(), 10) do
        run -> frames(run, [frame(message, 10 * @second + n * 100_000)])
      end

    assert [%{type: "battery.critical", data: data}, %{type: "battery.low", data: data}] = run.events

    assert Map.delete(data, "position") ==
             %{"battery" => 1, "remaining" => 0.13, "voltage" => 11.0, "charge_state" => "CRITICAL"}

    # SYS_STATUS shows it as low, then BATTERY_STATUS with its id: one event.
    low = fn message, at -> frame(message, round(at * @second)) end

    run =
      start()
      |> beat(10)
      |> frames([low.(%{status | battery_remaining: 20}, 10.1), low.(battery.(0, 19, 2), 10.2)])

    assert [%{type: "battery.low", data: %{"battery" => nil, "remaining" => 0.2, "voltage" => 12.0}}] =
             run.events

    # A battery that does not say what remains has not what SYS_STATUS said of it, nor is it judged by that.
    unsaid = fn states ->
      states
      |> Enum.with_index(2)
      |> Enum.map(fn {state, n} -> low.(battery.(0, -1, state), 10 + n / 10) end)
    end

    after_low = fn states ->
      start()
      |> beat(10)
      |> frames([low.(%{status | battery_remaining: 20}, 10.1) | unsaid.(states)])
      |> Map.fetch!(:events)
    end

    assert [%{type: "battery.critical", data: data}, %{type: "battery.low"}] = after_low.([3])

    assert Map.delete(data, "position") ==
             %{"battery" => 0, "remaining" => nil, "voltage" => 11.0, "charge_state" => "CRITICAL"}

    # It is well again by its own word, then low by its own word. Knowing nothing is not being well.
    assert [
             %{type: "battery.low", data: %{"battery" => 0, "remaining" => nil}},
             %{type: "battery.recovered", data: %{"charge_state" => "OK", "level" => "ok"}},
             %{type: "battery.low"}
           ] = after_low.([1, 2])

    assert [%{type: "battery.low", data: %{"battery" => nil}}] = after_low.([0, 2])
  end

  test "texts over the budget are reported as one event when they end, also in a recording" do
    flood = for n <- 1..500, do: frame(%M.Statustext{severity: 6, text: "#{n}"}, 11 * @second + n * 1000)
    live = start() |> beat(10) |> frames(flood) |> tick(14) |> tick(15)
    assert Enum.frequencies(types(live)) == %{"statustext" => 60, "events.suppressed" => 1}
    assert %{type: "events.suppressed", time: 14_500_000, data: data} = hd(live.events)
    assert %{"of" => "statustext", "count" => 440, "text" => "440 more texts"} = data
    assert %{"first" => "1970-01-01T00:00:11.061Z", "last" => "1970-01-01T00:00:11.500Z"} = data

    # All in one read, with what comes much later.
    all = [frame(@copter, 10 * @second)] ++ flood ++ [frame(@copter, 60 * @second)]
    recorded = frames(start(), all)
    told = Enum.filter(recorded.events, &(&1.type == "events.suppressed"))
    assert Enum.map(told, &{&1.time, &1.data}) == [{14_500_000, data}]
  end

  test "a text that comes by two links is one event" do
    text = fn seq -> frame(%M.Statustext{severity: 6, text: "ready"}, 11 * @second, seq: seq) end
    run = start() |> beat(10) |> frames([text.(5)], "a") |> frames([text.(5)], "b")
    assert types(run) == ["statustext"]
    # The same text sent twice is two events.
    assert run |> frames([text.(6)], "a") |> types() == ["statustext", "statustext"]
  end

  test "H2: a companion's and a camera's texts are events that name them, and say nothing about the vehicle" do
    text = fn at, component, severity, text ->
      frame(%M.Statustext{severity: severity, text: text}, round(at * @second), component: component)
    end

    armed = frame(%{@copter | base_mode: 81 + 128}, 10 * @second)
    part = frame(%M.Heartbeat{type: 18, autopilot: 8}, 11 * @second, component: 191)
    # Before it is known which component is the autopilot.
    early = text.(9, 191, 6, "companion ready")

    run =
      start()
      |> frames([early, armed, part])
      |> frames([text.(11, 1, 4, "text of the autopilot"), text.(11.1, 191, 1, "obstacle: stopping")])
      |> frames([text.(11.2, 100, 2, "card full"), text.(11.3, 191, 2, "Battery 1 is critical: failsafe")])
      |> frames([text.(11.4, 100, 2, "Lost connection to GCS"), text.(11.5, 191, 6, "Mission complete")])
      |> frames([text.(11.6, 191, 2, "Fence breached"), text.(11.7, 191, 4, "RC failsafe on")])

    told = for %{type: "statustext", data: data} <- Enum.reverse(run.events), do: data

    assert Enum.map(told, &{&1["component"], &1["severity"], &1["text"]}) == [
             {191, 6, "companion ready"},
             {nil, 4, "text of the autopilot"},
             {191, 1, "obstacle: stopping"},
             {100, 2, "card full"},
             {191, 2, "Battery 1 is critical: failsafe"},
             {100, 2, "Lost connection to GCS"},
             {191, 6, "Mission complete"},
             {191, 2, "Fence breached"},
             {191, 4, "RC failsafe on"}
           ]

    assert types(run) -- List.duplicate("statustext", 9) == []
    # The autopilot's own word for the same counts.
    assert run |> frames([text.(12, 1, 4, "RC failsafe on")]) |> types() |> Enum.member?("rc.lost")
  end

  test "which component manages the gimbals is known by its own word, the autopilot's first" do
    status = &frame(%M.GimbalManagerStatus{gimbal_device_id: 154}, 11 * @second, component: &1)
    manager = &Core.snapshot(&1.core).memory.gimbal_manager
    run = start() |> beat(10)
    assert manager.(run) == nil
    run = frames(run, [status.(154), status.(191)])
    assert manager.(run) == 154
    assert run |> frames([status.(1), status.(154)]) |> manager.() == 1
  end

  test "a part that talks without end crowds out no text of the autopilot" do
    chatter = fn n ->
      frame(%M.Statustext{severity: 0, text: "#{n}"}, 11 * @second + n * 1000, component: 191)
    end

    # Texts that never end, of which only so many are kept.
    half = String.duplicate("a", 50)
    open = fn n -> %M.Statustext{severity: 4, id: n, text: half} end
    own = frame(open.(7), 11 * @second)
    others = for n <- 1..20, do: frame(open.(n), 11 * @second + n, component: 191)
    rest = frame(%M.Statustext{severity: 4, id: 7, chunk_seq: 1, text: "b"}, 11 * @second + 100)

    run = start() |> beat(10) |> frames([own] ++ others ++ [rest]) |> frames(for n <- 1..500, do: chatter.(n))
    run = frames(run, [frame(%M.Statustext{severity: 0, text: "crash"}, (11.6 * @second) |> round())])
    texts = for %{type: "statustext", data: data} <- run.events, data["component"] == nil, do: data["text"]
    assert texts == ["crash", half <> "b"]
  end

  test "missing chunks are given up by time alone" do
    half = frame(%M.Statustext{severity: 6, id: 3, text: String.duplicate("a", 50)}, 11 * @second)
    run = start() |> beat(10) |> frames([half]) |> tick(12.5)
    assert [%{type: "statustext", time: 12_000_000, data: %{"text" => text}}] = run.events
    assert String.ends_with?(text, "[…]")
  end

  test "the first autopilot that is heard counts; component 1 replaces it, another one does not" do
    other = frame(%{@copter | custom_mode: 6}, 11 * @second, component: 2)
    run = start() |> frames([other])
    assert Core.snapshot(run.core).component == 2
    run = beat(run, 12)
    assert %{component: 1, groups: %{mode: %{data: %{mode: "GUIDED"}}}} = Core.snapshot(run.core)
    run = frames(run, [%{other | at: 13 * @second}])
    assert %{component: 1, groups: %{mode: %{data: %{mode: "GUIDED"}}}} = Core.snapshot(run.core)
  end

  test "R6: the wrap of the clock after 49.7 days is not a reboot, in a silence either" do
    # Read at these seconds before and after the wrap, which comes at 7,230 s.
    attitude = fn n ->
      frame(%M.Attitude{time_boot_ms: Integer.mod(n * 1000, 0x100000000)}, (7_230 + n) * @second)
    end

    run =
      start() |> beat(10) |> frames(Enum.map(-7_210..-7_200, attitude)) |> frames(Enum.map(10..20, attitude))

    refute "reboot" in types(run)
    assert Core.snapshot(run.core).time_boot_ms == 20_000
  end

  test "R6: a reboot is an event, and streams are requested again" do
    attitude = fn at, boot -> frame(%M.Attitude{time_boot_ms: boot}, round(at * @second)) end
    before = for n <- 0..10, do: attitude.(10 + n, 600_000 + n * 1000)
    later = for n <- 0..10, do: attitude.(24 + n / 2, 500 + n * 500)
    run = start() |> beat(10) |> frames(before) |> frames(later)
    assert types(run) == ["reboot"]
    assert hd(run.events).data["time_boot_ms"] == 1500
    assert Core.snapshot(run.core).time_boot_ms == 5500
  end

  test "two vehicles with one id are a collision, once" do
    attitude = fn at, boot -> frame(%M.Attitude{time_boot_ms: boot}, round(at * @second)) end

    both =
      for n <- 0..20,
          f <- [attitude.(10 + n / 4, 600_000 + n * 250), attitude.(10 + n / 4 + 0.1, 90_000 + n * 250)],
          do: f

    run = start() |> beat(10) |> frames(both)
    assert types(run) == ["collision"]
    assert hd(run.events).data["sign"] == "time_boot_ms"
  end

  test "two vehicles on two links that were switched on within half a minute are distinguished by their positions; a late link is one vehicle" do
    place = fn at, boot, lat ->
      frame(%M.GlobalPositionInt{time_boot_ms: boot, lat: lat, lon: 85_000_000}, round(at * @second))
    end

    fly = fn late_s, lat ->
      Enum.reduce(0..20, start() |> beat(10, "a"), fn n, run ->
        boot = 60_000 + n * 250

        run
        |> frames([%{place.(10 + n / 4, boot, 473_000_000) | seq: n}], "a")
        |> frames([%{place.(10.1 + n / 4, boot - late_s * 1000, lat) | seq: n}], "b")
      end)
    end

    assert types(fly.(10, 473_400_000)) == ["collision"]
    # It flies 50 m/s.
    assert types(fly.(25, 473_000_000 + round(25 * 50 / 111_320 * 1.0e7))) == []
  end

  test "two vehicles on two links: the links are shown for a minute after the last sign" do
    place = fn at, lat ->
      frame(%M.GlobalPositionInt{time_boot_ms: 0, lat: lat, lon: 85_000_000}, round(at * @second))
    end

    run =
      Enum.reduce(0..20, start() |> beat(10, "a"), fn n, run ->
        run
        |> frames([%{place.(10 + n / 4, 473_000_000) | seq: n}], "a")
        |> frames([%{place.(10.1 + n / 4, 474_000_000) | seq: n}], "b")
      end)

    assert "collision" in types(run)

    assert %{data: %{"sign" => "position", "links" => [["a"], ["b"]]}} =
             Enum.find(run.events, &(&1.type == "collision"))

    assert %{sign: "position", links: [["a"], ["b"]]} = Core.snapshot(run.core).collision
    assert Core.snapshot(tick(run, 80).core).collision == nil
  end

  test "a sender that claims the id is reported when it goes on, and changes nothing" do
    claim = fn run, at, path ->
      {core, actions} = Core.handle(run.core, {:claimed, path, round(at * @second)})
      %{run | core: core, actions: run.actions ++ actions}
    end

    run = %{(start() |> beat(10, "a")) | actions: []}
    stranger = {"lan", {{10, 0, 0, 9}, 5_000}}
    once = claim.(run, 11, stranger)
    assert Core.snapshot(once.core).collision == nil
    # A vehicle that changes its address is heard by both once or twice.
    again = claim.(once, 30, stranger)
    assert Core.snapshot(again.core).collision == nil

    on = Enum.reduce(1..3, again, &claim.(&2, 30 + &1, stranger))
    assert %{sign: "claim", links: [["a"], ["lan (10.0.0.9:5000)"]]} = Core.snapshot(on.core).collision
    assert Enum.any?(on.actions, &match?({:observe, %{kind: :collision, data: %{sign: "claim"}}}, &1))
    refute Enum.any?(on.actions, &match?({:other_vehicle, _paths}, &1))
    assert Core.snapshot(on.core).groups == Core.snapshot(run.core).groups

    # Made-up senders without end take no memory.
    full = Enum.reduce(1..1_000, on, &claim.(&2, 34, {"lan", &1}))
    assert map_size(full.core.other_vehicle.claims) <= 16
  end

  describe "two vehicles with a path each" do
    defp fly(run, at, path, lat) do
      place = frame(%M.GlobalPositionInt{time_boot_ms: 0, lat: lat * 10_000_000, lon: 0}, round(at * @second))
      frames(run, [place], path)
    end

    # Both alternate until the collision is detected.
    defp both(one, other) do
      Enum.reduce(0..20, start() |> beat(9, one) |> beat(10, one), fn n, run ->
        run |> fly(10 + n / 4, one, 47) |> fly(10.1 + n / 4, other, 48)
      end)
    end

    defp lat(run), do: Core.snapshot(run.core).groups.position.data.lat
    defp other_paths(run), do: for({:other_vehicle, paths} <- Enum.reverse(run.actions), do: paths)

    test "the first one keeps the id, and the other one does not change its state" do
      run = both("a", "b")
      assert other_paths(run) == [["b"]]
      assert lat(run) == 47.0
      # Nor do its heartbeats: armed, in another mode.
      armed = frame(%{@copter | base_mode: 0xFF, custom_mode: 9}, 16 * @second)
      time = frame(%M.SystemTime{time_boot_ms: 5}, 16 * @second)
      uid = frame(%M.AutopilotVersion{uid: 5}, 16 * @second)
      run = frames(run, [armed, time, uid], "b")
      assert %{uid: nil} = Core.snapshot(run.core)
      assert %{groups: %{mode: %{data: %{armed: false}}}} = Core.snapshot(run.core)
      assert Core.snapshot(run.core).links == ["a"]
      # Both go on for minutes: one event, and they stay separated.
      run = Enum.reduce(20..200, run, fn n, run -> run |> fly(n, "a", 47) |> fly(n + 0.1, "b", 48) end)
      assert other_paths(run) == [["b"]] and lat(run) == 47.0
      assert Enum.count(types(run), &(&1 == "collision")) == 1
    end

    test "peers of one link are separated" do
      [p, q] = for port <- [1, 2], do: {"udp", {{10, 0, 0, 1}, port}}
      run = both(p, q)
      assert other_paths(run) == [[q]]
      assert lat(run) == 47.0
      assert %{links: [["udp (10.0.0.1:1)"], ["udp (10.0.0.1:2)"]]} = Core.snapshot(run.core).collision
      assert Core.snapshot(run.core).links == ["udp"]
    end

    test "when the first one falls silent the other one gets the id, and keeps it when the first one comes back" do
      run = both("a", "b")
      run = Enum.reduce(16..30, run, &fly(&2, &1, "b", 48))
      assert other_paths(run) == [["b"], []]
      assert lat(run) == 48.0

      run =
        Enum.reduce(1..20, run, fn n, run -> run |> fly(30 + n / 4, "a", 47) |> fly(30.1 + n / 4, "b", 48) end)

      assert List.last(other_paths(run)) == ["a"]
      assert lat(run) == 48.0
    end

    test "a minute after the last sign the collision is over" do
      run = both("a", "b")
      run = Enum.reduce(16..80, run, &fly(&2, &1, "a", 47))
      assert other_paths(run) == [["b"], []]
    end

    test "a restart of the processes detects it again" do
      run = both("a", "b")
      core = Core.new(run.core.options, Core.snapshot(run.core))
      {core, _actions} = Core.handle(core, {:tick, 16 * @second})
      assert core.other_vehicle.paths == []
    end
  end

  test "alternating heartbeats of two types are a collision; a single change is not" do
    plane = fn at -> frame(%{@copter | type: 1}, round(at * @second)) end
    run = Enum.reduce(1..5, start(), fn n, run -> run |> beat(10 + n) |> frames([plane.(10.5 + n)]) end)
    assert Enum.count(types(run), &(&1 == "collision")) == 1
    changed = start() |> beat(10) |> beat(11) |> frames(for n <- 12..20, do: plane.(n))
    refute "collision" in types(changed)
  end

  test "another unique id is also a collision" do
    version = fn at, uid -> frame(%M.AutopilotVersion{uid: uid}, at * @second) end
    run = start() |> beat(10) |> frames([version.(11, 1), version.(12, 2), version.(13, 1)])
    assert types(run) == ["collision"]
  end

  test "our heartbeat is due once a second, even for a lost vehicle; V2: alternating versions for one that speaks MAVLink 1" do
    old = frame(@copter, 10 * @second, version: 1)
    run = start() |> frames([old])
    run = Enum.reduce(1..50, run, &tick(&2, 10 + &1 / 10))
    beats = for {:heartbeat, version} <- run.actions, do: version
    assert length(beats) in 5..6
    assert Enum.frequencies(beats)[1] in 2..3 and Enum.frequencies(beats)[2] in 2..3
    both = for {:heartbeat, version} <- tick(beat(start(), 10), 12).actions, do: version
    assert Enum.uniq(both) == [2]
    assert for({:heartbeat, _} <- tick(beat(start(heartbeat: false), 10), 20).actions, do: 1) == []
  end

  describe "V1: the version in which a vehicle is spoken to" do
    @mavlink2 M.AutopilotVersion |> struct(capabilities: 0xFFFF)
    defp version(run), do: Core.snapshot(run.core).mavlink_version

    defp heard(run, seconds, versions),
      do:
        frames(
          run,
          for({v, n} <- Enum.with_index(versions), do: frame(@copter, (seconds + n) * @second, version: v))
        )

    test "is 2 while one of its radios speaks it, whatever came last" do
      assert start() |> heard(10, [1, 1]) |> version() == 1
      run = start() |> heard(10, [1, 2, 1, 1])
      assert version(run) == 2
      assert run |> heard(40, [1]) |> version() == 2
      assert run |> heard(42, [1]) |> version() == 1
      # Any frame of the autopilot, and nobody else's.
      attitude = frame(%M.Attitude{}, 13 * @second)
      assert start() |> heard(10, [1]) |> frames([attitude]) |> version() == 2
      assert start() |> heard(10, [1]) |> frames([%{attitude | component: 154}]) |> version() == 1
    end

    test "is 1 whatever its capabilities say: what it answers by that port has no mission_type either" do
      run = start() |> heard(10, [1]) |> frames([frame(@mavlink2, 11 * @second, version: 1)])
      assert version(run) == 1
      assert Core.snapshot(run.core).capabilities == 0xFFFF
    end

    test "outlives a crash of the session" do
      run = start() |> heard(10, [1])
      assert Core.new(options(), Core.snapshot(run.core)) |> Core.snapshot() |> Map.get(:mavlink_version) == 1
    end

    test "F9: a message of ours says only what it can say in it" do
      run = Enum.reduce(10..60, start(), fn at, run -> run |> heard(at, [1]) |> tick(at + 0.5) end)
      sent = for {:send, message, 1} <- run.actions, do: message
      assert Enum.any?(sent, &is_struct(&1, M.Timesync)) and Enum.any?(sent, &is_struct(&1, M.CommandLong))
      assert Enum.map(sent, &MavCodec.Message.unsayable(&1, 1)) |> Enum.uniq() == [nil]
    end
  end

  test "requesting streams can be switched off" do
    sent = fn run -> for {:send, _message, _version} <- run.actions, do: 1 end
    long = fn run -> Enum.reduce(1..200, run, &beat(&2, 10 + &1 / 10)) end
    assert start() |> long.() |> sent.() |> length() > 10
    off = [request_streams: false, timesync_us: 0, read_gcs_parameters: false]
    assert start(off) |> long.() |> sent.() == []
  end

  describe "another time" do
    test "a recording that begins again stops nothing and is not an event" do
      run = start() |> beat(1000) |> beat(1001) |> step({:rebase, 10 * @second})
      shown = length(for {:snapshot, _} <- run.actions, do: 1)
      run = Enum.reduce(1..20, run, &beat(&2, 10 + &1 / 2))
      assert types(run) == []
      assert length(for {:snapshot, _} <- run.actions, do: 1) > shown + 3
      assert Core.snapshot(run.core).last_heard == 20 * @second
      assert run |> tick(26) |> types() == ["link.lost"]
    end

    test "a clock that was set forward loses no vehicle" do
      run = start() |> beat(10) |> step({:rebase, 5_000_000 * @second}) |> beat(5_000_000.1)
      assert {types(run), statuses(run)} == {[], []}
    end

    for {name, step} <- [back: -3600, forward: 3600, "a little": 2.5] do
      test "set #{name} while it is heard: nothing becomes older or newer by it" do
        step = round(unquote(step) * @second)
        place = frame(%M.GlobalPositionInt{lat: 1, lon: 1, time_boot_ms: 1_000}, 11 * @second)
        run = start() |> beat(10) |> frames([place]) |> tick(12)
        run = step(%{run | actions: []}, {:shift, step})
        assert {types(run), statuses(run)} == {[], []}
        now = 12 * @second + step

        assert [{:snapshot, %{last_heard: heard, groups: groups}}] =
                 for({:snapshot, _} = s <- run.actions, do: s)

        assert now - heard == 1 * @second
        assert now - groups.position.at == 1 * @second
        # The silence continues: stale three, lost five seconds after the last frame.
        run = step(run, {:tick, now + round(1.9 * @second)})
        assert statuses(run) == []
        run = step(run, {:tick, now + 2 * @second})
        assert statuses(run) == [:stale]
        run = step(run, {:tick, now + 4 * @second})
        assert statuses(run) == [:stale, :lost]
        assert [%{type: "link.lost", time: time}] = run.events
        assert time == 16 * @second + step
      end
    end

    test "set back after a vehicle was lost: it was heard as long ago as before" do
      run = start() |> beat(10) |> tick(40) |> step({:shift, -3600 * @second})
      assert types(run) == ["link.lost"]
      snapshot = Core.snapshot(run.core)
      assert {snapshot.status, snapshot.last_heard} == {:lost, 10 * @second - 3600 * @second}
      run = beat(run, 41 - 3600)
      assert types(run) == ["link.lost", "link.restored"]
    end

    test "nothing changes for a vehicle that was never heard" do
      assert {_core, []} = Core.handle(Core.new(options([])), {:shift, @second})
    end

    test "a landed vehicle does not take off, and an incomplete text is published" do
      on_ground = frame(%M.ExtendedSysState{landed_state: 1}, 11 * @second)
      half = frame(%M.Statustext{severity: 6, id: 3, text: String.duplicate("a", 50)}, 11 * @second)
      active = frame(%{@copter | base_mode: 0xD1, system_status: 4}, 1 * @second)
      run = start() |> beat(10) |> frames([on_ground, half]) |> step({:rebase, @second}) |> frames([active])
      assert types(run) == ["statustext", "armed"]
    end

    test "a frame that is late by seconds: a ground station that was heard meanwhile is missed all the same (H5)" do
      station = %{system: 250, component: 190, type: 6, via: "radio", last_heard: 10 * @second}
      # PX4's failsafe waits for ten seconds.
      beat = fn run, at -> frames(run, [frame(%{@copter | autopilot: 12}, round(at * @second))]) end
      run = start() |> beat.(10) |> tick(11) |> step({:stations, [station]}) |> tick(12) |> tick(14.5)
      run = Enum.reduce(15..20, beat.(run, 11.5), &beat.(&2, &1 + 0.1))
      assert [%{type: "gcs.lost", time: 20_000_000}] = run.events
      assert Core.snapshot(run.core).last_heard == round(20.1 * @second)
    end
  end

  test "a change of mode is shown at once; the more vehicles there are, the less often other changes are" do
    shown = fn run -> length(for {:snapshot, _} <- run.actions, do: 1) end
    attitudes = for n <- 1..100, do: frame(%M.Attitude{time_boot_ms: 1000 + n}, 10 * @second + n * 1000)
    each = fn run -> Enum.reduce(attitudes, run, &frames(&2, [&1])) end
    assert start() |> beat(10) |> step({:vehicles, 1}) |> each.() |> shown.() == 101
    assert shown.(start() |> beat(10) |> step({:vehicles, 10}) |> each.()) in 10..13
    # Frames that are read together are shown together.
    assert shown.(start() |> beat(10) |> step({:vehicles, 1}) |> frames(attitudes)) == 2
    # 20 a second until there are 200 vehicles, then 4,000 of all.
    slowly = Enum.map(attitudes, &%{&1 | at: 10 * @second + 10 * (&1.at - 10 * @second)})
    a_second = fn run -> Enum.reduce(slowly, run, &frames(&2, [&1])) end
    assert shown.(start() |> beat(10) |> step({:vehicles, 200}) |> a_second.()) in 20..24
    assert shown.(start() |> beat(10) |> step({:vehicles, 400}) |> a_second.()) in 10..13
    run = start() |> beat(10) |> step({:vehicles, 1000}) |> each.()
    assert shown.(run) <= 4
    before = shown.(run)
    run = frames(run, [frame(%{@copter | custom_mode: 6}, 10 * @second + 100_500)])
    assert shown.(run) == before + 1

    assert {:snapshot, %{groups: %{mode: %{data: %{mode: "RTL"}}}}} =
             Enum.find(run.actions, &match?({:snapshot, _}, &1))
  end

  test "deadlines of more than 200 vehicles are checked less often than ten times a second, but four times at least" do
    ticks = for vehicles <- [1, 200, 400, 2_000], do: Core.tick_us(step(start(), {:vehicles, vehicles}).core)
    assert ticks == [100_000, 100_000, 200_000, 250_000]
    # Silent since 10 s: stale after three seconds. The check at 12.9 s is the last one before.
    silent = fn n, at -> statuses(start() |> beat(10) |> step({:vehicles, n}) |> tick(12.9) |> tick(at)) end
    assert {silent.(200, 13.0), silent.(400, 13.0), silent.(400, 13.1)} == {[:stale], [], [:stale]}
  end

  test "the link group has the rates" do
    run = start() |> beat(10) |> beat(10.5) |> beat(11.0) |> tick(12.1)
    assert %{status: :online, frames_per_s: rate, links: ["a"]} = Core.snapshot(run.core).groups.link.data
    assert rate > 0
  end

  test "impossible values are counted" do
    run = start() |> beat(10) |> frames([frame(%M.HomePosition{latitude: 950_000_000}, 11 * @second)])
    assert {:count, :invalid} in run.actions
  end

  test "restored from its snapshot it continues without an event, and detects what happened meanwhile" do
    armed = frame(%{@copter | base_mode: 0xD1}, 12 * @second)
    run = start() |> beat(10) |> beat(11)
    rebuild = fn run -> %{run | core: Core.new(options(), Core.snapshot(run.core))} end

    assert run |> rebuild.() |> beat(12) |> types() == []
    assert run |> rebuild.() |> frames([armed]) |> types() == ["armed"]

    assert run |> frames([armed]) |> rebuild.() |> frames([%{armed | at: 13 * @second}]) |> types() == [
             "armed"
           ]

    assert run |> tick(20) |> rebuild.() |> tick(21) |> beat(22) |> types() == ["link.lost", "link.restored"]
  end

  describe "properties" do
    defp message_gen do
      :proper_types.oneof([
        {:heartbeat, :proper_types.oneof([1, 1, 1, 1, 154, 190]), :proper_types.oneof([0, 0x80]),
         :proper_types.range(0, 5)},
        {:landed, :proper_types.range(0, 4)},
        {:fence, :proper_types.range(0, 1)},
        {:status, :proper_types.range(0, 100)},
        {:raw, :proper_types.oneof([1, 22, 24, 30, 33, 42, 46, 65, 74, 147, 148, 162, 235, 242, 245, 253]),
         :proper_types.binary()},
        :gap,
        :kill
      ])
    end

    defp message({:heartbeat, 1, armed, mode}, at) do
      frame(
        %M.Heartbeat{type: 2, autopilot: 3, base_mode: armed + 1, custom_mode: mode, system_status: 4},
        at
      )
    end

    defp message({:heartbeat, component, armed, mode}, at) do
      frame(%M.Heartbeat{type: 26, autopilot: 8, base_mode: armed + 1, custom_mode: mode}, at,
        component: component
      )
    end

    defp message({:landed, state}, at), do: frame(%M.ExtendedSysState{landed_state: state}, at)
    defp message({:fence, breach}, at), do: frame(%M.FenceStatus{breach_status: breach}, at)
    defp message({:status, remaining}, at), do: frame(%M.SysStatus{battery_remaining: remaining}, at)

    defp message({:raw, id, payload}, at) do
      %MavCodec.Frame{
        version: 2,
        system: 1,
        component: 1,
        id: id,
        payload: payload,
        bytes: payload,
        at: at,
        crc_extra: 0
      }
    end

    # `kills: false`: the same flight without the kills.
    defp fly(messages, kills) do
      {run, _at} =
        Enum.reduce(messages, {start(), @second}, fn
          :gap, {run, at} -> {run, at + 6 * @second}
          :kill, {run, at} when kills -> {%{run | core: Core.new(options(), shown(run))}, at}
          :kill, {run, at} -> {run, at}
          message, {run, at} -> {frames(run, [message(message, at)]), at + 100_000}
        end)

      %{run | events: Enum.reverse(run.events)}
    end

    defp shown(run),
      do:
        Enum.find_value(run.actions, fn
          {:snapshot, s} -> s
          _ -> nil
        end)

    test "whatever comes: it never raises, pairs alternate, numbers have no gap, only the autopilot makes events" do
      prop =
        :proper.forall(:proper_types.list(message_gen()), fn messages ->
          run = fly(messages, false)
          types = Enum.map(run.events, & &1.type)
          pairs = [{"armed", "disarmed"}, {"takeoff", "landed"}, {"link.lost", "link.restored"}]

          Enum.map(run.events, & &1.seq) == Enum.to_list(1..length(types)//1) and
            Enum.all?(pairs, fn {a, b} ->
              types
              |> Enum.filter(&(&1 in [a, b]))
              |> Enum.chunk_every(2, 1, :discard)
              |> Enum.all?(fn [x, y] -> x != y end)
            end) and
            (Enum.any?(messages, &(match?({:heartbeat, 1, _, _}, &1) or match?({:raw, 235, _}, &1))) or
               run.events == [])
        end)

      assert :proper.quickcheck(prop, [:quiet, numtests: 300]) == true, inspect(:proper.counterexample())
    end

    test "killed and restored at any time, the events are the same" do
      prop =
        :proper.forall(:proper_types.list(message_gen()), fn messages ->
          messages = Enum.reject(messages, &match?({:raw, _, _}, &1))

          pick = fn run ->
            for e <- run.events, e.type in ~w(armed disarmed mode_change), do: {e.type, e.data["to"]}
          end

          pick.(fly(messages, true)) == pick.(fly(messages, false))
        end)

      assert :proper.quickcheck(prop, [:quiet, numtests: 300]) == true, inspect(:proper.counterexample())
    end
  end
end
