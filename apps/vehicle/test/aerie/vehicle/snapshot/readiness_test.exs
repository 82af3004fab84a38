defmodule Aerie.Vehicle.Snapshot.ReadinessTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.Json.Object
  alias Aerie.Vehicle.{Event, Snapshot}
  alias Aerie.Vehicle.Snapshot.Readiness

  @now 1_763_800_000_000_000
  @firmwares [ardupilot: "GUIDED", px4: "AUTO_LOITER", betaflight: "ANGLE", inav: "ANGLE"]

  defp vehicle(firmware, changes \\ [], more \\ %{}) do
    groups = [
      mode: %{mode: @firmwares[firmware], armed: false, in_air: false},
      battery: %{remaining: 0.8, voltage: 16.1, charge_state: "OK"},
      gps: %{fix: 3, satellites: 12},
      home: %{lat: 47.4, lon: 8.5, alt_msl: 450.0},
      health: %{ready_to_arm: true, unhealthy: [], arming_checks: []}
    ]

    groups =
      Enum.reduce(changes, groups, fn {name, data}, all -> Keyword.update!(all, name, &merge(&1, data)) end)

    struct!(
      Snapshot,
      Map.merge(
        %{
          id: "V",
          key: {"main", 1},
          system_id: 1,
          autopilot: firmware,
          vehicle_type: "copter",
          status: :online,
          last_heard: @now - 100_000,
          time_boot_ms: 600_000,
          groups: for({name, data} <- groups, data != nil, into: %{}, do: {name, %{at: @now, data: data}})
        },
        more
      )
    )
  end

  defp merge(_data, nil), do: nil
  defp merge(data, changes), do: Map.merge(data, changes)

  defp of(vehicle, more \\ %{}) do
    beside = %{
      now: @now,
      links: [],
      events: [],
      aboard: %{},
      holder: nil,
      viewer: "ann",
      reserve: 0.4,
      floor: nil
    }

    Readiness.of(vehicle, Map.merge(beside, more))
  end

  defp point(readiness, name), do: Enum.find(readiness.points, &(&1.name == name))
  defp state(readiness, name), do: point(readiness, name).state

  for {firmware, _mode} <- @firmwares do
    test "a vehicle of #{firmware} of which all is well is ready, and nothing is to be done" do
      readiness = of(vehicle(unquote(firmware)))
      assert %{state: :ready} = readiness
      assert Enum.all?(readiness.points, &(&1.state == :ready and &1.todo == nil and &1.text != ""))
      assert Readiness.open(readiness) == []
    end

    # Each part taken away, one after the other and all at once.
    test "a vehicle of #{firmware} of which something is not known is never ready" do
      for name <- [:battery, :gps, :health, :mode] do
        assert %{state: state} = of(vehicle(unquote(firmware), [{name, nil}]))
        assert state != :ready, "#{name}"
      end

      assert %{state: state} = of(vehicle(unquote(firmware), [], %{groups: %{}}))
      assert state != :ready
      assert %{state: :unknown} = of(vehicle(unquote(firmware), [], %{last_heard: nil}))
    end
  end

  test "the worst point decides, and the points have a fixed order" do
    names = for point <- of(vehicle(:ardupilot)).points, do: point.name
    assert names == ~w(link ground battery gps home arming mode fence mission charge boot)a

    bad = vehicle(:ardupilot, [gps: %{satellites: 7}, battery: %{remaining: nil}], %{status: :stale})
    readiness = of(bad)
    assert readiness.state == :not_ready

    assert Enum.map(Readiness.open(readiness), &{&1.name, &1.state}) ==
             [link: :not_ready, battery: :unknown, gps: :check]

    assert of(%{bad | status: :online}).state == :unknown
    assert of(vehicle(:ardupilot, gps: %{satellites: 7})).state == :check
  end

  test "a link that is late, lost or slow" do
    late = vehicle(:px4, [], %{last_heard: @now - 3_500_000})
    assert %{state: :check, text: "It was last heard 3 s ago."} = point(of(late), :link)
    assert state(of(%{late | status: :lost}), :link) == :not_ready
    assert state(of(vehicle(:px4, [], %{collision: %{at: @now}})), :link) == :not_ready
    assert state(of(vehicle(:px4, [], %{high_latency: %{only?: true}})), :link) == :check
  end

  test "the charge against the reserve and the policy's limit, never rounded up" do
    left = fn left, more -> point(of(vehicle(:ardupilot, battery: %{remaining: left}), more), :battery) end
    assert %{state: :ready} = left.(0.4, %{})
    assert %{state: :not_ready, text: "39 % left; 40 % are wanted."} = left.(0.399, %{})

    assert %{state: :not_ready, text: "45 % left; the policy wants 50 %" <> _rest} =
             left.(0.45, %{floor: 0.5})

    assert %{state: :unknown, text: "Only its voltage is known, 16.1 V."} = left.(nil, %{})

    for charge <- ~w(CRITICAL EMERGENCY FAILED UNHEALTHY) do
      vehicle = vehicle(:px4, battery: %{charge_state: charge, remaining: 0.9})
      assert state(of(vehicle), :battery) == :not_ready
    end
  end

  test "a value of which no newer one came for a minute is not known" do
    old = put_in(vehicle(:ardupilot).groups[:gps].at, @now - 61_000_000)
    assert state(of(old), :gps) == :unknown
  end

  test "GPS without a position, and with few satellites" do
    assert state(of(vehicle(:px4, gps: %{fix: 2})), :gps) == :not_ready
    assert state(of(vehicle(:px4, gps: %{satellites: nil})), :gps) == :unknown
  end

  test "the firmware's own texts say why it cannot be armed" do
    events = [
      Event.new("V", "statustext", 1, @now - 5_000_000, nil, %{
        "text" => "PreArm: Compass variance",
        "severity" => 2
      })
    ]

    failing = vehicle(:ardupilot, health: %{ready_to_arm: false})
    assert %{state: :not_ready, text: "Compass variance."} = point(of(failing, %{events: events}), :arming)
    assert %{text: "Its arming checks fail; it does not say which."} = point(of(failing), :arming)

    checks = for n <- 1..10, do: %{id: "#{n}", name: "check_#{n}", severity: 3}
    many = vehicle(:px4, health: %{ready_to_arm: false, arming_checks: checks})
    assert %{text: "check 1; " <> rest} = point(of(many), :arming)
    assert rest =~ "and 2 more."

    assert state(of(vehicle(:inav, health: %{ready_to_arm: nil})), :arming) == :unknown
    assert state(of(vehicle(:px4, mode: %{armed: true})), :arming) == :check
    assert state(of(vehicle(:px4, mode: %{failsafe: true})), :arming) == :not_ready
  end

  test "a mode in which it cannot be armed is named with the one to set, and one in the air is not ready" do
    assert %{state: :check, text: text} = point(of(vehicle(:ardupilot, mode: %{mode: "LAND"})), :mode)
    assert text =~ "LAND"
    assert %{state: :not_ready} = of(vehicle(:px4, mode: %{in_air: true, armed: true}))
    assert point(of(vehicle(:ardupilot, [], %{vehicle_type: "rover"})), :ground) == nil
  end

  test "fence and mission aboard as they are wanted" do
    aboard = &point(of(vehicle(:px4), %{aboard: &1}), &2)
    assert %{state: :ready} = aboard.(%{"mission.plan" => :converged}, :mission)
    assert %{state: :not_ready} = aboard.(%{"mission.plan" => :pending}, :mission)

    assert %{state: :not_ready} =
             aboard.(%{"geofence.plan" => :converged, "geofence.enabled" => :refused}, :fence)

    assert %{state: :unknown} = aboard.(%{"geofence.plan" => :unseen}, :fence)

    breach = put_in(vehicle(:px4).groups[:mission], %{at: @now, data: %{fence_breach: true}})
    assert state(of(breach), :fence) == :not_ready
  end

  test "somebody else in charge, oneself, and a look as the holder has it" do
    charge = &point(of(vehicle(:px4), %{holder: "bob", viewer: &1}), :charge)
    assert %{state: :not_ready, text: "bob is in charge of it."} = charge.("ann")
    assert %{state: :not_ready} = charge.(nil)
    assert %{state: :ready} = charge.("bob")
    assert %{state: :ready, text: "bob is in charge of it."} = charge.(:anybody)
  end

  test "one that was just started, and one whose clock is not heard" do
    assert state(of(vehicle(:px4, [], %{time_boot_ms: 5_000})), :boot) == :check
    assert state(of(vehicle(:px4, [], %{time_boot_ms: nil})), :boot) == :unknown
    assert point(of(vehicle(:betaflight, [], %{time_boot_ms: nil})), :boot) == nil
  end

  test "is shown with every point" do
    shown = Object.show(Readiness.Points.fields(), of(vehicle(:ardupilot, battery: %{remaining: 0.2})))
    assert %{state: :not_ready, points: points} = shown
    assert %{name: :battery, title: "Battery", todo: "Change or charge the battery."} = Enum.at(points, 2)
  end

  # Any part missing, and any value in its place that messages can bring.
  test "never ready without what decides it, whatever else is known" do
    check = fn changes ->
      %{state: state, points: points} =
        of(vehicle(changes.firmware, changes.groups, %{last_heard: changes.heard}))

      worst =
        Enum.min_by(
          points,
          &Enum.find_index([:not_ready, :unknown, :check, :ready], fn s -> s == &1.state end)
        )

      assert state == worst.state

      missing? = Enum.any?(changes.groups, &match?({_group, nil}, &1)) or changes.heard == nil
      if missing?, do: assert(state != :ready)
    end

    for firmware <- Keyword.keys(@firmwares),
        heard <- [nil, @now, @now - 10_000_000],
        battery <- [nil, %{remaining: nil}, %{remaining: 0.0}, %{remaining: 1.0}],
        gps <- [nil, %{fix: nil}, %{fix: 0}, %{fix: 6}],
        mode <- [nil, %{mode: nil}, %{in_air: nil}, %{armed: nil}, %{}],
        health <- [nil, %{ready_to_arm: nil}, %{ready_to_arm: false}, %{}] do
      check.(%{
        firmware: firmware,
        heard: heard,
        groups: [battery: battery, gps: gps, mode: mode, health: health]
      })
    end
  end
end
