defmodule Aerie.Router.AutoSystemIdTest do
  @moduledoc "R11: a gateway aboard that was given no system id takes the autopilot's."
  use Aerie.VehicleCase, async: true

  alias Aerie.Store
  alias Aerie.Names
  alias Aerie.Router.{Admission, Tables}
  alias Aerie.Router.AutoSystemId
  alias Aerie.Vehicle.Options
  alias MavCodec.Parser

  @config %{vehicle_id: "VID-007", network: "main", mavlink: %{system_id: :auto, component_id: 191}}

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
    {:ok, gateway: start_parts(@config)}
  end

  # Whether the gateway lets the vehicle in, so many ms after the beginning.
  defp heard(c, system, ms, network \\ "main") do
    tables = Tables.of(c.gateway)
    match?({:ok, _pid}, Admission.session(c.gateway, tables, {network, system}, "a", fn -> [] end, ms))
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
    assert AutoSystemId.settings(@config, c.gateway) == [own: {7, 191}]
    assert %{mavlink: %{system_id: 7}} = Aerie.Identity.resolve(@config, c.gateway)
    pid = Names.whereis(c.gateway, :router)
    ref = Process.monitor(pid)
    Supervisor.stop(pid)
    assert_receive {:DOWN, ^ref, :process, ^pid, _reason}
    eventually(fn -> Names.whereis(c.gateway, :router) not in [nil, pid] and Tables.of(c.gateway) end)
    assert own(c) == {7, 191}
  end

  test "the vehicle's name and our ids follow" do
    config = put_in(@config.mavlink.system_id, 7)
    assert %{id: "VID-007", own_system: 7, own_component: 191} = Options.new(config, {"main", 7})
    assert %{id: "VID-008", own_system: 7} = Options.new(config, {"main", 8})
    assert Aerie.Identity.resolve(config, c_none()) == config
    assert Aerie.Identity.resolve(nil, c_none()) == nil
  end

  defp c_none, do: make_ref()

  test "aboard: nothing of ours is said before, and afterwards it is said as a part of the vehicle" do
    gateway = Aerie.GatewayCase.start_gateway(@config, without: [Aerie.Bridge.Supervisor])
    {_id, port} = add_link(gateway, "udpin:127.0.0.1:0")
    {:ok, socket} = :gen_udp.open(0, [:binary, ip: {127, 0, 0, 1}, active: true])

    # What the autopilot hears, ten times a second.
    hear = fn hear, before ->
      :ok = :gen_udp.send(socket, {127, 0, 0, 1}, port, heartbeat(7))

      receive do
        {:udp, ^socket, _, _, bytes} ->
          {[frame | _], _} = Parser.push_datagram(Parser.new(), bytes, nil)
          {frame, before}

        {:latched, ^gateway, 7, _} ->
          hear.(hear, [:latched | before])
      after
        100 -> hear.(hear, [:silence | before])
      end
    end

    assert {%{system: 7, component: 191}, [_ | _] = before} = hear.(hear, [])
    assert :latched in before
    assert %{id: "VID-007"} = eventually(fn -> Store.vehicle(gateway, {"main", 7}) end)
    assert %{mavlink: %{system_id: 7}} = Aerie.Gateway.config(gateway)
  end
end
