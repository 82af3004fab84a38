defmodule SimVehicle.SigningTest do
  use ExUnit.Case, async: true

  alias MavCodec.{Frame, Parser}
  alias MavCodec.Messages.{Heartbeat, SetupSigning}
  alias SimVehicle.Link.Signing

  @key :crypto.hash(:sha256, "simulated")
  @me %{system: 1, component: 1}

  defp frame(bytes) do
    {[frame], _parser} = Parser.push_datagram(Parser.new(), bytes)
    frame
  end

  defp heartbeat(signing) do
    bytes = MavCodec.encode(%Heartbeat{type: 2}, system: 1)
    {bytes, signing} = Signing.sign(signing, bytes, %Heartbeat{}, MavCodec.Dialects.Ardupilot)
    {frame(bytes), signing}
  end

  defp now, do: MavCodec.Signing.timestamp(MavCodec.Signing.new(@key))

  defp order(key, at \\ 1),
    do: %SetupSigning{target_system: 1, target_component: 1, secret_key: key, initial_timestamp: at}

  test "unsigned until it is given a key, signed from then on, unsigned again when it is taken away" do
    {plain, signing} = heartbeat(Signing.new(nil, false))
    refute Frame.signed?(plain)
    assert {:ok, ^signing} = Signing.check(signing, plain)

    {signed, signing} = signing |> Signing.setup(order(@key, now()), @me) |> heartbeat()
    assert {:signed, _} = MavCodec.Signing.check(MavCodec.Signing.new(@key), signed)
    assert {:refused, signing} = Signing.check(signing, plain)

    signing = Signing.setup(signing, order(<<0::256>>, 0), @me)
    assert {:ok, _} = Signing.check(signing, plain)
  end

  test "an armed ArduPilot takes no key; PX4 takes unsigned heartbeats though it has one" do
    armed = Map.put(@me, :armed, true)
    assert %{state: nil} = Signing.setup(Signing.new(nil, false), order(@key), armed)
    assert %{state: %{}} = px4 = Signing.setup(Signing.new(nil, false, :px4), order(@key), armed)
    {plain, _} = heartbeat(Signing.new(nil, false))
    assert {:ok, _} = Signing.check(px4, plain)
  end

  test "what is signed with its key is heard, once; another vehicle's key is not its own" do
    {other, _} = heartbeat(Signing.new(@key, false))
    signing = Signing.new(@key, false)
    assert {:ok, signing} = Signing.check(signing, other)
    assert {:refused, signing} = Signing.check(signing, other)
    assert Signing.setup(signing, %{order(<<1::256>>) | target_system: 2}, @me) == signing
  end

  test "ArduPilot's clock stands still but for what it sends and hears; a reboot begins a minute after what was stored" do
    stamp = fn signing ->
      with {frame, signing} <- heartbeat(signing), do: {frame.signature.timestamp, signing}
    end

    {first, signing} = stamp.(Signing.new(@key, false, :ardupilot, 1_000_000))
    assert first == 1_000_001
    assert {1_000_002, signing} = stamp.(signing)

    {later, _} = heartbeat(Signing.new(@key, false, :ardupilot, 5_000_000))
    {:ok, signing} = Signing.check(signing, later)
    assert {5_000_002, signing} = stamp.(signing)
    {rebooted, _} = signing |> Signing.rebooted() |> stamp.()
    assert rebooted == 7_000_001
    {rebooted, _} = signing |> Signing.tick(30_000_000) |> Signing.rebooted() |> stamp.()
    assert rebooted == 11_000_003
  end

  test "on a link that counts as USB everything is heard, and RADIO_STATUS on any (S7)" do
    {plain, _} = heartbeat(Signing.new(nil, false))
    assert {:ok, _} = Signing.check(Signing.new(@key, true), plain)
    radio = frame(MavCodec.encode(%MavCodec.Messages.RadioStatus{rssi: 9}, system: 51))
    assert {:ok, _} = Signing.check(Signing.new(@key, false), radio)
  end
end
