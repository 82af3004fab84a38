defmodule Aerie.Fleet.AlarmsTest do
  use ExUnit.Case, async: true

  alias Aerie.Fleet.Diagnosis.Condition
  alias Aerie.Vehicle.Event
  alias Aerie.Fleet.Alarms
  alias Aerie.Fleet.Alarms.{Conditions, EventAlarms}

  defp condition(key, severity \\ :warning),
    do: %{key: key, severity: severity, text: inspect(key), vehicle: nil}

  defp event(type, data), do: Event.new("V-1", type, 1, 5_000, nil, data)
  defp states(alarms), do: for(alarm <- Alarms.list(alarms), do: {alarm.key, Alarms.state(alarm)})

  describe "the list" do
    test "an alarm stays until it is over and somebody has seen it, in either order" do
      held = Alarms.new() |> Alarms.put(:a, [condition({:link, 1})], 10)
      assert [{{:link, 1}, :active}] = states(held)

      over = Alarms.put(held, :a, [], 20)
      assert [{{:link, 1}, :over}] = states(over)
      assert states(Alarms.acknowledge(over, :all, "ann")) == []

      [%{id: id}] = Alarms.list(held)
      seen = Alarms.acknowledge(held, [id], "ann")
      assert [%{by: "ann", since: 10}] = Alarms.list(seen)
      assert states(Alarms.put(seen, :a, [], 30)) == []
    end

    test "the same condition told again is the same alarm; one that got worse has to be seen again" do
      alarms = Alarms.new() |> Alarms.put(:a, [condition({:battery, "V"})], 10)
      alarms = alarms |> Alarms.acknowledge(:all, "ann") |> Alarms.put(:a, [condition({:battery, "V"})], 20)
      assert [%{by: "ann", since: 10}] = Alarms.list(alarms)

      assert [%{by: nil, since: 30}] =
               alarms |> Alarms.put(:a, [condition({:battery, "V"}, :critical)], 30) |> Alarms.list()
    end

    test "one that comes back after it was over is a new one" do
      alarms = Alarms.new() |> Alarms.put(:a, [condition({:link, 1})], 10) |> Alarms.put(:a, [], 20)

      assert [%{since: 30, over: nil, id: "a2"}] =
               alarms |> Alarms.put(:a, [condition({:link, 1})], 30) |> Alarms.list()
    end

    test "a source speaks for itself alone" do
      alarms = Alarms.new() |> Alarms.put(:a, [condition({:link, 1})], 10) |> Alarms.put(:b, [], 20)
      assert [{{:link, 1}, :active}] = states(alarms)
    end

    test "the unseen come first, then the severe, then the new; only unseen ones sound" do
      alarms =
        Alarms.new()
        |> Alarms.put(:a, [condition({:x, 1}, :notice), condition({:x, 2}, :critical)], 10)
        |> Alarms.put(:b, [condition({:x, 3})], 20)

      assert [{:x, 2}, {:x, 3}, {:x, 1}] = Enum.map(Alarms.list(alarms), & &1.key)

      assert %{sound: :critical, waiting: 3, counts: %{critical: 1, warning: 1, notice: 1}} =
               Alarms.summary(alarms)

      [%{id: critical} | _rest] = Alarms.list(alarms)
      alarms = Alarms.acknowledge(alarms, [critical], "ann")
      assert %{sound: :warning, first: %{key: {:x, 3}}} = Alarms.summary(alarms)
      assert %{sound: nil} = alarms |> Alarms.acknowledge(:all, "ann") |> Alarms.summary()
    end

    test "it is bounded, and keeps what matters" do
      many = for n <- 1..300, do: condition({:x, n}, :notice)
      alarms = Alarms.new() |> Alarms.put(:a, [condition({:y, 1}, :critical) | many], 10)
      assert length(Alarms.list(alarms)) == 200
      assert alarms.dropped == 101
      assert hd(Alarms.list(alarms)).key == {:y, 1}
    end
  end

  describe "events" do
    test "each that begins something raises an alarm, and the one that ends it ends the alarm" do
      for {begins, ends, data} <- [
            {"failsafe", "failsafe.cleared", %{"type" => "rc", "reason" => "radio", "action" => "rtl"}},
            {"geofence", "geofence.cleared", %{"breach" => "MAX_ALT"}},
            {"rc.lost", "rc.restored", %{}},
            {"gps.lost", "gps.restored", %{}},
            {"position.lost", "position.restored", %{}},
            {"kill_switch.engaged", "kill_switch.released", %{}},
            {"gcs.lost", "gcs.restored", %{}},
            {"battery.low", "reboot", %{"remaining" => 0.2}}
          ] do
        alarms = EventAlarms.apply(Alarms.new(), event(begins, data))
        assert [%{over: nil, text: <<_first, _rest::binary>>, vehicle: "V-1"}] = Alarms.list(alarms)
        assert [%{over: 5_000}] = alarms |> EventAlarms.apply(event(ends, data)) |> Alarms.list()

        assert alarms |> EventAlarms.apply(event("statustext", %{"text" => "x"})) |> Alarms.list() ==
                 Alarms.list(alarms)
      end
    end

    test "a battery that gets worse is one alarm that got worse" do
      alarms =
        for type <- ["battery.low", "battery.critical"], reduce: Alarms.new() do
          alarms ->
            alarms |> EventAlarms.apply(event(type, %{"remaining" => 0.1})) |> Alarms.acknowledge(:all, "ann")
        end

      assert [%{severity: :critical, text: "Battery nearly empty, 10 % left"}] = Alarms.list(alarms)
    end
  end

  test "an alarm's text follows the value, and keeps the last one of a lost vehicle (F13)" do
    alarms = EventAlarms.apply(Alarms.new(), event("battery.critical", %{"remaining" => 0.1}))
    battery = fn status, data -> [%{id: "V-1", status: status, groups: %{battery: %{data: data}}}] end

    text = fn vehicles ->
      alarms |> EventAlarms.follow(vehicles) |> Alarms.list() |> hd() |> Map.fetch!(:text)
    end

    assert text.(battery.(:online, %{remaining: 0.06})) == "Battery nearly empty, 6 % left"
    assert text.(battery.(:online, %{remaining: nil, voltage: 9.61})) == "Battery nearly empty, 9.6 V"

    assert text.(battery.(:online, %{remaining: 0.9, batteries: [%{remaining: 0.9}, %{remaining: 0.04}]})) =~
             "4 %"

    for vehicles <- [[], battery.(:lost, %{remaining: 0.06}), battery.(:online, %{})],
        do: assert(text.(vehicles) == "Battery nearly empty, 10 % left")
  end

  describe "snapshots" do
    test "a vehicle that falls silent counts by what it was doing" do
      flying = %{id: "V", status: :lost, groups: %{mode: %{data: %{armed: true}}}}
      assert [%{severity: :critical}] = Conditions.vehicle(flying)
      assert [%{severity: :warning}] = Conditions.vehicle(%{flying | status: :stale})
      assert [] = Conditions.vehicle(%{flying | status: :online})
      assert [%{severity: :notice}] = Conditions.vehicle(%{flying | groups: %{}})
      assert [] = Conditions.vehicle(%{id: "V", status: :stale, groups: %{}})
    end

    test "an emergency" do
      vehicle = %{id: "V", status: :online, groups: %{mode: %{data: %{failsafe: true}}}}
      assert [%{key: {:emergency, "V"}, severity: :critical}] = Conditions.vehicle(vehicle)
      assert [] = Conditions.vehicle(%{vehicle | groups: %{}})
    end

    test "a link that is down" do
      link = %{id: "l", status: :up, text: "up"}
      assert [] = Conditions.link(link)
      assert [%{key: {:link, "l"}}] = Conditions.link(%{link | status: :waiting})
    end

    test "of the diagnosis, collisions, overload, damaged frames and a hub that stores nothing are alarms" do
      condition =
        &Condition.new(&1, &2, &3, title: "about #{subject(&3)}", mend: "mend it", evidence: [])

      assert [] = Conditions.diagnosed([condition.(:mavlink1_only, :notice, {:vehicle, "V"})])

      assert [
               %{vehicle: "V", severity: :critical, text: "about V"},
               %{vehicle: nil, severity: :critical, text: "about l"},
               %{vehicle: nil, severity: :warning},
               %{vehicle: nil, severity: :warning, key: {:hub_not_confirming, :gateway}}
             ] =
               Conditions.diagnosed([
                 condition.(:two_vehicles_one_id, :error, {:vehicle, "V"}),
                 condition.(:overload, :error, {:link, "l"}),
                 condition.(:noisy_link, :warning, {:link, "l"}),
                 condition.(:hub_not_confirming, :error, :gateway)
               ])
    end

    defp subject({_kind, id}), do: id
    defp subject(:gateway), do: "the gateway"

    test "the gateway itself" do
      assert [] = Conditions.gateway(%{alarm: nil}, nil, nil)

      conditions =
        Conditions.gateway(%{alarm: "an autopilot has our ids"}, "not connected to NATS", "is full")

      assert [:critical, :warning, :warning] = Enum.map(conditions, & &1.severity)
    end
  end
end
