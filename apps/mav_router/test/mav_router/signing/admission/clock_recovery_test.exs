defmodule MavRouter.Signing.Admission.ClockRecoveryTest do
  @moduledoc """
  An ArduPilot that signs, whose clock is behind what was heard of it: after a kill of the gateway, after its own. It is heard
  again as soon as it has heard us, and what was recorded of it is not (S3, S5).
  """
  use ExUnit.Case, async: true
  use Aerie.SigningCase

  alias Aerie.Base.Store
  alias MavRouter.Signing

  @moduletag :tmp_dir
  @moduletag :capture_log

  @second 100_000

  setup c do
    start_gateway(c, %{})
  end

  defp start_gateway(c, mavlink) do
    config = %{
      mavlink: Map.merge(%{system_id: 237, component_id: 191, timesync_s: 0}, mavlink),
      signing: %{
        keys: [%{network: "main", key_file: key_file(c.tmp_dir)}],
        dir: Path.join(c.tmp_dir, "signing")
      }
    }

    gateway = start_parts(config, before: [{Signing.Supervisor, []}])
    {_id, port} = add_link(gateway, "udpin:127.0.0.1:0", id: "radio")
    # There are no heartbeats before all loops have answered.
    eventually(fn -> MavRouter.Identity.status(gateway).alive end)
    %{gateway: gateway, port: port}
  end

  defp now, do: MavCodec.Signing.timestamp(MavCodec.Signing.new(<<0::256>>))

  # A vehicle as ArduPilot is: its clock stands still but for what it hears.
  defp vehicle(at) do
    {:ok, socket} = :gen_udp.open(0, [:binary, active: true, ip: {127, 0, 0, 1}])
    %{socket: socket, signer: signer(passphrase(), clock: fn -> 0 end, stored: at), sent: []}
  end

  defp says(vehicle, port) do
    {bytes, signer} = signed(vehicle.signer, 1)
    :ok = :gen_udp.send(vehicle.socket, {127, 0, 0, 1}, port, bytes)
    %{vehicle | signer: signer, sent: [bytes | vehicle.sent]}
  end

  # What comes is signed with the key; the clock goes on by it (S5).
  defp hears(%{socket: socket} = vehicle) do
    assert_receive {:udp, ^socket, _ip, _port, bytes}
    {frames, _} = MavCodec.Parser.push_datagram(MavCodec.Parser.new(), bytes)

    {ids, signer} =
      Enum.map_reduce(frames, vehicle.signer, fn frame, signer ->
        assert {:signed, signer} = MavCodec.Signing.check(signer, frame)
        {{frame.id, frame.system, frame.component}, signer}
      end)

    {ids, %{vehicle | signer: signer}}
  end

  defp verified(gateway), do: Store.counter(gateway, {:signing, "radio", :verified})
  defp rejected(gateway), do: Store.counter(gateway, {:signing, "radio", :rejected})

  test "refused for its clock it hears us, signed, and is taken in with its next frame", c do
    # It was heard before, by another port, with a clock that was ahead of what it has now.
    before = c |> vehicle_heard(now())
    vehicle = says(vehicle(now() - 30 * @second), c.port)
    eventually(fn -> rejected(c.gateway) == 1 end)
    {ids, vehicle} = hears(vehicle)
    # HEARTBEAT and TIMESYNC, as who we are.
    assert ids == [{0, 237, 191}, {111, 237, 191}]
    heard = verified(c.gateway)
    vehicle = says(vehicle, c.port)
    eventually(fn -> verified(c.gateway) == heard + 1 end)

    # What was recorded of it is as old as before.
    for bytes <- before.sent ++ vehicle.sent, do: :gen_udp.send(vehicle.socket, {127, 0, 0, 1}, c.port, bytes)
    eventually(fn -> rejected(c.gateway) == 1 + length(before.sent ++ vehicle.sent) end)
    assert verified(c.gateway) == heard + 1
  end

  defp vehicle_heard(c, at) do
    vehicle = says(vehicle(at), c.port)
    eventually(fn -> verified(c.gateway) == 1 end)
    vehicle
  end

  test "the first of a stream that is older than a minute too (S4)", c do
    vehicle = says(vehicle(now() - 600 * @second), c.port)
    {_ids, vehicle} = hears(vehicle)
    says(vehicle, c.port)
    eventually(fn -> verified(c.gateway) == 1 end)
  end

  test "however many are refused, twice a second is enough; a wrong key gets nothing", c do
    vehicle = vehicle(now() - 600 * @second)
    {wrong, _} = signed(signer("another"), 1)
    :ok = :gen_udp.send(vehicle.socket, {127, 0, 0, 1}, c.port, wrong)
    eventually(fn -> rejected(c.gateway) == 1 end)
    began = System.monotonic_time(:millisecond)
    vehicle = Enum.reduce(1..50, vehicle, fn _n, vehicle -> says(vehicle, c.port) end)
    eventually(fn -> rejected(c.gateway) == 51 end)
    {[_beat, _request], vehicle} = hears(vehicle)
    signed = fn -> Store.counter(c.gateway, {:signing, "radio", :signed}) end
    eventually(fn -> signed.() >= 2 end)
    # Two frames at once, and two more for each half second that this took.
    assert signed.() <= 2 + 2 * div(System.monotonic_time(:millisecond) - began, 500)
    assert vehicle.socket
  end

  test "a gateway that is to find out its own id is woken as well, as a part of that vehicle", c do
    %{gateway: gateway, port: port} = start_gateway(c, %{system_id: :auto})
    vehicle = says(vehicle(now() - 600 * @second), port)
    {ids, vehicle} = hears(vehicle)
    assert ids == [{0, 1, 191}, {111, 1, 191}]
    says(vehicle, port)
    eventually(fn -> verified(gateway) == 1 end)
  end

  test "without a heartbeat of ours TIMESYNC does it", c do
    %{port: port} = start_gateway(c, %{heartbeat: false})
    {ids, _vehicle} = hears(says(vehicle(now() - 600 * @second), port))
    assert ids == [{111, 237, 191}]
  end
end
