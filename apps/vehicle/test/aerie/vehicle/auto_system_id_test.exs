defmodule Aerie.Vehicle.AutoSystemIdTest do
  @moduledoc "R11: a gateway aboard that was given no system id takes the autopilot's."
  use Aerie.VehicleCase, async: true

  alias MavRouter.Identity
  alias Aerie.Base.Store
  alias Aerie.Vehicle.{Options, Settings}
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
    :ok
  end

  test "the vehicle's name and our ids follow" do
    settings = Settings.from(put_in(@config.mavlink.system_id, 7))
    assert %{id: "VID-007", own_system: 7, own_component: 191} = Options.new(settings, {"main", 7})
    assert %{id: "VID-008", own_system: 7} = Options.new(settings, {"main", 8})
    assert Identity.resolve(settings.identity, make_ref()) == settings.identity
  end

  test "aboard: nothing of ours is said before, and afterwards it is said as a part of the vehicle" do
    gateway = Aerie.GatewayCase.start_gateway(@config, with: [:router, :links])
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
    assert %{identity: %{system_id: 7}} = Settings.of(gateway)
  end
end
