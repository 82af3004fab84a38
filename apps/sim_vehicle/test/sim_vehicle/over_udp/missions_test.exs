defmodule SimVehicle.OverUdp.MissionsTest do
  @moduledoc "Missions, fences and rally points over UDP: what a ground station sees of the mission protocol on a good and on a bad link."
  use ExUnit.Case, async: true

  import SimVehicle.GroundStation

  alias MavCodec.Messages, as: M
  alias SimVehicle.Peer

  @mission [item(22), item(16, 10), item(16, 20, %{param1: 2.0}), item(16, 30), item(19, 10, %{param1: 3.0})] ++
             [item(178, 0, %{frame: 2, x: 0, y: 0, z: 0.0, param1: 1.0, param2: 4.0}), item(21)]
  @fence [
    item(5001, 40, %{param1: 3.0}),
    item(5001, -40, %{param1: 3.0}),
    item(5001, -40, %{param1: 3.0, y: 1_491_660_000})
  ]

  # ArduPilot has home as item 0.
  defp mission(:ardupilot), do: [item(16) | @mission]
  defp mission(:px4), do: @mission

  defp asks(:ardupilot), do: M.MissionRequest
  defp asks(:px4), do: M.MissionRequestInt

  defp places(items), do: Enum.map(items, &{&1.command, &1.x, &1.y})

  defp bad_link(sim, faults) do
    for {name, share} <- faults,
        direction <- [:out, :in],
        do: :ok = SimVehicle.fault(sim, name, share, direction)
  end

  for firmware <- [:ardupilot, :px4] do
    test "#{firmware}: a mission goes up and comes down whole, though a quarter of all frames is lost each way" do
      {sim, peer} = start(unquote(firmware))
      bad_link(sim, loss: 0.25)
      {0, peer} = upload(peer, mission(unquote(firmware)))
      {items, _peer} = download(peer)
      # Item 0 of ArduPilot is where home is.
      assert places(Enum.take(items, -length(@mission))) == places(@mission)
      assert Enum.map(items, & &1.seq) == Enum.to_list(0..(length(items) - 1))
      assert SimVehicle.state(sim).mission.items == length(mission(unquote(firmware)))
      assert SimVehicle.stats(sim).faults.in.lost > 0
    end

    test "#{firmware}: frames that come twice, late and damaged spoil no upload" do
      {sim, peer} = start(unquote(firmware))
      bad_link(sim, duplicate: 0.5, corrupt: 0.1, reorder: 0.1)
      {0, peer} = upload(peer, mission(unquote(firmware)))
      {items, _peer} = download(peer)
      assert length(items) == length(mission(unquote(firmware)))
    end

    test "#{firmware}: a mission with a command that it does not know is refused, and the old one stays" do
      {_sim, peer} = start(unquote(firmware))
      {0, peer} = upload(peer, mission(unquote(firmware)))
      {3, peer} = upload(peer, [item(16), item(16, 10), item(31_999)])
      {items, _peer} = download(peer)
      assert length(items) == length(mission(unquote(firmware)))
    end

    test "#{firmware}: fence and rally points are plans of their own, and one clear empties all" do
      {_sim, peer} = start(unquote(firmware))
      {0, peer} = upload(peer, mission(unquote(firmware)))
      {0, peer} = upload(peer, @fence, 1)
      {0, peer} = upload(peer, [item(5100, 15)], 2)
      {fence, peer} = download(peer, 1)
      assert places(fence) == places(@fence)
      assert [3.0, 3.0, 3.0] == Enum.map(fence, & &1.param1)
      {[%{command: 5100}], peer} = download(peer, 2)
      {3, peer} = upload(peer, [item(5100)], 1)
      {%{type: 0}, peer} = ask(peer, %M.MissionClearAll{mission_type: 255}, M.MissionAck)

      Enum.reduce(0..2, peer, fn type, peer ->
        {[], peer} = download(peer, type)
        peer
      end)
    end

    test "#{firmware}: while one station uploads, another one is DENIED" do
      {_sim, peer} = start(unquote(firmware))
      asks = asks(unquote(firmware))
      {%{seq: 0}, peer} = ask(peer, %M.MissionCount{count: 3}, asks)
      count = %M.MissionCount{target_system: 1, target_component: 1, count: 2}
      other = MavCodec.encode(count, system: 250, component: 190)
      {ack, _peer} = peer |> Peer.transmit(other) |> Peer.await(M.MissionAck)
      assert {ack.type, ack.target_system} == {14, 250}
    end
  end

  test "ArduPilot names what is out of sequence, PX4 asks for what it wants" do
    second = %M.MissionItemInt{seq: 2, command: 16, frame: 3, x: 1, y: 1}
    {_sim, peer} = start(:ardupilot)
    {%{seq: 0}, peer} = ask(peer, %M.MissionCount{count: 4}, M.MissionRequest)
    {%{type: 13}, _peer} = ask(peer, second, M.MissionAck)

    {_sim, peer} = start(:px4)
    {%{seq: 0}, peer} = ask(peer, %M.MissionCount{count: 4}, M.MissionRequestInt)
    {%{seq: 0}, peer} = peer |> Peer.forget(M.MissionRequestInt) |> ask(second, M.MissionRequestInt)
    assert {[], _peer} = Peer.take(peer, M.MissionAck)
  end

  test "too many items: NO_SPACE, and nothing is asked for" do
    for {firmware, count} <- [ardupilot: 725, px4: 2001] do
      {_sim, peer} = start(firmware)
      {%{type: 4}, peer} = ask(peer, %M.MissionCount{count: count}, M.MissionAck)
      assert {[], peer} = Peer.take(peer, M.MissionRequest)
      assert {[], _peer} = Peer.take(peer, M.MissionRequestInt)
    end
  end

  for {firmware, first, before, auto} <- [
        {:ardupilot, 1, [1.0, 4.0], [1.0, 3.0]},
        {:px4, 0, [1.0, 4.0, 4.0], [1.0, 4.0, 4.0]}
      ] do
    test "#{firmware}: a mission is flown from the ground to the ground, its items reached in order" do
      {firmware, auto} = {unquote(firmware), unquote(auto)}
      {sim, peer} = start(firmware, speed: 20)
      SimVehicle.subscribe(sim)
      mission = mission(firmware)
      {0, peer} = upload(peer, mission)
      {0, peer} = command(peer, 176, unquote(before))
      {0, peer} = command(peer, 400, [1.0])
      {0, peer} = command(peer, 176, auto)
      {0, peer} = command(peer, 300)

      # The loiter of ArduPilot, which does not report that a speed was changed; PX4 does. Neither reports that it has landed.
      last = 5
      until = System.monotonic_time(:millisecond) + 60_000
      {reached, peer} = Peer.collect(peer, M.MissionItemReached, &(&1.seq == last), until)
      seqs = reached |> Enum.map(& &1.seq) |> Enum.dedup()
      assert List.last(seqs) == last
      assert seqs == Enum.sort(seqs)
      Peer.close(peer)
      assert SimVehicle.await(sim, &(not &1.armed && &1.landed == :on_ground))
      for seq <- unquote(first)..last, do: assert_receive({:sim, ^sim, {:reached, ^seq}})
    end
  end

  test "DO_SET_MISSION_CURRENT: ArduPilot goes there, and has no item beyond the end; PX4 does not support it" do
    {sim, peer} = start(:ardupilot)
    {4, peer} = command(peer, 224, [3.0])
    {0, peer} = upload(peer, mission(:ardupilot))
    {0, peer} = command(peer, 224, [3.0])
    assert SimVehicle.state(sim).mission.current == 3
    {4, _peer} = command(peer, 224, [99.0])
    assert SimVehicle.state(sim).mission.current == 3

    {_sim, peer} = start(:px4)
    {0, peer} = upload(peer, mission(:px4))
    {3, peer} = command(peer, 224, [3.0])
    {%{seq: 3}, _peer} = ask(peer, %M.MissionSetCurrent{seq: 3}, M.MissionCurrent, &(&1.seq == 3))
  end
end
