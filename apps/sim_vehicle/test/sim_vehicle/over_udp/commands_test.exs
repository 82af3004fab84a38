defmodule SimVehicle.OverUdp.CommandsTest do
  @moduledoc "Commands, message rates, failsafes and the battery over UDP: what a ground station sees."
  use ExUnit.Case, async: true

  import MavCodec.MessageId
  import SimVehicle.GroundStation

  alias MavCodec.Messages, as: M
  alias SimVehicle.Peer

  describe "on the ground, without a mission" do
    @refused %{
      ardupilot: [
        {"take-off while disarmed", 22, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 20.0], 4},
        {"a yaw beyond a turn", 115, [400.0], 4},
        {"a speed below zero", 178, [1.0, -1.0], 4},
        {"a kind of speed that is none", 178, [9.0, 5.0], 4},
        {"pause in STABILIZE", 193, [0.0], 4},
        {"neither pause nor continue", 193, [7.0], 2},
        {"reposition outside GUIDED", 192, [-1.0, 0.0, 0.0, 0.0, -35.36, 149.16, 20.0], 2},
        {"an item of no mission", 224, [1.0], 4},
        {"a parachute that is not fitted", 208, [2.0], 4},
        {"a fence neither on nor off", 207, [7.0], 4},
        {"an unknown message", 512, [31_999.0], 4},
        {"a rate for an unknown message", 511, [31_999.0, 1.0e6], 4},
        {"a reboot that is none", 246, [9.0], 3},
        {"arming with 7", 400, [7.0], 3},
        {"PX4's motor test", 310, [0.5], 3}
      ],
      px4: [
        {"an orbit on the ground", 34, [20.0], 1},
        {"a mission that is not there", 300, [], 2},
        {"termination that the circuit breaker forbids", 185, [1.0], 2},
        {"a motor test", 310, [0.5], 2},
        {"an unknown message", 512, [31_999.0], 2},
        {"a rate for an unknown message", 511, [31_999.0, 1.0e6], 4},
        {"a reboot that is none", 246, [9.0], 2},
        {"an item of the mission", 224, [1.0], 3},
        {"pause and continue", 193, [0.0], 3},
        {"a fence", 207, [1.0], 3}
      ]
    }

    for firmware <- [:ardupilot, :px4] do
      test "#{firmware}: what it refuses has its own result, and changes nothing" do
        {sim, peer} = start(unquote(firmware))
        before = SimVehicle.state(sim)

        Enum.reduce(@refused[unquote(firmware)], peer, fn {what, id, params, expected}, peer ->
          {result, peer} = command(peer, id, params)
          assert {what, result} == {what, expected}
          peer
        end)

        now = SimVehicle.state(sim)
        for key <- [:mode, :armed, :landed, :home], do: assert(now[key] == before[key])
      end

      test "#{firmware}: a command is acknowledged to its sender, each time that it comes; one for another system is not" do
        {sim, peer} = start(unquote(firmware))
        for direction <- [:out, :in], do: :ok = SimVehicle.fault(sim, :loss, 0.3, direction)

        peer =
          for confirmation <- 0..4, reduce: peer do
            peer ->
              {3, peer} = command(peer, 31_999, [], confirmation: confirmation)
              peer
          end

        for direction <- [:out, :in], do: :ok = SimVehicle.fault(sim, :loss, 0, direction)
        other = %M.CommandLong{target_system: 2, target_component: 1, command: 31_998}
        {3, peer} = peer |> Peer.forget(M.CommandAck) |> Peer.say(other) |> command(31_997)
        {acks, _peer} = Peer.take(peer, M.CommandAck)
        assert Enum.all?(acks, &(&1.command != 31_998))
      end

      test "#{firmware}: a message comes at the rate that was asked for, and not at all at -1 (M1)" do
        {_sim, peer} = start(unquote(firmware), speed: 1)
        {0, peer} = command(peer, 511, [id(Attitude) * 1.0, 100_000.0])
        {%{interval_us: 100_000}, peer} = interval(peer, id(Attitude))

        {times, peer} =
          Enum.map_reduce(1..11, Peer.forget(peer, M.Attitude), fn _nth, peer -> attitude_at(peer) end)

        # It sends in steps of up to 40 ms, and makes up for none that was missed: a few more on a busy machine.
        assert div(List.last(times) - hd(times), 10) in 80..180
        {0, peer} = command(peer, 511, [id(Attitude) * 1.0, -1.0])
        {%{interval_us: -1}, peer} = interval(peer, id(Attitude))

        {_later, peer} =
          peer |> Peer.forget(M.Heartbeat) |> Peer.forget(M.Attitude) |> Peer.await(M.Heartbeat)

        {_later, peer} = Peer.await(peer, M.Heartbeat)
        assert {[], _peer} = Peer.take(peer, M.Attitude)
        # One that it is asked for comes all the same.
        {_attitude, _peer} = ask(peer, request(id(Attitude)), M.Attitude)
      end
    end

    defp attitude_at(peer) do
      {attitude, peer} = Peer.await(peer, M.Attitude)
      {attitude.time_boot_ms, peer}
    end

    defp request(id), do: %M.CommandLong{command: 512, param1: id * 1.0}

    defp interval(peer, id) do
      message = %M.CommandLong{command: 510, param1: id * 1.0}
      peer |> Peer.forget(M.MessageInterval) |> ask(message, M.MessageInterval, &(&1.message_id == id))
    end
  end

  describe "failsafes" do
    @landing [ardupilot: :gps, ardupilot: :ekf, px4: :gps, px4: :ekf]
    @returning [
      ardupilot: :rc,
      ardupilot: :gcs,
      ardupilot: :fence,
      px4: :rc,
      px4: :gcs,
      px4: :battery_critical
    ]

    for {cases, modes} <- [{@landing, ["LAND", "AUTO_LAND"]}, {@returning, ["RTL", "AUTO_RTL"]}],
        {firmware, kind} <- cases do
      test "#{firmware}: #{kind} changes to #{hd(modes)}, and brings the vehicle down" do
        {sim, peer} = start(unquote(firmware), speed: 20)
        # What it sends would fill this process's mailbox.
        sim |> fly(peer) |> Peer.close()
        :ok = SimVehicle.failsafe(sim, unquote(kind))
        assert SimVehicle.await(sim, &(&1.mode in unquote(modes)))
        assert unquote(kind) in SimVehicle.state(sim).failsafes
        assert SimVehicle.await(sim, &(not &1.armed && not &1.airborne))
      end
    end

    test "ArduPilot says so: the text, and CRITICAL in the heartbeat; a ground station that is back clears it (H5)" do
      {sim, peer} = start(:ardupilot, params: %{"FS_GCS_ENABLE" => 1}, speed: 20)
      peer = fly(sim, peer)
      heartbeat = %M.Heartbeat{type: 6, autopilot: 8}
      peer = peer |> Peer.forget(M.Statustext) |> Peer.say(heartbeat)
      # It hears no other one for FS_GCS_TIMEOUT.
      peer = peer |> await_text("GCS Failsafe") |> await_status(5)
      assert SimVehicle.state(sim).mode == "RTL"
      peer |> Peer.say(heartbeat) |> await_text("GCS Failsafe Cleared")
      assert :gcs not in SimVehicle.state(sim).failsafes
    end

    test "ArduPilot's fence is where its parameters say: higher than FENCE_ALT_MAX it comes home" do
      {sim, peer} = start(:ardupilot, params: %{"FENCE_ENABLE" => 1, "FENCE_ALT_MAX" => 30}, speed: 20)
      peer = fly(sim, peer)
      assert SimVehicle.state(sim).failsafes == []
      up = %M.SetPositionTargetLocalNed{coordinate_frame: 1, type_mask: 0xFF8, z: -50.0}

      peer
      |> Peer.say(Map.merge(up, %{target_system: 1, target_component: 1}))
      |> await_text("Fence Breached")

      assert SimVehicle.await(sim, &(&1.mode == "RTL"))
    end
  end

  describe "the battery" do
    for firmware <- [:ardupilot, :px4] do
      test "#{firmware}: drains in flight, at low charge the vehicle comes down; a full one is fitted on the ground only" do
        {sim, peer} = start(unquote(firmware), battery: [capacity_mah: 1000.0], speed: 30)
        peer = fly(sim, peer)
        {first, peer} = Peer.await(peer, M.SysStatus)
        {later, peer} = Peer.await(peer, M.SysStatus, &(&1.battery_remaining < first.battery_remaining - 5))
        assert later.voltage_battery < first.voltage_battery
        assert later.current_battery > 1_000
        {status, peer} = Peer.await(peer, M.BatteryStatus)
        Peer.close(peer)
        assert status.current_consumed > 50
        :ok = SimVehicle.happen(sim, :swap_battery)
        assert SimVehicle.state(sim).battery < 0.95
        assert SimVehicle.await(sim, &(not &1.armed && not &1.airborne))
        assert :battery in SimVehicle.state(sim).failsafes
        :ok = SimVehicle.happen(sim, :swap_battery)
        assert SimVehicle.state(sim).battery > 0.99
        assert SimVehicle.state(sim).failsafes == []
      end
    end
  end

  describe "links over TCP" do
    test "half open: nothing comes though the connection stays, and everything does afterwards; a drop ends it" do
      sim = start_supervised!({SimVehicle, link: "tcpin:127.0.0.1:0", ready_s: 2.0, speed: 10})
      {_heartbeat, peer} = sim |> SimVehicle.port() |> Peer.tcp() |> Peer.await(M.Heartbeat)
      :ok = SimVehicle.fault(sim, :half_open, true)
      %{sent: sent, seconds: seconds} = SimVehicle.state(sim)
      SimVehicle.await(sim, &(&1.seconds > seconds + 3))
      assert SimVehicle.state(sim).sent == sent
      :ok = SimVehicle.fault(sim, :half_open, false)
      {_beat, peer} = peer |> Peer.forget(M.Heartbeat) |> Peer.await(M.Heartbeat)
      :ok = SimVehicle.fault(sim, :drop, true)
      socket = peer.socket
      assert_receive {:tcp_closed, ^socket}
      {_heartbeat, _peer} = sim |> SimVehicle.port() |> Peer.tcp() |> Peer.await(M.Heartbeat)
    end
  end
end
