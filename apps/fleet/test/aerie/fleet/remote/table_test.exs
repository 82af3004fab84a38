defmodule Aerie.Fleet.Remote.TableTest do
  @moduledoc "Vehicles of other gateways in the model of all vehicles."
  use ExUnit.Case, async: true

  alias Aerie.Base.Store
  alias Aerie.Fleet
  alias Aerie.Fleet.Remote.Table

  @now 1_800_000_000_000_000
  @s 1_000_000
  @facts %Aerie.Vehicle.Snapshot{
    network: "main",
    system_id: 1,
    autopilot: :px4,
    vehicle_type: "copter",
    firmware: nil,
    status: :online,
    last_heard: @now
  }

  setup do
    gateway = make_ref()
    start_supervised!({Store, [gateway: gateway] ++ Aerie.GatewayCase.plugs(%{})})
    :ok = Table.configure(gateway, %{stale_us: 5 * @s, lost_us: 10 * @s})
    %{gateway: gateway}
  end

  defp group(at, via \\ "g", data \\ %{mode: "AUTO"}), do: %{data: data, at: at, time_boot_ms: nil, via: via}

  test "a vehicle is as its gateway says, and stale and lost when that falls silent", %{gateway: gateway} do
    Table.put_gateway(gateway, "V", "g", @facts, @now)
    Table.put(gateway, "V", :mode, group(@now))

    assert %{status: :online, via: "g", groups: %{mode: %{via: "g"}}} =
             Table.vehicle(gateway, "V", @now + @s)

    assert %{status: :stale} = Table.vehicle(gateway, "V", @now + 6 * @s)
    assert %{status: :lost, last_heard: @now} = Table.vehicle(gateway, "V", @now + 11 * @s)
    Table.put_gateway(gateway, "V", "g", %{@facts | status: :lost}, @now)
    assert %{status: :lost} = Table.vehicle(gateway, "V", @now)
    assert Table.vehicle(gateway, "W", @now) == nil
  end

  test "of two gateways the one that hears it counts, and an older value does not replace a newer one",
       %{gateway: gateway} do
    Table.put_gateway(gateway, "V", "a", %{@facts | status: :lost}, @now)
    Table.put_gateway(gateway, "V", "b", @facts, @now - @s)
    Table.put(gateway, "V", :mode, group(@now, "b"))
    Table.put(gateway, "V", :mode, group(@now - 1, "a"))

    assert %{via: "b", gateways: ["a", "b"], groups: %{mode: %{via: "b"}}} =
             Table.vehicle(gateway, "V", @now)

    assert %{"V" => %{via: "b"}} = Table.vehicles(gateway, @now)
    Table.forget(gateway, "V")
    assert Table.vehicles(gateway, @now) == %{}
  end

  test "heard both ways: the own link until it has lost the vehicle; newer values of the other way are shown" do
    local = %Aerie.Vehicle.Snapshot{
      id: "V",
      status: :online,
      groups: %{mode: Map.delete(group(@now), :via), gps: group(@now - 60 * @s, nil)}
    }

    remote = %Aerie.Vehicle.Snapshot{
      id: "V",
      status: :online,
      via: "g",
      gateways: ["g"],
      groups: %{mode: group(@now + 1), gps: group(@now)}
    }

    assert %{via: nil, gateways: ["g"], groups: %{mode: mode, gps: %{via: "g"}}} = Fleet.merge(local, remote)
    refute mode[:via]
    assert %{via: "g"} = Fleet.merge(%{local | status: :lost}, remote)
    assert %{via: nil} = Fleet.merge(%{local | status: :lost}, %{remote | status: :lost})
    assert Fleet.merge(local, nil) == local
    assert Fleet.merge(nil, remote) == remote
  end
end
