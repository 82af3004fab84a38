defmodule Aerie.Fleet.Alarms.CoreTest do
  use ExUnit.Case, async: true

  alias Aerie.Fleet.Diagnosis.Condition
  alias Aerie.Vehicle.Event
  alias Aerie.Fleet.Alarms.{Conditions, Core, Detected}

  defp condition(key, severity \\ :warning),
    do: %{key: key, severity: severity, text: inspect(key), vehicle: nil}

  defp event(type, data), do: Event.new("V-1", type, 1, 5_000, nil, data)
  defp states(alarms), do: for(alarm <- Core.list(alarms), do: {alarm.key, Core.state(alarm)})

  describe "the list" do
    test "an alarm stays until it is over and somebody has seen it, in either order" do
      held = Core.new() |> Core.put(:a, [condition({:link, 1})], 10)
      assert [{{:link, 1}, :active}] = states(held)

      over = Core.put(held, :a, [], 20)
      assert [{{:link, 1}, :over}] = states(over)
      assert states(Core.acknowledge(over, :all, "ann")) == []

      [%{id: id}] = Core.list(held)
      seen = Core.acknowledge(held, [id], "ann")
      assert [%{by: "ann", since: 10}] = Core.list(seen)
      assert states(Core.put(seen, :a, [], 30)) == []
    end

    test "the same condition told again is the same alarm; one that got worse has to be seen again" do
      alarms = Core.new() |> Core.put(:a, [condition({:battery, "V"})], 10)
      alarms = alarms |> Core.acknowledge(:all, "ann") |> Core.put(:a, [condition({:battery, "V"})], 20)
      assert [%{by: "ann", since: 10}] = Core.list(alarms)

      assert [%{by: nil, since: 30}] =
               alarms |> Core.put(:a, [condition({:battery, "V"}, :critical)], 30) |> Core.list()
    end

    test "one that comes back after it was over is a new one" do
      alarms = Core.new() |> Core.put(:a, [condition({:link, 1})], 10) |> Core.put(:a, [], 20)

      assert [%{since: 30, over: nil, id: "a2"}] =
               alarms |> Core.put(:a, [condition({:link, 1})], 30) |> Core.list()
    end

    test "a source speaks for itself alone" do
      alarms = Core.new() |> Core.put(:a, [condition({:link, 1})], 10) |> Core.put(:b, [], 20)
      assert [{{:link, 1}, :active}] = states(alarms)
    end

    test "the unseen come first, then the severe, then the new; only unseen ones sound" do
      alarms =
        Core.new()
        |> Core.put(:a, [condition({:x, 1}, :notice), condition({:x, 2}, :critical)], 10)
        |> Core.put(:b, [condition({:x, 3})], 20)

      assert [{:x, 2}, {:x, 3}, {:x, 1}] = Enum.map(Core.list(alarms), & &1.key)

      assert %{sound: :critical, waiting: 3, counts: %{critical: 1, warning: 1, notice: 1}} =
               Core.summary(alarms)

      [%{id: critical} | _rest] = Core.list(alarms)
      alarms = Core.acknowledge(alarms, [critical], "ann")
      assert %{sound: :warning, first: %{key: {:x, 3}}} = Core.summary(alarms)
      assert %{sound: nil} = alarms |> Core.acknowledge(:all, "ann") |> Core.summary()
    end

    test "it is bounded, and keeps what matters" do
      many = for n <- 1..300, do: condition({:x, n}, :notice)
      alarms = Core.new() |> Core.put(:a, [condition({:y, 1}, :critical) | many], 10)
      assert length(Core.list(alarms)) == 200
      assert alarms.dropped == 101
      assert hd(Core.list(alarms)).key == {:y, 1}
    end
  end

  describe "what detectors found" do
    defp detected(type, data, subject \\ nil), do: %{type: type, subject: subject, since: 4_000, data: data}

    defp vehicle(battery \\ %{}, changes \\ %{}),
      do: Map.merge(%{id: "V-1", status: :online, via: nil, groups: %{battery: %{data: battery}}}, changes)

    defp put(alarms \\ Core.new(), conditions, vehicle \\ vehicle()),
      do: Detected.put(alarms, %{"V-1" => conditions}, [vehicle], 9_000)

    defp texts(alarms), do: for(alarm <- Core.list(alarms), do: {alarm.text, alarm.over})

    test "each of the table is an alarm while it holds, and over when it does not, without any event" do
      for %{type: type, begins: {_kind, severity, text}} <- Event.Types.all() do
        held = put([detected(type, %{})])
        assert [%{over: nil, since: 4_000, severity: ^severity, vehicle: "V-1"} = alarm] = Core.list(held)
        assert String.starts_with?(alarm.text, text)
        assert put(held, [detected(type, %{})]) == held
        assert [%{over: 9_000}] = held |> put([]) |> Core.list()
      end
    end

    test "one that has ended before it was looked at stays until somebody has seen it" do
      alarms = Detected.told(Core.new(), event("gps.lost", %{}), [])
      assert [{{:gps, "V-1"}, :over}] = states(alarms)
      assert [] = alarms |> put([]) |> Core.acknowledge(:all, "ann") |> states()

      assert [] =
               Core.new() |> Detected.told(event("gps.lost", %{}), [detected("gps.lost", %{})]) |> states()

      assert [] = Core.new() |> Detected.told(event("statustext", %{"text" => "x"}), []) |> states()

      # A battery that is critical was low on the way.
      critical = detected("battery.critical", %{"remaining" => 0.04})

      assert [] =
               Core.new()
               |> Detected.told(event("battery.low", %{"remaining" => 0.2}), [critical])
               |> states()
    end

    test "a battery that gets worse is one alarm that got worse; one that gets better is one that got better" do
      low = put([detected("battery.low", %{"remaining" => 0.2})]) |> Core.acknowledge(:all, "ann")
      critical = put(low, [detected("battery.critical", %{"remaining" => 0.1})])

      assert [%{severity: :critical, by: nil, text: "Battery nearly empty, 10 % left"}] =
               Core.list(critical)

      assert [%{severity: :warning, text: "Battery low, 21 % left"}] =
               critical |> put([detected("battery.low", %{"remaining" => 0.21})]) |> Core.list()
    end

    test "of several batteries each is an alarm of its own, and is named" do
      one = &detected("battery.low", %{"remaining" => &1, "battery" => &2, "several" => true}, &3)
      both = put([one.(0.2, 0, nil), one.(0.1, 1, 1)])

      assert Enum.sort(texts(both)) == [
               {"Battery low (battery 0), 20 % left", nil},
               {"Battery low (battery 1), 10 % left", nil}
             ]

      assert {"Battery low (battery 0), 20 % left", 9_000} in texts(put(both, [one.(0.1, 1, 1)]))
    end

    test "an alarm's text follows the value, and says what is not known (F13)" do
      text = fn data, battery ->
        Core.new()
        |> put([detected("battery.critical", data)], vehicle(battery))
        |> texts()
        |> hd()
        |> elem(0)
      end

      assert text.(%{"remaining" => 0.06}, %{}) == "Battery nearly empty, 6 % left"
      assert text.(%{"remaining" => nil}, %{id: nil, voltage: 9.61}) == "Battery nearly empty, 9.6 V"

      assert text.(%{"remaining" => nil, "battery" => 1}, %{id: 0, voltage: 9.61}) ==
               "Battery nearly empty, charge unknown"

      assert text.(%{"remaining" => 0.94, "said" => "CRITICAL"}, %{}) ==
               "Battery nearly empty, 94 % left, the vehicle says CRITICAL"
    end

    test "a lost vehicle keeps what was known last; another gateway's, or one that was removed, has none here" do
      conditions = [detected("failsafe", %{"reason" => "radio", "action" => "rtl"}, {"rc", "radio"})]

      assert [{"Failsafe: radio → rtl", nil}] =
               texts(put(Core.new(), conditions, vehicle(%{}, %{status: :lost})))

      held = put(conditions)

      assert [{"Failsafe: radio → rtl", 9_000}] =
               texts(put(held, conditions, vehicle(%{}, %{via: "companion"})))

      assert [{_text, 9_000}] = held |> Detected.put(%{"V-1" => conditions}, [], 9_000) |> texts()
    end
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
