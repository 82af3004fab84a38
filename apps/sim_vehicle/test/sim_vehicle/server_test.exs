defmodule SimVehicle.ServerTest do
  use ExUnit.Case, async: true

  alias MavCodec.Messages, as: M
  alias SimVehicle.Peer

  defp start(opts) do
    opts = Keyword.merge([ready_s: 2.0, speed: 10], opts)
    start_supervised!({SimVehicle, opts}, id: make_ref())
  end

  defp udp(opts \\ []) do
    peer = Peer.udp()
    {start([link: "udpout:127.0.0.1:#{Peer.port(peer)}"] ++ opts), peer}
  end

  # What the vehicle did not hear; it is looked for with each heartbeat, because a datagram takes its time.
  defp silenced(sim, peer) do
    {_heartbeat, peer} = Peer.await(peer, M.Heartbeat)
    SimVehicle.stats(sim).faults.in[:silenced] || silenced(sim, peer)
  end

  # On a busy machine it has been in the air for a while when a fault is set.
  defp fly(sim, seconds) do
    %{seconds: begun} = SimVehicle.state(sim)
    SimVehicle.await(sim, &(&1.seconds > begun + seconds && &1))
  end

  defp arm(peer, system \\ 1),
    do: Peer.say(peer, %M.CommandLong{target_system: system, target_component: 1, command: 400, param1: 1.0})

  describe "transports" do
    test "udpout: sends by itself, one frame a datagram, and hears answers" do
      {sim, peer} = udp(system: 9, params: %{"DISARM_DELAY" => 0})
      {%{autopilot: 3}, peer} = Peer.await(peer, M.Heartbeat)
      SimVehicle.await(sim, & &1.ready)
      {%{command: 400, result: 0}, _peer} = peer |> arm(9) |> Peer.await(M.CommandAck)
      assert SimVehicle.state(sim).armed
    end

    test "udpin: sends nothing until it is addressed, then answers the latest sender" do
      sim = start(link: "udpin:127.0.0.1:0", firmware: :px4)
      SimVehicle.await(sim, & &1.ready)
      assert %{sent: 0, unsent: unsent} = SimVehicle.stats(sim)
      assert unsent > 0
      first = Peer.udp(SimVehicle.port(sim)) |> Peer.say(%M.Heartbeat{type: 6, autopilot: 8})
      {_heartbeat, _first} = Peer.await(first, M.Heartbeat)
      second = Peer.udp(SimVehicle.port(sim)) |> Peer.say(%M.Heartbeat{type: 6, autopilot: 8})
      {_heartbeat, _second} = Peer.await(second, M.Heartbeat)
    end

    test "tcpin: boot text first, as on a serial line, then frames; a second connection after the first is closed" do
      sim = start(link: "tcpin:127.0.0.1:0")
      peer = Peer.tcp(SimVehicle.port(sim)) |> Peer.await_bytes("Init ArduCopter V4.6.3")
      {_heartbeat, peer} = Peer.await(peer, M.Heartbeat)
      Peer.close(peer)
      peer = Peer.tcp(SimVehicle.port(sim))
      {_heartbeat, peer} = Peer.await(peer, M.Heartbeat)

      {%{command: 31_999, result: 3}, _peer} =
        peer
        |> Peer.say(%M.CommandLong{target_system: 1, target_component: 1, command: 31_999})
        |> Peer.await(M.CommandAck)
    end

    test "tcp: connects, and again when the connection is lost" do
      {listener, port} = Peer.tcp_listen()
      start(link: "tcp:127.0.0.1:#{port}")
      peer = Peer.tcp_accept(listener)
      {_heartbeat, peer} = Peer.await(peer, M.Heartbeat)
      Peer.close(peer)
      {_heartbeat, _peer} = listener |> Peer.tcp_accept() |> Peer.await(M.Heartbeat)
    end

    test "a port that is taken is an error that names the link" do
      {_listener, port} = Peer.tcp_listen()
      link = "tcpin:127.0.0.1:#{port}"
      Process.flag(:trap_exit, true)
      assert {:error, {:link, ^link, :eaddrinuse}} = SimVehicle.start_link(link: link)
    end

    test "garbage and unknown frames are ignored" do
      {sim, peer} = udp()
      {_heartbeat, peer} = Peer.await(peer, M.Heartbeat)
      SimVehicle.await(sim, & &1.ready)
      peer = Enum.reduce(1..50, peer, fn n, peer -> Peer.transmit(peer, :crypto.strong_rand_bytes(n)) end)
      {%{command: 400}, _peer} = peer |> arm() |> Peer.await(M.CommandAck)
    end

    test "MAVLink 1 is spoken if configured" do
      {_sim, peer} = udp(mavlink: 1)
      {_heartbeat, peer} = Peer.await(peer, M.Heartbeat)
      # The first datagram is boot text.
      assert peer.raw |> Enum.map(&:binary.first/1) |> Enum.uniq() |> Enum.sort() |> Enum.reject(&(&1 == ?\n)) ==
               [0xFE]
    end
  end

  describe "faults" do
    test "loss: the peer misses what the counter says" do
      {sim, peer} = udp()
      {_heartbeat, peer} = Peer.await(peer, M.Heartbeat)
      :ok = SimVehicle.fault(sim, :loss, 0.25)
      fly(sim, 40)
      :ok = SimVehicle.fault(sim, :loss, 0)
      # What is lost shows by the frames after it: one that is missing may still come, out of order.
      %{seconds: seconds} = SimVehicle.state(sim)
      {_after_it, peer} = Peer.await(peer, M.SystemTime, &(&1.time_boot_ms > (seconds + 5) * 1000))
      lost = SimVehicle.stats(sim).faults.out.lost
      assert lost > 1000
      assert_in_delta MavCodec.Parser.stats(peer.parser).lost, lost, 3
    end

    test "corruption: the peer's parser counts it and finds the rest" do
      {sim, peer} = udp()
      :ok = SimVehicle.fault(sim, :corrupt, 0.1)
      %{seconds: seconds} = fly(sim, 20)
      :ok = SimVehicle.fault(sim, :corrupt, 0)
      {_last, peer} = Peer.await(peer, M.SystemTime, &(&1.time_boot_ms > seconds * 1000))
      stats = MavCodec.Parser.stats(Peer.drain(peer).parser)
      corrupted = SimVehicle.stats(sim).faults.out.corrupted
      assert corrupted > 50
      assert stats.frames > corrupted * 5
      # A bit of the header may make it another id or length: not every one shows as a wrong CRC.
      assert stats.crc_errors in div(corrupted, 2)..corrupted
    end

    test "silence sends nothing while the vehicle lives, deafness hears nothing" do
      {sim, peer} = udp(params: %{"DISARM_DELAY" => 0})
      {_heartbeat, peer} = Peer.await(peer, M.Heartbeat)
      SimVehicle.await(sim, & &1.ready)
      :ok = SimVehicle.fault(sim, :silence, true)
      sent = SimVehicle.stats(sim).sent
      peer = arm(peer)
      assert SimVehicle.await(sim, & &1.armed)
      assert SimVehicle.stats(sim).sent == sent
      :ok = SimVehicle.fault(sim, :silence, false)
      :ok = SimVehicle.fault(sim, :deaf, true)
      before = SimVehicle.stats(sim)
      assert silenced(sim, arm(peer)) == 1
      assert SimVehicle.stats(sim).received == before.received
    end

    test "delay holds frames back, and none is lost" do
      {sim, peer} = udp()
      :ok = SimVehicle.fault(sim, :delay, {50, 20})
      {_heartbeat, _peer} = Peer.await(peer, M.Heartbeat)
      assert SimVehicle.stats(sim).faults.out[:overflow] == nil
    end

    test "a frozen vehicle's time stands still, and it answers nothing" do
      {sim, peer} = udp()
      {_heartbeat, peer} = Peer.await(peer, M.Heartbeat)
      :ok = SimVehicle.fault(sim, :freeze, true)
      %{seconds: seconds, sent: sent} = SimVehicle.state(sim)
      _peer = arm(peer)
      # A round trip through its mailbox, so that the datagram before it was looked at.
      assert %{seconds: ^seconds, sent: ^sent, frozen: true} = SimVehicle.state(sim)
      :ok = SimVehicle.fault(sim, :freeze, false)
      assert SimVehicle.await(sim, &(&1.seconds > seconds))
    end

    test "a reboot restarts time, sequence and mode; parameters and place stay" do
      {sim, peer} = udp()
      SimVehicle.await(sim, & &1.ready)
      :ok = SimVehicle.happen(sim, {:set_param, "RTL_ALT", 3000})
      SimVehicle.subscribe(sim)
      :ok = SimVehicle.reboot(sim)
      assert_receive {:sim, ^sim, :rebooting}
      # A busy machine looks when that is over already.
      assert %{off: off?, boots: boots} = SimVehicle.state(sim)
      assert off? or boots == 2
      assert SimVehicle.await(sim, &(&1.boots == 2))
      {%{time_boot_ms: _ms}, peer} = Peer.await(peer, M.SystemTime, &(&1.time_boot_ms < 1500))
      read = %M.ParamRequestRead{target_system: 1, target_component: 1, param_index: -1, param_id: "RTL_ALT"}
      {%{param_value: 3000.0}, _peer} = peer |> Peer.say(read) |> Peer.await(M.ParamValue)
    end

    test "a reboot loses a TCP connection, and the new one hears boot text again" do
      sim = start(link: "tcpin:127.0.0.1:0")
      peer = Peer.tcp(SimVehicle.port(sim)) |> Peer.await_bytes("Init ArduCopter")
      :ok = SimVehicle.reboot(sim)
      socket = peer.socket
      assert_receive {:tcp_closed, ^socket}
      SimVehicle.await(sim, &(&1.boots == 2))
      SimVehicle.port(sim) |> Peer.tcp() |> Peer.await_bytes("Init ArduCopter")
    end

    test "the clock jumps" do
      {sim, peer} = udp()
      {%{time_unix_usec: first}, peer} = Peer.await(peer, M.SystemTime, &(&1.time_unix_usec > 0))
      :ok = SimVehicle.fault(sim, :clock_jump, -3600)
      {%{time_unix_usec: later}, _peer} = Peer.await(peer, M.SystemTime, &(&1.time_unix_usec < first))
      assert later < first - 3_000_000_000
    end

    test "an unknown fault is refused with a text" do
      {sim, _peer} = udp()
      assert {:error, "expected a fault of" <> _rest} = SimVehicle.fault(sim, :fire, 1)
      assert {:error, _text} = SimVehicle.fault(sim, :loss, 2)
    end
  end

  describe "control" do
    test "events are sent to subscribers, failsafes begin and end" do
      {sim, peer} = udp()
      {_heartbeat, peer} = Peer.await(peer, M.Heartbeat)
      SimVehicle.subscribe(sim)
      SimVehicle.await(sim, & &1.ready)
      _peer = arm(peer)
      assert_receive {:sim, ^sim, {:heard, %M.CommandLong{command: 400}, {255, 190}}}
      assert_receive {:sim, ^sim, :armed}
      :ok = SimVehicle.failsafe(sim, :rc)
      assert_receive {:sim, ^sim, {:failsafe, :rc, true}}
      assert_receive {:sim, ^sim, :disarmed}
      assert SimVehicle.state(sim).failsafes == [:rc]
      :ok = SimVehicle.failsafe(sim, :rc, false)
      assert SimVehicle.state(sim).failsafes == []
    end

    test "a subscriber that dies is forgotten" do
      {sim, _peer} = udp()
      {pid, ref} = spawn_monitor(fn -> SimVehicle.subscribe(sim) end)
      assert_receive {:DOWN, ^ref, :process, ^pid, :normal}
      assert SimVehicle.state(sim).system == 1
    end
  end

  describe "script" do
    test "a vehicle flies its script again and again, and nobody else's commands disturb it" do
      script = [:ready, :arm, {:takeoff, 8}, {:goto, 20, 0, 10}, :rtl, :landed, :swap_battery, {:wait, 1}]

      for firmware <- [:ardupilot, :px4] do
        {sim, peer} = udp(firmware: firmware, script: script, speed: 100)
        SimVehicle.subscribe(sim)
        # What it sends would fill this process's mailbox, in which the events are looked for.
        Peer.close(peer)

        for _flight <- 1..2,
            event <- [:armed, :airborne, :landed, :disarmed],
            do: assert_receive({:sim, ^sim, ^event})
      end
    end

    test "it pauses when somebody else commands, until the vehicle has been on the ground for half a minute" do
      script = [:ready, :arm, {:takeoff, 8}, {:wait, 3600}, :rtl, :landed]
      {sim, peer} = udp(script: script, speed: 50)
      {_heartbeat, peer} = Peer.await(peer, M.Heartbeat)
      SimVehicle.await(sim, &(&1.landed == :in_air))

      # Watched by the vehicle's own process, from before the command on: its time goes fifty times as fast as ours.
      on_the_ground = fn view ->
        case {Process.get(:landed_at), view.armed} do
          {nil, true} -> nil
          {nil, false} -> Process.put(:landed_at, view.seconds)
          {_landed_at, false} -> nil
          {landed_at, true} -> view.seconds - landed_at
        end
      end

      request = :gen_server.send_request(sim, {:await, on_the_ground})

      peer =
        Peer.say(peer, %M.CommandLong{
          target_system: 1,
          target_component: 1,
          command: 176,
          param1: 1.0,
          param2: 9.0
        })

      {%{command: 176, result: 0}, _peer} = Peer.await(peer, M.CommandAck)
      assert {:reply, seconds} = :gen_server.receive_response(request, 180_000)
      assert seconds > 29
    end
  end

  test "a fleet flies: each vehicle its own id, place and firmware" do
    peer = Peer.udp()

    fleet =
      start_supervised!(
        {SimVehicle.Fleet, count: 3, link: "udpout:127.0.0.1:#{Peer.port(peer)}", speed: 20, ready_s: 2.0}
      )

    sims = SimVehicle.Fleet.sims(fleet)
    assert Map.keys(sims) == [1, 2, 3]
    for {_system, sim} <- sims, do: SimVehicle.await(sim, & &1.airborne)
    peer = Peer.drain(peer)

    assert peer.parser |> MavCodec.Parser.stats() |> Map.fetch!(:sources) |> Map.keys() |> Enum.sort() == [
             {1, 1},
             {2, 1},
             {3, 1}
           ]

    assert peer
           |> Peer.messages()
           |> Enum.filter(&match?(%M.Heartbeat{}, &1))
           |> Enum.map(& &1.autopilot)
           |> Enum.uniq()
           |> Enum.sort() == [3, 12]
  end

  test "the task's arguments become options of the fleet" do
    assert Mix.Tasks.Sim.Fleet.fleet_opts(
             count: 2,
             to: "tcpin:127.0.0.1:5760",
             still: true,
             home: "1.5,2.5,3"
           )[:home] == {1.5, 2.5, 3.0}

    opts = Mix.Tasks.Sim.Fleet.fleet_opts(to: "tcpin:127.0.0.1:5760", still: true)
    assert opts[:link].(2) == "tcpin:127.0.0.1:5762"
    refute opts[:fly]

    assert_raise Mix.Error, ~r/unknown arguments: .*--cuont/, fn ->
      Mix.Tasks.Sim.Fleet.run(["--cuont", "3"])
    end

    assert_raise Mix.Error, ~r/expected --firmware/, fn -> Mix.Tasks.Sim.Fleet.fleet_opts(firmware: "x") end
    assert_raise Mix.Error, ~r/expected --home/, fn -> Mix.Tasks.Sim.Fleet.fleet_opts(home: "x") end
  end
end
