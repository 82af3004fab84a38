defmodule Aerie.Vehicle.SessionTest do
  @moduledoc "Vehicles of a running gateway, fed through the router as links do; its processes are killed while they fly."
  use Aerie.GatewayCase, async: true

  import Aerie.Flight, only: [frame: 2, frame: 3, frames: 1, pick: 2, run: 1]

  alias Aerie.Base.{Names, Store}
  alias Aerie.Vehicle
  alias Aerie.Vehicle.Events.Journal
  alias Aerie.Base.PubSub
  alias MavCodec.Messages, as: M

  @copter %M.Heartbeat{type: 2, autopilot: 3, base_mode: 81, custom_mode: 4, system_status: 3}
  @second 1_000_000

  defp gateway(config \\ %{}) do
    start_gateway(config, with: [:router])
  end

  defp deliver(gateway, frames),
    do: Aerie.Reader.deliver(gateway, %{id: "radio", network: "main", peer: :one}, frames)

  # Waits until everything that was delivered is in the journal: session and event loop answer after what came before.
  defp settle(gateway, key) do
    for role <- [:session, :events], do: :sys.get_state(Names.via(gateway, role, key), Aerie.Patience.ms())
    :ok
  end

  defp alive(gateway, key) do
    eventually(fn ->
      Names.whereis(gateway, :session, key) && Names.whereis(gateway, :events, key) &&
        Store.vehicle(gateway, key)
    end)
  end

  defp at(seconds), do: round(seconds * @second)

  test "an autopilot's heartbeat makes a vehicle with a snapshot, and its events are in the journal" do
    gateway = gateway()
    PubSub.subscribe(gateway, :events)
    PubSub.subscribe(gateway, {:vehicle, "VID-007"})
    armed = %{@copter | base_mode: 0xD1}
    deliver(gateway, [frame(@copter, at(1), system: 7), frame(armed, at(2), system: 7)])

    assert_receive {:fleet, :events, %{type: "armed", vehicle: "VID-007", seq: 1, time: 2_000_000}}
    assert_receive {:fleet, {:vehicle, "VID-007"}, "VID-007"}
    assert eventually(fn -> Store.vehicle(gateway, "VID-007").groups.mode.data.armed end)

    assert [%{id: "VID-007", status: :online, links: ["radio"], vehicle_type: "copter"}] =
             Store.vehicles(gateway)

    assert [%{type: "armed"}] = Journal.pending(gateway)
  end

  test "frames that come while its processes are started are handled after those by which it was found" do
    gateway = gateway()
    PubSub.subscribe(gateway, :events)
    starter = Names.whereis(gateway, :vehicle_starter)
    :sys.suspend(starter, Aerie.Patience.ms())
    # With frames waiting a link leaves the start to the starter.
    for n <- 1..65, do: send(self(), {:waiting, n})
    deliver(gateway, [frame(@copter, at(1))])
    assert {:ok, _session} = Vehicle.Supervisor.ensure(gateway, {"main", 1})
    deliver(gateway, [frame(%{@copter | base_mode: 0xD1}, at(2))])
    :sys.resume(starter, Aerie.Patience.ms())
    :sys.get_state(starter, Aerie.Patience.ms())
    settle(gateway, {"main", 1})
    assert_receive {:fleet, :events, %{type: "armed", seq: 1}}
    assert %{groups: %{mode: %{data: %{armed: true}}}} = Store.vehicle(gateway, {"main", 1})
    assert [%{type: "armed"}] = Journal.pending(gateway)
  end

  test "a ground station's or a gimbal's heartbeat makes none (H2)" do
    gateway = gateway()
    deliver(gateway, [frame(%M.Heartbeat{type: 6, autopilot: 8}, at(1), system: 255, component: 190)])
    deliver(gateway, [frame(%M.Heartbeat{type: 26, autopilot: 8}, at(1), system: 1, component: 154)])
    assert Aerie.GatewayCase.trees(gateway) == []
    assert Store.vehicles(gateway) == []
  end

  test "requests for streams stop while the executor asks by the same commands (C8), once their answer came" do
    gateway = gateway()
    deliver(gateway, [frame(@copter, at(1))])
    alive(gateway, {"main", 1})
    session = Names.whereis(gateway, :session, {"main", 1})
    arbiter = fn -> :sys.get_state(session, Aerie.Patience.ms()).core.streams end
    begun = System.monotonic_time(:millisecond)
    # Its first requests are due two seconds after it was heard.
    deliver(gateway, [frame(@copter, at(4))])
    assert {{:set, id}, _sent} = eventually(fn -> arbiter.().in_flight end)
    send(session, {:alone, self(), true})

    # Two seconds after its request it waits for no answer any more, which a busy machine may see.
    early? =
      receive do
        :alone -> true
      after
        0 -> false
      end

    assert not early? or System.monotonic_time(:millisecond) - begun >= 2_000
    deliver(gateway, [frame(%M.CommandAck{command: 511, result: 0}, at(4))])
    if not early?, do: assert_receive(:alone)
    deliver(gateway, [frame(@copter, at(10))])
    assert %{in_flight: nil, queue: [_ | _], held: true} = arbiter.()
    send(session, {:alone, self(), false})
    deliver(gateway, [frame(@copter, at(12))])
    assert {{:set, other}, _sent} = eventually(fn -> arbiter.().in_flight end)
    assert other != id
  end

  test "silence is noticed by the clock, without any frame" do
    gateway = gateway(%{timeouts: %{vehicle_stale_s: 0.1, vehicle_lost_s: 0.3}})
    PubSub.subscribe(gateway, :events)
    deliver(gateway, [frame(@copter, at(1))])
    assert_receive {:fleet, :events, %{type: "link.lost", time: 1_300_000}}
    # The event is committed just before the status is shown.
    eventually(fn -> match?(%{status: :lost}, Store.vehicle(gateway, "VID-001")) end)
    deliver(gateway, [frame(@copter, at(100))])
    assert_receive {:fleet, :events, %{type: "link.restored", time: 100_000_000}}
  end

  describe "the machine's clock is set" do
    # The session counts from its last frame, so no time has to be waited for.
    defp pass(gateway, us) do
      :sys.replace_state(Names.via(gateway, :session, {"main", 1}), fn %{clock: clock} = state ->
        %{state | clock: %{clock | moment: clock.moment - us}}
      end)
    end

    # As the session sees it: the offset of the clocks has changed since its last check. Frames come by a live link.
    defp set_clock(gateway, step) do
      :sys.replace_state(Names.via(gateway, :session, {"main", 1}), &%{&1 | host: &1.host - step})
    end

    defp live(gateway, frames) do
      Store.put_link(gateway, "radio", %{id: "radio", kind: :udp_server, network: "main"})
      deliver(gateway, frames)
      settle(gateway, {"main", 1})
    end

    for step <- [-3_600, 3_600] do
      test "by #{step} s: a silent vehicle is lost at the same time as without it, and its age is the same" do
        step = at(unquote(step))
        gateway = gateway(%{timeouts: %{vehicle_stale_s: 60.0, vehicle_lost_s: 120.0}})
        PubSub.subscribe(gateway, :events)
        heard = System.os_time(:microsecond)
        # With the second read the link is known to be live.
        live(gateway, [frame(@copter, heard - 1_000)])
        live(gateway, [frame(@copter, heard)])
        set_clock(gateway, step)
        # Two clocks are not read in the same microsecond.
        near? = &(abs(&1 - &2) < 20_000)
        eventually(fn -> near?.(Store.vehicle(gateway, "VID-001").last_heard, heard + step) end)
        pass(gateway, at(121))
        assert_receive {:fleet, :events, %{type: "link.lost", time: lost}}
        assert near?.(lost, heard + step + at(120))
        # Further frames have the new time.
        live(gateway, [frame(@copter, heard + step + at(122))])
        assert_receive {:fleet, :events, %{type: "link.restored"}}
      end
    end

    test "a live frame that is late by seconds, and one after a silence of seconds, do not restart time" do
      gateway = gateway(%{timeouts: %{vehicle_stale_s: 300.0, vehicle_lost_s: 600.0}})
      PubSub.subscribe(gateway, :events)
      now = System.os_time(:microsecond)
      live(gateway, [frame(@copter, now - at(3_000))])
      live(gateway, [frame(@copter, now - at(2_000))])
      assert_receive {:fleet, :events, %{type: "link.lost", time: lost}}
      assert lost == now - at(2_400)
      assert_receive {:fleet, :events, %{type: "link.restored"}}
      live(gateway, [frame(@copter, now - at(2_500))])
      assert Store.vehicle(gateway, "VID-001").last_heard == now - at(2_000)
      # One from a time that the machine's clock has not reached: the clock was set back since.
      live(gateway, [frame(@copter, now + at(3_600))])
      live(gateway, [frame(@copter, now)])
      eventually(fn -> Store.vehicle(gateway, "VID-001").last_heard in now..(now + at(60)) end)
      refute_received {:fleet, :events, %{type: "link.lost"}}
    end

    test "a recording's time is its own" do
      gateway = gateway()
      link = %{id: "radio", network: "main", spec: %{recorded: true, speed: 1.0}}
      Store.put_link(gateway, "radio", link)
      deliver(gateway, [frame(@copter, at(1))])
      deliver(gateway, [frame(@copter, at(2))])
      settle(gateway, {"main", 1})
      set_clock(gateway, at(3_600))
      send(Names.whereis(gateway, :session, {"main", 1}), {:tick, System.monotonic_time(:microsecond)})
      settle(gateway, {"main", 1})

      assert :sys.get_state(Names.via(gateway, :session, {"main", 1}), Aerie.Patience.ms()).core.last_heard ==
               at(2)
    end
  end

  test "between the frames of a recording that is read as fast as it can be no time passes, but after its end" do
    gateway = gateway(%{timeouts: %{vehicle_stale_s: 0.1, vehicle_lost_s: 0.3}})
    PubSub.subscribe(gateway, :events)
    link = %{id: "radio", network: "main", status: :up, spec: %{recorded: true, speed: :max}}
    Store.put_link(gateway, "radio", link)
    state = fn -> :sys.get_state(Names.via(gateway, :session, {"main", 1}), Aerie.Patience.ms()) end
    deliver(gateway, [frame(@copter, at(1))])
    settle(gateway, {"main", 1})
    # A second at least.
    eventually(fn -> state.().ticks > 10 end)
    session = Names.whereis(gateway, :session, {"main", 1})
    Process.exit(session, :kill)
    eventually(fn -> Names.whereis(gateway, :session, {"main", 1}) not in [nil, session] end)
    eventually(fn -> state.().ticks > 10 end)
    assert state.().core.status == :online
    refute_received {:fleet, :events, %{type: "link.lost"}}
    Store.put_link(gateway, "radio", %{link | status: :ended})
    assert_receive {:fleet, :events, %{type: "link.lost"}}
  end

  test "a session that is killed during a silence still notices that the vehicle is lost" do
    gateway = gateway(%{timeouts: %{vehicle_stale_s: 0.1, vehicle_lost_s: 0.3}})
    PubSub.subscribe(gateway, :events)
    deliver(gateway, [frame(@copter, at(1))])
    settle(gateway, {"main", 1})
    Process.exit(Names.whereis(gateway, :session, {"main", 1}), :kill)
    assert_receive {:fleet, :events, %{type: "link.lost"}}
    # Once: the session looks at the silence with each tick.
    ticks = fn -> :sys.get_state(Names.via(gateway, :session, {"main", 1}), Aerie.Patience.ms()).ticks end
    before = ticks.()
    eventually(fn -> ticks.() > before + 3 end)
    settle(gateway, {"main", 1})
    refute_received {:fleet, :events, %{type: "link.lost"}}
  end

  test "a session that was kept from running takes no vehicle for lost whose frames wait in its mailbox" do
    gateway = gateway(%{timeouts: %{vehicle_stale_s: 30.0, vehicle_lost_s: 60.0}})
    PubSub.subscribe(gateway, :events)
    deliver(gateway, [frame(@copter, at(1))])
    settle(gateway, {"main", 1})
    session = Names.whereis(gateway, :session, {"main", 1})
    :sys.suspend(session, Aerie.Patience.ms())
    # A tick waits; the frame after it comes 59.9 s after the first one.
    eventually(fn -> Process.info(session, :message_queue_len) != {:message_queue_len, 0} end)
    since = System.monotonic_time(:microsecond) - at(59) - 900_000

    :sys.replace_state(session, fn %{clock: clock} = state ->
      %{state | clock: %{clock | moment: since}}
    end)

    deliver(gateway, [frame(@copter, at(60) + 900_000)])
    eventually(fn -> System.monotonic_time(:microsecond) - since > at(60) end)
    :sys.resume(session, Aerie.Patience.ms())
    settle(gateway, {"main", 1})
    assert Store.vehicle(gateway, {"main", 1}).last_heard == at(60) + 900_000
    refute_received {:fleet, :events, %{type: "link.lost"}}
  end

  describe "killed while three vehicles fly" do
    # One recording flown by three vehicles at once, in reads of 20 frames.
    @keys for system <- 1..3, do: {"main", system}

    defp fly(gateway, recording, between) do
      # Between its frames no time passes, however long a busy machine takes.
      Store.put_link(gateway, "radio", %{id: "radio", network: "main", spec: %{recorded: true, speed: 0.0}})

      recording
      |> Enum.chunk_every(20)
      |> Enum.with_index()
      |> Enum.each(fn {read, n} ->
        for {_, system} <- @keys, do: deliver(gateway, Enum.map(read, &%{&1 | system: system}))
        between.(n)
      end)

      Enum.each(@keys, &settle(gateway, &1))
    end

    # The events of each vehicle without what depends on its id.
    defp journal(gateway) do
      for n <- 1..3,
          do:
            for(
              e <- Journal.pending(gateway),
              e.vehicle == "VID-00#{n}",
              do: {e.seq, e.type, e.time, e.data}
            )
    end

    defp expected(recording), do: for(e <- run(recording).events, do: {e.seq, e.type, e.time, e.data})

    for role <- [:session, :events, :tree] do
      test "#{role}: no event is lost or duplicated, and other vehicles are not affected" do
        gateway = gateway()
        recording = frames("arducopter_mavlink1")
        role = unquote(role)

        fly(gateway, recording, fn
          # The restarter delays a tree that dies more often.
          n when n in [60, 200] or (role != :tree and rem(n, 40) == 20) ->
            key = {"main", 2}
            settle(gateway, key)
            others = for k <- @keys -- [key], do: Names.whereis(gateway, :session, k)
            pid = Names.whereis(gateway, role, key)
            ref = Process.monitor(pid)
            Process.exit(pid, :kill)
            assert_receive {:DOWN, ^ref, :process, _, _}
            alive(gateway, key)
            assert others == for(k <- @keys -- [key], do: Names.whereis(gateway, :session, k))

          _other ->
            :ok
        end)

        expected = expected(recording)
        assert [^expected, killed, ^expected] = journal(gateway)
        assert killed == expected
      end
    end

    test "the event loop with a full inbox: every entry is processed once" do
      gateway = gateway()
      recording = frames("arducopter_mavlink1")

      fly(gateway, recording, fn
        n when rem(n, 25) == 10 ->
          key = {"main", 2}

          # At once: its entries are in the journal, and frames may be in the session's mailbox.
          events = Names.whereis(gateway, :events, key)
          :sys.get_state(Names.via(gateway, :session, key), Aerie.Patience.ms())
          Process.exit(events, :kill)
          ref = Process.monitor(events)
          assert_receive {:DOWN, ^ref, :process, _, _}
          alive(gateway, key)

        _other ->
          :ok
      end)

      expected = expected(recording)
      assert [^expected, ^expected, ^expected] = journal(gateway)
    end

    test "with frames in its mailbox: those are lost, but their changes are detected, and nothing is duplicated" do
      gateway = gateway()
      recording = frames("arducopter_mavlink1")
      key = {"main", 2}

      fly(gateway, recording, fn
        n when rem(n, 40) == 25 ->
          session = Names.whereis(gateway, :session, key)
          Process.exit(session, :kill)
          ref = Process.monitor(session)
          assert_receive {:DOWN, ^ref, :process, _, _}
          alive(gateway, key)

        # Never more than a second's frames behind, as with a radio.
        n when rem(n, 10) == 0 ->
          Enum.each(@keys, &settle(gateway, &1))

        _other ->
          :ok
      end)

      events = for e <- Journal.pending(gateway), e.vehicle == "VID-002", do: e
      flight = ~w(armed disarmed takeoff landed mode_change)
      names = fn events -> for {type, _ms, data} <- pick(events, flight), do: {type, data["to"]} end
      assert names.(events) == names.(run(recording).events)
      assert Enum.map(events, & &1.seq) == Enum.to_list(1..length(events))
      assert length(Enum.uniq_by(events, & &1.id)) == length(events)
      assert [_, _, _] = journal(gateway)
    end

    test "the restarter delays a tree that dies again and again, and the others continue" do
      gateway = gateway()
      deliver(gateway, [frame(@copter, at(1))])
      deliver(gateway, [frame(@copter, at(1), system: 2)])
      other = Names.whereis(gateway, :session, {"main", 2})

      for _ <- 1..3 do
        eventually(fn ->
          tree = Names.whereis(gateway, :tree, {"main", 1})
          tree && Process.exit(tree, :kill)
        end)
      end

      eventually(fn -> Names.whereis(gateway, :session, {"main", 1}) end)
      assert Names.whereis(gateway, :session, {"main", 2}) == other
      assert Store.counter(gateway, {:vehicles, :tree_restarts}) >= 2
    end
  end

  test "impossible values are counted for the vehicle" do
    gateway = gateway()
    deliver(gateway, [frame(@copter, at(1)), frame(%M.HomePosition{latitude: 950_000_000}, at(1.1))])
    settle(gateway, {"main", 1})
    assert Store.counter(gateway, {:vehicle, "VID-001", :invalid}) == 1
  end

  test "a removed vehicle starts again" do
    gateway = gateway()
    deliver(gateway, [frame(@copter, at(1))])
    settle(gateway, {"main", 1})
    :ok = Vehicle.Supervisor.remove(gateway, {"main", 1})
    assert Store.vehicle(gateway, "VID-001") == nil
  end
end
