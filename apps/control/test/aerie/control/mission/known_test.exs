defmodule Aerie.Control.Mission.KnownTest do
  @moduledoc "A fence aboard that another one replaces, by the API and by a ground station without `protection` (W3)."
  use Aerie.TransferCase, async: true

  alias Aerie.Control.Missions
  alias Aerie.Control.Policy.Mavlink.Writing.Aboard
  alias Aerie.Control.Policy.Roles
  alias Protocols.Mission.{Item, Onboard, Plan}
  alias Aerie.Vehicle.Firmware
  alias MavCodec.Messages, as: M
  alias MavRouter.{Client, Link}

  @moduletag :tmp_dir
  @moduletag :capture_log
  @fence 1

  # Around where simulated vehicles stand.
  defp square(metres) do
    {lat, lon, half} = {-353_632_621, 1_491_652_374, round(metres / 0.0111)}
    corners = for {n, e} <- [{-1, -1}, {-1, 1}, {1, 1}, {1, -1}], do: {lat + n * half, lon + e * half}
    %Plan{fence: [{:inclusion, {:polygon, corners}}]}
  end

  defp dummy, do: %Plan{fence: [{:exclusion, {:circle, {100_000_000, 100_000_000}, 1.0}}]}

  defp upload(gateway, plan, role),
    do: Missions.upload(gateway, "VID-001", :fence, plan, as: Roles.principal(:key, "k-#{role}", role))

  defp aboard(gateway) do
    {:ok, %{plan: plan}} = Missions.download(gateway, "VID-001", :fence)
    plan.fence
  end

  defp station(gateway) do
    {:ok, "gcs"} = Client.add(gateway, %{url: "udpin:127.0.0.1:0", id: "gcs"})
    {:ok, socket} = :gen_udp.open(0, [:binary, active: false, ip: {127, 0, 0, 1}])
    :ok = :gen_udp.connect(socket, {127, 0, 0, 1}, Link.snapshot(gateway, "gcs").port)
    socket
  end

  # As ground stations do it: the items that are asked for, up to the acknowledgement.
  defp write(socket, plan) do
    items = Onboard.items(plan, @fence, Firmware.of(:ardupilot))

    say(socket, %M.MissionCount{
      target_system: 1,
      target_component: 1,
      count: length(items),
      mission_type: @fence
    })

    answer(socket, items)
  end

  defp answer(socket, items) do
    {:ok, {_ip, _port, bytes}} = :gen_udp.recv(socket, 0, Aerie.Patience.ms())

    case bytes |> MavCodec.Frame.from_bytes(nil) |> MavCodec.decode() do
      {:ok, %M.MissionAck{mission_type: @fence, type: type}} ->
        type

      {:ok, %module{seq: seq, mission_type: @fence}} when module in [M.MissionRequest, M.MissionRequestInt] ->
        say(socket, items |> Enum.at(seq) |> Item.message(seq, @fence, {1, 1}))
        answer(socket, items)

      _other ->
        answer(socket, items)
    end
  end

  defp say(socket, message),
    do: :ok = :gen_udp.send(socket, MavCodec.encode(message, system: 255, component: 190))

  defp read?(gateway, corners) do
    eventually(fn ->
      match?({:ok, items} when length(items) == corners, Aboard.items(gateway, {"main", 1}, @fence))
    end)
  end

  test "what was read before a write through the gateway is not taken", %{tmp_dir: dir} do
    {gateway, _port} = start(dir)
    now = System.monotonic_time(:microsecond)
    [old, new] = for metres <- [500, 400], do: Onboard.items(square(metres), @fence, Firmware.of(:ardupilot))
    read = &Aboard.read(gateway, {"main", 1}, @fence, &1, &2)

    assert read.(old, now - 1)
    assert Aboard.items(gateway, {"main", 1}, @fence) == {:ok, old}
    Aboard.sent(gateway, {"main", 1}, @fence, new)
    assert Aboard.items(gateway, {"main", 1}, @fence) == :unknown
    refute read.(old, now)
    assert Aboard.items(gateway, {"main", 1}, @fence) == :unknown
    Aboard.forget(gateway, {"main", 1}, @fence)
    refute read.(old, now)
    assert read.(new, System.monotonic_time(:microsecond))
    assert Aboard.items(gateway, {"main", 1}, @fence) == {:ok, new}
  end

  test "the read cache reads again what it had read before the write", %{tmp_dir: dir} do
    {gateway, port} = start(dir)
    start_supervised!({Aerie.Control.ReadCache.Supervisor, gateway: gateway})
    fly(gateway, port, firmware: :ardupilot)
    assert {:ok, %Result{status: :completed}} = upload(gateway, square(500), :admin)
    read?(gateway, 4)
    # The vehicle's own messages show none of it.
    Aboard.sent(gateway, {"main", 1}, @fence, [])
    read?(gateway, 4)
  end

  for firmware <- [:ardupilot, :px4] do
    test "#{firmware}: only by one that keeps as much", %{tmp_dir: dir} do
      {gateway, port} = start(dir, %{clients: [%{role: :operator}]})
      start_supervised!({Aerie.Control.ReadCache.Supervisor, gateway: gateway})
      fly(gateway, port, firmware: unquote(firmware))
      assert {:ok, %Result{status: :completed}} = upload(gateway, square(500), :admin)

      assert {:ok, %Result{status: :denied, reason: reason}} = upload(gateway, dummy(), :operator)
      assert reason =~ "needs the permission protection: the new fence does not keep the vehicle"
      assert {:ok, %Result{status: :denied}} = upload(gateway, square(600), :operator)
      assert {:ok, %Result{status: :completed}} = upload(gateway, square(400), :operator)

      socket = station(gateway)
      # The gateway reads the fence again after each change, and refuses another one until then.
      for metres <- [400, 300], do: eventually(fn -> write(socket, square(metres)) == 0 end)
      read?(gateway, 4)
      assert write(socket, dummy()) == 14
      assert write(socket, square(450)) == 14
      assert aboard(gateway) == square(300).fence
      assert {:ok, %Result{status: :completed}} = upload(gateway, dummy(), :admin)
    end
  end
end
