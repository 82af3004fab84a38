defmodule Aerie.Vehicle.Session.CapacityTest do
  @moduledoc "More vehicles than limits.max_vehicles: which one is displaced, which has to wait, and what is kept of a displaced one."
  use Aerie.GatewayCase, async: true

  import Aerie.Flight, only: [frame: 3]
  import ExUnit.CaptureLog

  @moduletag :capture_log

  alias Aerie.Base.{Names, Store}
  alias Aerie.Vehicle
  alias Aerie.Vehicle.Events.Journal
  alias Aerie.Base.PubSub
  alias Aerie.Vehicle.Session.Capacity
  alias MavCodec.Messages, as: M

  @copter %M.Heartbeat{type: 2, autopilot: 3, base_mode: 81, custom_mode: 4, system_status: 3}
  @armed %{@copter | base_mode: 0xD1}

  defp lost(system, since, more \\ []),
    do: Enum.into(more, %{key: {"main", system}, since: since, armed: false, named: false})

  describe "which vehicle makes room" do
    test "the one that has been lost longest, if that is long enough" do
      lost = [lost(1, 500), lost(2, 100), lost(3, 900)]
      assert Capacity.pick(lost, 0, 1000) == {"main", 2}
      assert Capacity.pick(lost, 900, 1000) == {"main", 2}
      assert Capacity.pick(lost, 901, 1000) == nil
      assert Capacity.pick([], 0, 1000) == nil
    end

    test "never one with a name, and last one that was armed" do
      lost = [lost(1, 0, named: true), lost(2, 100, armed: true), lost(3, 900)]
      assert Capacity.pick(lost, 0, 1000) == {"main", 3}
      assert Capacity.pick(tl(lost), 500, 1000) == {"main", 2}
      assert Capacity.pick([hd(lost)], 0, 1000) == nil
    end

    test "property: it may be displaced, and no other one would come first" do
      vehicle =
        :proper_types.tuple([
          :proper_types.integer(1, 30),
          :proper_types.integer(0, 99),
          :proper_types.boolean(),
          :proper_types.boolean()
        ])

      property =
        :proper.forall(
          :proper_types.tuple([:proper_types.list(vehicle), :proper_types.integer(0, 120)]),
          fn {all, wait} ->
            all =
              for {system, since, armed, named} <- all, do: lost(system, since, armed: armed, named: named)

            may = Enum.filter(all, &(not &1.named and 100 - &1.since >= wait))

            case Capacity.pick(all, wait, 100) do
              nil ->
                may == []

              key ->
                Enum.any?(
                  may,
                  &(&1.key == key and Enum.all?(may, fn o -> {&1.armed, &1.since} <= {o.armed, o.since} end))
                )
            end
          end
        )

      assert :proper.quickcheck(property, [:quiet, numtests: 200]) == true, inspect(:proper.counterexample())
    end
  end

  describe "in a gateway for two vehicles" do
    defp gateway(limits, more \\ %{}) do
      limits = Map.merge(%{max_vehicles: 2, displace_lost_s: 0}, limits)
      config = Map.merge(%{limits: limits, timeouts: %{vehicle_stale_s: 0.1, vehicle_lost_s: 0.2}}, more)
      gateway = start_gateway(config, with: [:router])
      PubSub.subscribe(gateway, :events)
      gateway
    end

    # A heartbeat; the vehicle is lost 0.2 s after it.
    defp beat(gateway, system, message \\ @copter) do
      frames = [frame(message, System.os_time(:microsecond), system: system)]
      Aerie.Reader.deliver(gateway, %{id: "radio", network: "main", peer: :one}, frames)
    end

    defp await_lost(id), do: assert_receive({:fleet, :events, %{type: "link.lost", vehicle: ^id}})

    defp names(gateway), do: gateway |> Store.vehicles() |> Enum.map(& &1.id)

    # The event is committed just before the status is shown and noted.
    defp await_noted(gateway, key), do: :sys.get_state(Names.via(gateway, :session, key), Aerie.Patience.ms())

    test "a new vehicle displaces a lost one; event, counter and log say so" do
      gateway = gateway(%{})
      beat(gateway, 1)
      await_lost("VID-001")
      await_noted(gateway, {"main", 1})
      beat(gateway, 2)

      log = capture_log(fn -> assert %{delivered: 1} = beat(gateway, 3) end)

      assert_receive {:fleet, :events, %{type: "displaced", vehicle: "VID-001", data: data}}
      assert %{"by" => "VID-003", "lost_s" => lost_s} = data
      assert is_float(lost_s)
      assert log =~ "VID-001 has been lost for" and log =~ "makes room for VID-003"
      assert Store.counter(gateway, {:vehicles, :displaced}) == 1
      assert Store.counter(gateway, {:vehicles, :refused}) == 0
      eventually(fn -> Enum.sort(Aerie.GatewayCase.trees(gateway)) == [{"main", 2}, {"main", 3}] end)
      eventually(fn -> names(gateway) == ["VID-002", "VID-003"] end)
    end

    test "a displaced vehicle that comes back has its old name, and its events are numbered on" do
      gateway = gateway(%{displace_lost_s: 3600})
      for system <- [1, 2], do: beat(gateway, system)
      for id <- ["VID-001", "VID-002"], do: await_lost(id)
      for system <- [1, 2], do: await_noted(gateway, {"main", system})
      # It was never here, and neither has been lost for long enough.
      assert %{refused: 1} = beat(gateway, 3)
      assert Store.counter(gateway, {:vehicles, :refused}) == 1

      Vehicle.Supervisor.remove(gateway, {"main", 1})
      beat(gateway, 4)
      await_lost("VID-004")
      await_noted(gateway, {"main", 4})
      # This one was here before.
      assert %{delivered: 1} = beat(gateway, 1)
      assert_receive {:fleet, :events, %{type: "displaced", vehicle: "VID-002"}}
      assert_receive {:fleet, :events, %{type: "link.restored", vehicle: "VID-001", seq: 2}}
      eventually(fn -> names(gateway) == ["VID-001", "VID-004"] end)
    end

    test "a vehicle with a name keeps its place; one that was armed keeps it longer than others" do
      gateway = gateway(%{}, %{vehicles: [%{id: "HERO", network: "main", system_id: 1}]})
      beat(gateway, 1)
      await_lost("HERO")
      beat(gateway, 2, @armed)
      await_lost("VID-002")
      for system <- [1, 2], do: await_noted(gateway, {"main", system})
      assert %{delivered: 1} = beat(gateway, 3)
      assert_receive {:fleet, :events, %{type: "displaced", vehicle: "VID-002"}}
      await_lost("VID-003")
      await_noted(gateway, {"main", 3})
      assert %{delivered: 1} = beat(gateway, 4)
      assert_receive {:fleet, :events, %{type: "displaced", vehicle: "VID-003"}}
      assert {"main", 1} in Aerie.GatewayCase.trees(gateway)
    end

    test "a vehicle that is heard is never displaced, and one that is heard again is not lost any more" do
      gateway = gateway(%{max_vehicles: 1})
      beat(gateway, 1)
      await_lost("VID-001")
      await_noted(gateway, {"main", 1})
      assert {{"main", 1}, _lost_ms} = Capacity.displaced_by(gateway, {"main", 2})

      # On a busy machine it is lost again before it is asked.
      eventually(fn ->
        beat(gateway, 1)
        await_noted(gateway, {"main", 1})
        Capacity.displaced_by(gateway, {"main", 2}) == nil
      end)

      assert_receive {:fleet, :events, %{type: "link.restored"}}
      assert Aerie.GatewayCase.trees(gateway) == [{"main", 1}]
    end

    test "two newcomers displace two vehicles, and a third is refused" do
      gateway = gateway(%{})
      for system <- [1, 2], do: beat(gateway, system)
      for id <- ["VID-001", "VID-002"], do: await_lost(id)
      for system <- [1, 2], do: await_noted(gateway, {"main", system})

      answers =
        3..5
        |> Enum.map(&Task.async(fn -> Vehicle.Supervisor.ensure(gateway, {"main", &1}) end))
        |> Task.await_many(Aerie.Patience.ms())

      assert [{:error, :too_many}, {:ok, _}, {:ok, _}] = Enum.sort(answers)
      assert Store.counter(gateway, {:vehicles, :displaced}) == 2
    end
  end

  test "what is kept of removed vehicles is bounded; one that is back does not count" do
    gateway = start_gateway()
    event = &Vehicle.Event.new(&1, "armed", 1, 0, nil, %{})
    for n <- 1..1030, id = "V#{n}", do: Journal.commit(gateway, id, %{seq: 1}, [event.(id)])
    Store.count(gateway, {:vehicle, "V1", :odd})
    for n <- 1..1024, do: Journal.forget_vehicle(gateway, "V#{n}")
    Journal.forget_vehicle(gateway, "V1")
    assert Journal.state(gateway, "V1") == %{seq: 1}
    Journal.welcome(gateway, "V2")
    for n <- 1025..1028, do: Journal.forget_vehicle(gateway, "V#{n}")

    gone = for n <- 1..1030, Journal.state(gateway, "V#{n}") == nil, do: n
    # V1 was removed again after V1024, V2 is back.
    assert gone == [3, 4, 5]
    assert Journal.recent(gateway, "V3") == []
    # Events that wait for NATS stay.
    assert Journal.pending_size(gateway) == 1030
    assert Store.counter(gateway, {:vehicle, "V1", :odd}) == 1
    for n <- 2001..3030, do: Journal.forget_vehicle(gateway, "V#{n}")
    assert Store.counter(gateway, {:vehicle, "V1", :odd}) == 0
  end
end
