defmodule Aerie.Fleet.RemoteTest do
  @moduledoc "Vehicles of other gateways in the model of all vehicles."
  use ExUnit.Case, async: true

  alias Aerie.{Fleet, Store}
  alias Aerie.Fleet.Remote

  @now 1_800_000_000_000_000
  @s 1_000_000
  @facts %{
    network: "main",
    system_id: 1,
    autopilot: :px4,
    type: "copter",
    firmware: nil,
    status: :online,
    last_heard: @now
  }

  setup do
    gateway = make_ref()
    start_supervised!({Store, [gateway: gateway] ++ Aerie.GatewayCase.plugs(%{})})
    :ok = Remote.configure(gateway, %{stale_us: 5 * @s, lost_us: 10 * @s})
    %{gateway: gateway}
  end

  defp group(at, via \\ "g", data \\ %{mode: "AUTO"}), do: %{data: data, at: at, time_boot_ms: nil, via: via}

  test "a vehicle is as its gateway says, and stale and lost when that falls silent", %{gateway: gateway} do
    Remote.heard(gateway, "V", "g", @facts, @now)
    Remote.put(gateway, "V", :mode, group(@now))

    assert %{status: :online, via: "g", groups: %{mode: %{via: "g"}}} =
             Remote.vehicle(gateway, "V", @now + @s)

    assert %{status: :stale} = Remote.vehicle(gateway, "V", @now + 6 * @s)
    assert %{status: :lost, last_heard: @now} = Remote.vehicle(gateway, "V", @now + 11 * @s)
    Remote.heard(gateway, "V", "g", %{@facts | status: :lost}, @now)
    assert %{status: :lost} = Remote.vehicle(gateway, "V", @now)
    assert Remote.vehicle(gateway, "W", @now) == nil
  end

  test "of two gateways the one that hears it counts, and an older value does not replace a newer one",
       %{gateway: gateway} do
    Remote.heard(gateway, "V", "a", %{@facts | status: :lost}, @now)
    Remote.heard(gateway, "V", "b", @facts, @now - @s)
    Remote.put(gateway, "V", :mode, group(@now, "b"))
    Remote.put(gateway, "V", :mode, group(@now - 1, "a"))

    assert %{via: "b", gateways: ["a", "b"], groups: %{mode: %{via: "b"}}} =
             Remote.vehicle(gateway, "V", @now)

    assert %{"V" => %{via: "b"}} = Remote.vehicles(gateway, @now)
    Remote.forget(gateway, "V")
    assert Remote.vehicles(gateway, @now) == %{}
  end

  test "heard both ways: the own link until it has lost the vehicle; newer values of the other way are shown" do
    local = %{
      id: "V",
      status: :online,
      groups: %{mode: Map.delete(group(@now), :via), gps: group(@now - 60 * @s, nil)}
    }

    remote = %{
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
