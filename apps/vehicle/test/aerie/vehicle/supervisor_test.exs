defmodule Aerie.Vehicle.SupervisorTest do
  use Aerie.GatewayCase, async: true

  alias Aerie.Base.{Names, Store}
  alias Aerie.Vehicle

  test "a vehicle has one session, however many processes ask at once" do
    gateway = start_gateway()
    ask = fn _ -> Task.async(fn -> Vehicle.Supervisor.ensure(gateway, {"main", 1}) end) end
    answers = 1..50 |> Enum.map(ask) |> Task.await_many(Aerie.Patience.ms()) |> Enum.uniq()
    assert [{:ok, session}] = answers
    assert Names.whereis(gateway, :session, {"main", 1}) == session
    assert Aerie.GatewayCase.trees(gateway) == [{"main", 1}]
  end

  test "no more vehicles than allowed; a refusal is counted and does not affect the others" do
    gateway = start_gateway(%{limits: %{max_vehicles: 2}})
    {:ok, first} = Vehicle.Supervisor.ensure(gateway, {"main", 1})
    {:ok, _} = Vehicle.Supervisor.ensure(gateway, {"other", 1})
    assert Vehicle.Supervisor.ensure(gateway, {"main", 2}) == {:error, :too_many}
    assert Store.counter(gateway, {:vehicles, :refused}) == 1
    assert Vehicle.Supervisor.ensure(gateway, {"main", 1}) == {:ok, first}
  end

  test "a removed vehicle is gone and can come again" do
    gateway = start_gateway()
    {:ok, session} = Vehicle.Supervisor.ensure(gateway, {"main", 1})
    Store.put_vehicle(gateway, {"main", 1}, %{id: "VID-001"})
    ref = Process.monitor(session)
    :ok = Vehicle.Supervisor.remove(gateway, {"main", 1})
    assert_receive {:DOWN, ^ref, :process, _, _}
    assert Store.vehicle(gateway, "VID-001") == nil
    eventually(fn -> Aerie.GatewayCase.trees(gateway) == [] end)
    assert {:ok, again} = Vehicle.Supervisor.ensure(gateway, {"main", 1})
    assert again != session
    assert Vehicle.Supervisor.remove(gateway, {"main", 99}) == :ok
  end

  test "a gateway that is not running gives an error, not a crash" do
    assert Vehicle.Supervisor.ensure(make_ref(), {"main", 1}) == {:error, :not_running}
  end

  for role <- [:session, :events, :tree] do
    test "a killed #{role} is back, and other vehicles keep their processes" do
      gateway = start_gateway()
      {:ok, other} = Vehicle.Supervisor.ensure(gateway, {"main", 2})
      {:ok, session} = Vehicle.Supervisor.ensure(gateway, {"main", 1})
      Process.exit(Names.whereis(gateway, unquote(role), {"main", 1}), :kill)
      ref = Process.monitor(session)
      assert_receive {:DOWN, ^ref, :process, _, _}
      again = eventually(fn -> Names.whereis(gateway, :session, {"main", 1}) end)
      assert again != session
      assert Names.whereis(gateway, :session, {"main", 2}) == other
    end
  end

  test "the death of the restarter loses no vehicle" do
    gateway = start_gateway()
    {:ok, session} = Vehicle.Supervisor.ensure(gateway, {"main", 1})
    Process.exit(Names.whereis(gateway, :tree_restarter), :kill)
    eventually(fn -> Names.whereis(gateway, :tree_restarter) end)
    assert Names.whereis(gateway, :session, {"main", 1}) == session
    Process.exit(Names.whereis(gateway, :tree, {"main", 1}), :kill)
    eventually(fn -> Names.whereis(gateway, :session, {"main", 1}) not in [nil, session] end)
  end

  test "names: configured, by default, and never the same for two vehicles" do
    config = %{vehicle_id: "HERO", vehicles: [%{id: "VID-003", network: "main", system_id: 9}]}
    id = &Vehicle.Options.id(Vehicle.Settings.from(config), &1)
    assert id.({"main", 1}) == "HERO"
    assert id.({"main", 9}) == "VID-003"
    assert id.({"main", 2}) == "VID-002"
    assert id.({"main", 3}) == "main-sys-3"
    assert id.({"north", 1}) == "north-001"
    assert id.({"main", 4_294_967_295}) == "VID-4294967295"
  end
end
