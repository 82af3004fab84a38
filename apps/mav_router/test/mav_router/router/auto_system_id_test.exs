defmodule MavRouter.Router.AutoSystemIdTest do
  @moduledoc "R11: a gateway aboard that was given no system id takes the autopilot's."
  use ExUnit.Case, async: true
  use Aerie.LinkCase

  alias Aerie.FakeVehicles
  alias Aerie.Base.Names
  alias MavRouter.Identity
  alias MavRouter.Router.Starter
  alias MavRouter.Forward.Delivery
  alias MavRouter.Tables
  alias MavRouter.Router.AutoSystemId

  @config %{network: "main", mavlink: %{system_id: :auto, component_id: 191}}

  setup do
    gateway = make_ref()
    test = self()

    :telemetry.attach(
      gateway,
      [:aerie, :identity, :latched],
      fn _, _, m, _ -> send(test, {:latched, m.gateway, m.system, m.heard}) end,
      nil
    )

    on_exit(fn -> :telemetry.detach(gateway) end)
    {:ok, gateway: start_parts(@config, FakeVehicles.parts(100))}
  end

  # Whether the gateway lets the vehicle in, so many ms after the beginning.
  defp heard(c, system, ms, network \\ "main") do
    delivery = %Delivery{
      gateway: c.gateway,
      tables: Tables.of(c.gateway),
      forwarding: nil,
      path: nil,
      now: ms,
      sender: "a"
    }

    match?({:ok, _pid}, Starter.session({network, system}, [], delivery))
  end

  defp own(c), do: Tables.setting(Tables.of(c.gateway), :own, nil)

  test "R11: one autopilot within three seconds of its first heartbeat is whose part it is", c do
    assert own(c) == nil
    for ms <- [10_000, 11_000, 12_000, 12_999], do: refute(heard(c, 7, ms))
    assert heard(c, 7, 13_000)
    gateway = c.gateway
    assert_received {:latched, ^gateway, 7, [{"main", 7}]}
    assert own(c) == {7, 191}
    # One that comes later is another vehicle.
    assert heard(c, 8, 13_001)
    assert own(c) == {7, 191}
    refute_received {:latched, ^gateway, _, _}
  end

  @tag :capture_log
  test "R11: two within three seconds, and it is none of theirs", c do
    refute heard(c, 7, 0)
    refute heard(c, 8, 2_900)
    assert heard(c, 7, 3_000)
    gateway = c.gateway
    assert_received {:latched, ^gateway, 237, [{"main", 7}, {"main", 8}]}
    assert own(c) == {237, 191}
    assert heard(c, 8, 3_001)
  end

  @tag :capture_log
  test "R11: two of one id on two networks are two", c do
    refute heard(c, 7, 0, "main")
    refute heard(c, 7, 100, "other")
    assert heard(c, 7, 3_000)
    assert own(c) == {237, 191}
  end

  test "R11: one that is heard for the first time when the three seconds are over does not count", c do
    refute heard(c, 7, 0)
    assert heard(c, 8, 3_500)
    assert own(c) == {7, 191}
  end

  test "invented ids are bounded", c do
    for system <- 1..100, do: heard(c, system, 0)
    tables = Tables.of(c.gateway)
    assert :ets.select_count(tables.settings, [{{{:autopilot, :_}, :_}, [], [true]}]) == 16
  end

  test "what was decided holds when the router is started again", c do
    refute heard(c, 7, 0)
    assert heard(c, 7, 3_000)
    assert AutoSystemId.settings(Identity.Settings.from(@config), c.gateway) == [own: {7, 191}]
    assert %{system_id: 7} = Identity.resolve(Identity.Settings.from(@config), c.gateway)
    pid = Names.whereis(c.gateway, :router)
    ref = Process.monitor(pid)
    Supervisor.stop(pid)
    assert_receive {:DOWN, ^ref, :process, ^pid, _reason}
    eventually(fn -> Names.whereis(c.gateway, :router) not in [nil, pid] and Tables.of(c.gateway) end)
    assert own(c) == {7, 191}
  end
end
