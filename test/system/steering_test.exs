defmodule Aerie.System.SteeringTest do
  @moduledoc """
  Set-points, homes, targets and sticks between a ground station, the gateway's own commands and simulated vehicles that obey them as their
  firmwares do: what the policy limits, no vehicle leaves.
  """

  use Aerie.SystemCase, async: true

  alias Aerie.Control.Commands
  alias MavCodec.Enums.MavCmd
  alias MavCodec.Messages, as: M

  @moduletag :tmp_dir
  @moduletag capture_log: true

  @crew %{name: "crew", role: :operator, permissions: []}
  @chief %{name: "chief", role: :admin, permissions: []}
  # The simulator's place, and about 100 m to each side.
  @lat -35.363261
  @lon 149.165230
  @place 0xDF8
  @acceleration 0xC3F

  defp start(folder, firmware, policy, sim_params \\ %{}) do
    fence = Path.join(folder, "fence.geojson")
    {south, north, west, east} = {@lat - 0.0009, @lat + 0.0009, @lon - 0.0011, @lon + 0.0011}
    ring = [[west, south], [east, south], [east, north], [west, north]]
    File.write!(fence, JSON.encode!(%{"type" => "Polygon", "coordinates" => [ring]}))

    overrides = %{
      "clients" => [%{"id" => "laptop", "url" => "udpin:127.0.0.1:0"}],
      "policy" =>
        Map.merge(policy, %{
          "geofence_file" => fence,
          "clients" => [%{"id" => "laptop", "role" => "operator"}]
        }),
      "timeouts" => patient()
    }

    %{gateway: gateway} = start_gateway(folder, links: ["udpin:127.0.0.1:0"], overrides: overrides)
    link = "udpout:127.0.0.1:#{link_port(gateway, "link-1")}"
    options = fast_vehicle(if(firmware == :px4, do: :px4, else: :ardupilot), sim_params)
    options = Keyword.merge(options, link: link, firmware: firmware, home: {@lat, @lon, 584.0})
    sim = start_supervised!({SimVehicle, options})
    SimVehicle.await(sim, & &1.ready)
    await_standing(gateway)

    {:ok, socket} = :gen_udp.open(0, [:binary, active: false, ip: {127, 0, 0, 1}])

    port =
      eventually(fn -> MavRouter.Link.snapshot(gateway, "laptop").port end, "the client's endpoint is open")

    :ok = :gen_udp.connect(socket, {127, 0, 0, 1}, port)
    %{gateway: gateway, sim: sim, socket: socket}
  end

  defp say(c, message),
    do: :ok = :gen_udp.send(c.socket, MavCodec.encode(message, system: 255, component: 190))

  defp submit(c, type, params, source \\ @crew) do
    deadline = System.os_time(:second) + 120
    request = [vehicle: "VID-001", type: type, params: params, as: source, deadline: deadline]
    {:ok, result} = Commands.submit(c.gateway, request)
    result
  end

  defp fly(c, height) do
    mode = if data(c.gateway, :mode)[:mode] =~ "AUTO", do: "AUTO_LOITER", else: "GUIDED"
    assert %{status: :completed} = submit(c, "set_mode", %{mode: mode})
    assert %{status: :completed} = submit(c, "arm", %{})
    assert %{status: :completed} = submit(c, "takeoff", %{altitude: height})
    assert SimVehicle.await(c.sim, &(&1.alt_rel > height - 1.5))
    eventually(fn -> (data(c.gateway, :position)[:alt_rel] || 0) > height - 2 end, "the gateway has heard it")
  end

  # Until so many of them were refused, so that it is known that they came.
  defp refused(c, message, rule) do
    before = Aerie.Base.Store.counter(c.gateway, {:policy, :deny, rule})

    eventually(
      fn ->
        say(c, message)
        Aerie.Base.Store.counter(c.gateway, {:policy, :deny, rule}) >= before + 5
      end,
      "it is refused by #{rule}"
    )
  end

  test "a copter leaves neither fence nor limit by masks, by homes, or by sticks", %{tmp_dir: folder} do
    c = start(folder, :ardupilot, %{"max_altitude" => 60, "modes" => %{"denied" => ["RTL"]}})
    fly(c, 20)

    # ArduPilot takes no notice of the place, of which one axis is masked, and obeys the velocity.
    leads = %M.SetPositionTargetLocalNed{target_system: 1, target_component: 1, coordinate_frame: 1, z: -20.0}
    refused(c, %{leads | type_mask: 0xDC1, vx: 20.0}, :geofence)
    refused(c, %{leads | type_mask: 0xDC4, vz: -9.0}, :altitude)
    refused(c, %{leads | type_mask: @acceleration, afx: 1.0}, :altitude)
    refused(c, %M.SetAttitudeTarget{target_system: 1, q: [1.0, 0.0, 0.0, 0.0], thrust: 0.9}, :altitude)
    assert %{status: :denied} = submit(c, "setpoint_velocity", %{vx: 10, vy: 0, vz: 0, hold: 10})
    assert abs(SimVehicle.state(c.sim).north) < 5

    # Home follows it up, for who may, and the limit stays.
    refused(c, %M.CommandLong{target_system: 1, target_component: 1, command: 179, param1: 1.0}, :role)

    assert %{status: :denied, reason: "set_home needs the permission protection" <> _} =
             submit(c, "set_home", %{here: true})

    up = &%{lat: @lat, lon: @lon, altitude: &1}
    assert %{status: :completed} = submit(c, "goto", up.(50))
    assert SimVehicle.await(c.sim, &(&1.alt_rel > 49))
    # A busy machine may hear the new home after the command's time.
    assert %{status: status} = submit(c, "set_home", %{here: true}, @chief)
    assert status in [:completed, :unknown]
    eventually(fn -> (data(c.gateway, :home)[:alt_msl] || 0) > 625 end, "its home is above it")
    assert %{status: :denied, reason: reason} = submit(c, "goto", up.(50), @chief)
    assert reason =~ "above where it took off; at most 60 m is allowed"

    # It obeys system 255 only, and this gateway is not it.
    eventually(
      fn -> match?(%{gcs: %{failsafe_range: {255, 255}}}, Store.vehicle(c.gateway, {"main", 1})) end,
      "whom it obeys is known"
    )

    assert %{status: :rejected, reason: "it obeys the ground station with the system id 255" <> _} =
             submit(c, "rc_override", %{channels: [1500, 1500]})

    # The laptop is; the third position of its switch is RTL (FLTMODE3).
    ignore = Map.new(1..8, &{:"chan#{&1}_raw", 65_535})

    switch =
      &struct!(%M.RcChannelsOverride{target_system: 1, target_component: 1}, Map.put(ignore, :chan5_raw, &1))

    refused(c, switch.(1400), :mode)
    assert SimVehicle.state(c.sim).mode == "GUIDED"
    known = fn -> is_map_key(Store.vehicle(c.gateway, {"main", 1}).params, "FLTMODE6") end
    eventually(known, "what its switch does is known")
    refused(c, switch.(1400), :mode)
    assert SimVehicle.state(c.sim).mode == "GUIDED"

    # The function of this channel (RC5_OPTION) is not among the simulator's parameters, so nothing on it passes.
    refused(c, switch.(1800), :mode)

    assert %{status: :completed} = submit(c, "set_mode", %{mode: "LOITER"})

    assert %{status: :rejected, reason: "it is in LOITER, and obeys set-points in GUIDED only" <> _} =
             submit(c, "setpoint_velocity", %{vx: 1, vy: 0, vz: 0})
  end

  test "PX4 does not climb by an acceleration", %{tmp_dir: folder} do
    c = start(folder, :px4, %{"max_altitude" => 60})
    fly(c, 20)
    leads = %M.SetPositionTargetLocalNed{target_system: 1, target_component: 1, coordinate_frame: 1, z: -20.0}
    refused(c, %{leads | type_mask: @acceleration, afz: -2.0}, :altitude)
    refused(c, %{leads | type_mask: 0xDE3, z: -80.0, vx: 1.0}, :altitude)

    assert %{status: :accepted, reason: reason} = submit(c, "setpoint_velocity", %{vx: 1, vy: 0, vz: 0})
    assert reason =~ "and obeys set-points in OFFBOARD only"

    assert abs(SimVehicle.state(c.sim).alt_rel - 20) < 3
  end

  test "a disarmed rover is given no target, and so does not drive off when it is armed", %{tmp_dir: folder} do
    c = start(folder, :ardurover, %{})
    target = %{lat: @lat + 0.0003, lon: @lon, altitude: 0}
    assert %{status: :rejected, reason: "arm it first" <> _} = submit(c, "goto", target)

    assert %{status: :rejected, reason: "it has no height to change"} =
             submit(c, "set_altitude", %{altitude: 10})

    reposition = %M.CommandInt{
      target_system: 1,
      target_component: 1,
      command: MavCmd.value(:MAV_CMD_DO_REPOSITION),
      frame: 6,
      param2: 1.0,
      x: round(target.lat * 1.0e7),
      y: round(target.lon * 1.0e7)
    }

    refused(c, reposition, :disarmed)

    refused(
      c,
      %M.SetPositionTargetGlobalInt{
        target_system: 1,
        target_component: 1,
        coordinate_frame: 6,
        type_mask: @place,
        lat_int: reposition.x,
        lon_int: reposition.y
      },
      :disarmed
    )

    assert %{status: :completed} = submit(c, "set_mode", %{mode: "GUIDED"})
    assert %{status: :completed} = submit(c, "arm", %{})
    now = SimVehicle.state(c.sim).seconds
    assert SimVehicle.await(c.sim, &(&1.seconds > now + 5))
    assert abs(SimVehicle.state(c.sim).north) < 1
    eventually(fn -> data(c.gateway, :mode)[:armed] end, "the gateway has heard that it is armed")
    assert %{status: :completed} = submit(c, "goto", target)
    assert SimVehicle.await(c.sim, &(&1.north > 20))
  end
end
