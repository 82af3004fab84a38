defmodule Aerie.Vehicle.SessionTest do
  @moduledoc "Vehicles of a running gateway, fed through the router as links do; its processes are killed while they fly."
  use Aerie.GatewayCase, async: true

  import Aerie.Flight, only: [frame: 2, frame: 3, frames: 1, pick: 2, run: 1]

  alias Aerie.{Fleet, Names, Router, Store, Vehicle}
  alias Aerie.Store.PubSub
  alias MavCodec.Messages, as: M

  @copter %M.Heartbeat{type: 2, autopilot: 3, base_mode: 81, custom_mode: 4, system_status: 3}
  @second 1_000_000

  defp gateway(config \\ %{}) do
    start_gateway(config, without: [Aerie.Bridge.Supervisor, Aerie.Link.Supervisor])
  end

  defp deliver(gateway, frames),
    do: Router.deliver(gateway, %{id: "radio", network: "main", peer: :one}, frames)

  # Waits until everything that was delivered is in the journal: session and event loop answer after what came before.
  defp settle(gateway, key) do
    for role <- [:session, :events], do: :sys.get_state(Names.via(gateway, role, key))
    :ok
  end

  defp alive(gateway, key) do
    eventually(fn -> Names.whereis(gateway, :session, key) && Names.whereis(gateway, :events, key) end)
  end

  defp at(seconds), do: round(seconds * @second)

  test "an autopilot's heartbeat makes a vehicle, which is shown and whose events are in the journal" do
    gateway = gateway()
    PubSub.subscribe(gateway, :events)
    PubSub.subscribe(gateway, {:vehicle, "VID-007"})
    armed = %{@copter | base_mode: 0xD1}
    deliver(gateway, [frame(@copter, at(1), system: 7), frame(armed, at(2), system: 7)])

    assert_receive {:fleet, :events, %{type: "armed", vehicle: "VID-007", seq: 1, time: 2_000_000}}
    assert_receive {:fleet, {:vehicle, "VID-007"}, %{groups: %{mode: %{data: %{armed: true}}}}}

    assert [%{id: "VID-007", status: :online, links: ["radio"], vehicle_type: "copter"}] =
             Store.vehicles(gateway)

    assert [%{type: "armed"}] = Fleet.Journal.pending(gateway)
  end

  test "a ground station's or a gimbal's heartbeat makes none (H2)" do
    gateway = gateway()
    deliver(gateway, [frame(%M.Heartbeat{type: 6, autopilot: 8}, at(1), system: 255, component: 190)])
    deliver(gateway, [frame(%M.Heartbeat{type: 26, autopilot: 8}, at(1), system: 1, component: 154)])
    assert Vehicle.Supervisor.keys(gateway) == []
    assert Store.vehicles(gateway) == []
  end

  test "silence is noticed by the clock, without any frame" do
    gateway = gateway(%{timeouts: %{vehicle_stale_s: 0.1, vehicle_lost_s: 0.3}})
    PubSub.subscribe(gateway, :events)
    deliver(gateway, [frame(@copter, at(1))])
    assert_receive {:fleet, :events, %{type: "link.lost", time: 1_300_000}}
    assert %{status: :lost} = Store.vehicle(gateway, "VID-001")
    deliver(gateway, [frame(@copter, at(100))])
    assert_receive {:fleet, :events, %{type: "link.restored", time: 100_000_000}}
  end

  describe "the machine's clock is set" do
    # What the session counts from its last frame on: no machine is too slow for a time that does not have to be waited for.
    defp pass(gateway, us) do
      :sys.replace_state(Names.via(gateway, :session, {"main", 1}), fn %{clock: {at, since, pace}} = state ->
        %{state | clock: {at, since - us, pace}}
      end)
    end

    # As the session sees it: between two looks the offset of the clocks has changed. Frames come by a live link.
    defp set_clock(gateway, step) do
      :sys.replace_state(Names.via(gateway, :session, {"main", 1}), &%{&1 | host: &1.host - step})
    end

    defp live(gateway, frames) do
      Store.put_link(gateway, "radio", %{id: "radio", kind: :udp_server, network: "main"})
      deliver(gateway, frames)
      settle(gateway, {"main", 1})
    end

    for step <- [-3_600, 3_600] do
      test "by #{step} s: a silent vehicle is lost when it would have been, its age is what it was" do
        step = at(unquote(step))
        gateway = gateway(%{timeouts: %{vehicle_stale_s: 60.0, vehicle_lost_s: 120.0}})
        PubSub.subscribe(gateway, :events)
        heard = System.os_time(:microsecond)
        # The second read is known to be live.
        live(gateway, [frame(@copter, heard - 1_000)])
        live(gateway, [frame(@copter, heard)])
        set_clock(gateway, step)
        # Two clocks are not read in the same microsecond.
        near? = &(abs(&1 - &2) < 20_000)
        eventually(fn -> near?.(Store.vehicle(gateway, "VID-001").last_heard, heard + step) end)
        pass(gateway, at(121))
        assert_receive {:fleet, :events, %{type: "link.lost", time: lost}}
        assert near?.(lost, heard + step + at(120))
        # What comes next comes by the new time.
        live(gateway, [frame(@copter, heard + step + at(122))])
        assert_receive {:fleet, :events, %{type: "link.restored"}}
      end
    end

    test "a recording's time is its own" do
      gateway = gateway()
      link = %{id: "radio", kind: :replay, network: "main", spec: %{speed: 1.0}}
      Store.put_link(gateway, "radio", link)
      deliver(gateway, [frame(@copter, at(1))])
      deliver(gateway, [frame(@copter, at(2))])
      settle(gateway, {"main", 1})
      set_clock(gateway, at(3_600))
      send(Names.whereis(gateway, :session, {"main", 1}), :tick)
      settle(gateway, {"main", 1})
      assert :sys.get_state(Names.via(gateway, :session, {"main", 1})).core.last_heard == at(2)
    end
  end

  test "who is killed while the vehicle is silent still notices that it is lost" do
    gateway = gateway(%{timeouts: %{vehicle_stale_s: 0.1, vehicle_lost_s: 0.3}})
    PubSub.subscribe(gateway, :events)
    deliver(gateway, [frame(@copter, at(1))])
    settle(gateway, {"main", 1})
    Process.exit(Names.whereis(gateway, :session, {"main", 1}), :kill)
    assert_receive {:fleet, :events, %{type: "link.lost"}}
    refute_receive {:fleet, :events, %{type: "link.lost"}}, 300
  end

  describe "killed while three vehicles fly" do
    # One recording flown by three vehicles at once, in reads of 20 frames.
    @keys for system <- 1..3, do: {"main", system}

    defp fly(gateway, recording, between) do
      recording
      |> Enum.chunk_every(20)
      |> Enum.with_index()
      |> Enum.each(fn {read, n} ->
        for {_, system} <- @keys, do: deliver(gateway, Enum.map(read, &%{&1 | system: system}))
        between.(n)
      end)

      Enum.each(@keys, &settle(gateway, &1))
    end

    # The events of each vehicle as far as they do not depend on who it is.
    defp journal(gateway) do
      for n <- 1..3,
          do:
            for(
              e <- Fleet.Journal.pending(gateway),
              e.vehicle == "VID-00#{n}",
              do: {e.seq, e.type, e.time, e.data}
            )
    end

    defp expected(recording), do: for(e <- run(recording).events, do: {e.seq, e.type, e.time, e.data})

    for role <- [:session, :events, :tree] do
      test "#{role}: not an event is lost or doubled, and the others do not notice" do
        gateway = gateway()
        recording = frames("arducopter_mavlink1")
        role = unquote(role)

        fly(gateway, recording, fn
          # A tree that dies more often is given a rest by the keeper.
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

    test "the event loop with a full inbox: everything in it is looked at, once" do
      gateway = gateway()
      recording = frames("arducopter_mavlink1")

      fly(gateway, recording, fn
        n when rem(n, 25) == 10 ->
          key = {"main", 2}

          # Not a moment's rest: what it was about to look at is in the journal, and frames may be in the session's mailbox.
          events = Names.whereis(gateway, :events, key)
          :sys.get_state(Names.via(gateway, :session, key))
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

    test "with frames in its mailbox: those are lost, but what they changed is found, and nothing is doubled" do
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

      events = for e <- Fleet.Journal.pending(gateway), e.vehicle == "VID-002", do: e
      flight = ~w(armed disarmed takeoff landed mode_change)
      names = fn events -> for {type, _ms, data} <- pick(events, flight), do: {type, data["to"]} end
      assert names.(events) == names.(run(recording).events)
      assert Enum.map(events, & &1.seq) == Enum.to_list(1..length(events))
      assert length(Enum.uniq_by(events, & &1.id)) == length(events)
      assert [_, _, _] = journal(gateway)
    end

    test "the keeper gives a tree that dies over and over a rest, and the others go on" do
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

  test "values that cannot be are counted for the vehicle" do
    gateway = gateway()
    deliver(gateway, [frame(@copter, at(1)), frame(%M.HomePosition{latitude: 950_000_000}, at(1.1))])
    settle(gateway, {"main", 1})
    assert Store.counter(gateway, {:vehicle, "VID-001", :invalid}) == 1
  end

  test "a vehicle that is removed starts with nothing" do
    gateway = gateway()
    deliver(gateway, [frame(@copter, at(1))])
    settle(gateway, {"main", 1})
    :ok = Vehicle.Supervisor.remove(gateway, {"main", 1})
    assert Store.vehicle(gateway, "VID-001") == nil
  end
end
