defmodule Aerie.RouterTest do
  use ExUnit.Case, async: true
  use Aerie.VehicleCase

  import :proper_types, only: [list: 1, elements: 1, range: 2]

  alias Aerie.Names
  alias Aerie.Router
  alias Aerie.Mavlink.Heartbeat
  alias Aerie.Router.Routes
  alias Aerie.Router.Sweeper
  alias Aerie.Router.Tables
  alias MavCodec.Frame

  @source %{id: "a", network: "main", peer: :remote}

  setup do
    {:ok, gateway: start_parts()}
  end

  # Frames of bytes, as a parser gives them.
  defp parse(bytes),
    do: bytes |> IO.iodata_to_binary() |> then(&MavCodec.Parser.push(MavCodec.Parser.new(), &1, 5)) |> elem(0)

  defp deliver(gateway, bytes, source \\ @source), do: Router.deliver(gateway, source, parse(bytes))

  describe "deliver" do
    test "one message for each vehicle in a read, in order", c do
      be_session(c.gateway, 1)
      be_session(c.gateway, 2)
      bytes = [attitude(1, 1), attitude(2, 1), attitude(1, 2), attitude(3, 1)]
      assert %{delivered: 3, unclaimed: 1, sessions: sessions} = deliver(c.gateway, bytes)
      assert sessions == [self(), self()]
      assert_received {:frames, "a", [%{system: 1}, %{system: 1}] = frames}
      assert Enum.map(frames, &number/1) == [1, 2]
      assert_received {:frames, "a", [%{system: 2}]}
      refute_received {:frames, _, _}
    end

    test "an autopilot's heartbeat starts its vehicle, and the read is its first (H2, H4)", c do
      assert %{unclaimed: 1} = deliver(c.gateway, attitude(1, 1))
      assert Names.whereis(c.gateway, :session, {"main", 1}) == nil
      assert %{delivered: 2, sessions: [session]} = deliver(c.gateway, [attitude(1, 1), heartbeat(1)])
      assert session == Names.whereis(c.gateway, :session, {"main", 1})
      # A second one changes nothing.
      assert %{delivered: 1, sessions: [^session]} = deliver(c.gateway, heartbeat(1))
    end

    test "texts that came before its first heartbeat are its own; not those of others, not without end", c do
      text = fn system, n ->
        MavCodec.encode(%MavCodec.Messages.Statustext{severity: 6, text: "boot #{n}"},
          system: system,
          component: 1
        )
      end

      for n <- 1..20, do: assert(%{unclaimed: 2} = deliver(c.gateway, [text.(1, n), text.(2, n)]))
      assert %{delivered: 17, sessions: [_session]} = deliver(c.gateway, heartbeat(1))
      assert %{delivered: 1} = deliver(c.gateway, heartbeat(1))
    end

    test "an autopilot may have any component id (R10)", c do
      assert %{delivered: 1} = deliver(c.gateway, heartbeat(1, component: 42))
    end

    test "ground stations, radios and payloads start none and are remembered", c do
      for {system, type, autopilot, role} <- [
            {255, 6, 8, "gcs"},
            {254, 6, 3, "gcs"},
            {51, 18, 8, "onboard_controller"},
            {2, 26, 8, "gimbal"},
            {3, 30, 0, "camera"},
            {4, 2, 8, "component"}
          ] do
        assert %{unclaimed: 1} =
                 deliver(c.gateway, heartbeat(system, type: type, autopilot: autopilot, component: 190))

        assert Names.whereis(c.gateway, :session, {"main", system}) == nil

        assert %{vehicle: false, last_heard: 5, components: %{190 => %{role: ^role, type: ^type, link: "a"}}} =
                 Router.systems(c.gateway)[{"main", system}]
      end
    end

    test "the components of a vehicle are remembered with it", c do
      deliver(c.gateway, [heartbeat(1), heartbeat(1, type: 26, autopilot: 8, component: 154)])
      assert %{vehicle: true, components: components} = Router.systems(c.gateway)[{"main", 1}]
      assert %{1 => %{role: "autopilot"}, 154 => %{role: "gimbal"}} = components
    end

    test "two vehicles of one id on two networks never meet", c do
      be_session(c.gateway, 1, "red")
      assert %{delivered: 1} = deliver(c.gateway, attitude(1, 1), %{@source | network: "red"})
      assert %{unclaimed: 1} = deliver(c.gateway, attitude(1, 1), %{@source | network: "blue"})
      assert Router.way(c.gateway, {"red", 1}) == {"a", :remote}
    end

    test "our own frames that come back are counted and go nowhere" do
      gateway = start_parts(%{mavlink: %{system_id: 245, component_id: 191}})
      be_session(gateway, 245)
      assert %{looped: 1, delivered: 0} = deliver(gateway, heartbeat(245, component: 191))
      assert %{delivered: 1} = deliver(gateway, heartbeat(245, component: 1))
      assert Router.routes(gateway) |> Enum.map(& &1.component) == [1]
    end

    test "vehicles are bounded; a refused one is not tried again for a while" do
      gateway = start_parts(%{limits: %{max_vehicles: 2}})
      assert %{delivered: 2} = deliver(gateway, [heartbeat(1), heartbeat(2)])

      assert %{refused: 3, delivered: 1} =
               deliver(gateway, [heartbeat(3), attitude(3, 1), heartbeat(4), heartbeat(2)])

      assert %{refused: 1} = deliver(gateway, heartbeat(3))
      assert Aerie.Store.counter(gateway, {:vehicles, :refused}) == 2
    end

    test "of many that come at once a few are made at once, the others beside the frames' way; all get their first frames" do
      gateway = start_parts(%{limits: %{max_vehicles: 400}})
      # A link's own frames, of which it loses none meanwhile.
      be_session(gateway, 250)

      outcomes =
        for n <- 0..299 do
          source = %{@source | network: "net #{div(n, 200)}"}
          outcome = deliver(gateway, heartbeat(rem(n, 200) + 1), source)
          assert %{delivered: 1} = deliver(gateway, attitude(250, n))
          outcome
        end

      assert Enum.all?(outcomes, &match?(%{delivered: 1, refused: 0, unclaimed: 0}, &1))
      # Twenty more for each second that this takes.
      assert Enum.count(outcomes, &(&1.sessions != [])) in 32..200
      keys = for n <- 0..299, do: {"net #{div(n, 200)}", rem(n, 200) + 1}

      eventually(fn ->
        Enum.all?(keys, &match?(%{component: 1}, Aerie.Store.vehicle(gateway, &1)))
      end)

      eventually(fn -> :ets.info(Tables.of(gateway).waiting, :size) == 0 end)

      assert Enum.map(frames(300), &number/1) == Enum.to_list(0..299)
    end

    test "who is being made is asked for once, and its further frames wait for it no longer than its heartbeat" do
      gateway = start_parts(%{limits: %{max_vehicles: 400}})
      nursery = Names.whereis(gateway, :router_nursery)
      :sys.suspend(nursery)
      # With frames waiting a link leaves the making to the nursery.
      for n <- 1..65, do: send(self(), {:waiting, n})
      assert %{delivered: 1, sessions: []} = deliver(gateway, heartbeat(1))
      asked = Process.info(nursery, :message_queue_len)
      assert %{unclaimed: 1, delivered: 0} = deliver(gateway, heartbeat(1))
      assert %{unclaimed: 1, delivered: 0} = deliver(gateway, attitude(1, 1))
      assert Process.info(nursery, :message_queue_len) == asked
      :sys.resume(nursery)
      eventually(fn -> Names.whereis(gateway, :session, {"main", 1}) end)
      assert %{delivered: 1} = deliver(gateway, attitude(1, 2))
    end

    test "a link for which frames wait makes no vehicle itself" do
      gateway = start_parts(%{})
      nursery = Names.whereis(gateway, :router_nursery)
      :sys.suspend(nursery)
      for n <- 1..65, do: send(self(), {:waiting, n})
      assert %{delivered: 1, sessions: []} = deliver(gateway, heartbeat(1))
      assert Names.whereis(gateway, :session, {"main", 1}) == nil
      :sys.resume(nursery)
      eventually(fn -> Names.whereis(gateway, :session, {"main", 1}) end)
      for n <- 1..65, do: assert_received({:waiting, ^n})
      deliver(gateway, heartbeat(2))
      assert is_pid(Names.whereis(gateway, :session, {"main", 2}))
    end

    test "the slower vehicles are made, the longer the others are left alone between two" do
      assert Enum.map([0, 2, 5, 10, 20, 5_000], &Router.Nursery.pause/1) == [10, 10, 20, 40, 50, 50]
    end

    test "a session that does not keep up gets no more until it has", c do
      be_session(c.gateway, 1)
      frames = parse(attitude(1, 1))
      tables = Tables.of(c.gateway)
      forget = fn -> :ets.delete_all_objects(tables.load) end
      for _ <- 1..2001, do: Router.deliver(c.gateway, @source, frames)
      forget.()
      assert %{overload: 1, delivered: 0} = Router.deliver(c.gateway, @source, frames)
      frames(1500)
      forget.()
      assert %{overload: 0, delivered: 1} = Router.deliver(c.gateway, @source, frames)
    end

    test "system ids of 32 bits are integers like all others (N3)", c do
      id = 4_000_000_000
      be_session(c.gateway, id)
      frame = %Frame{system: id, component: 1, id: 30, crc_extra: 39, payload: <<1::32-little>>, at: 1}
      assert %{delivered: 1} = Router.deliver(c.gateway, @source, [frame])
      assert Router.way(c.gateway, {"main", id}) == {"a", :remote}
    end

    test "frames of unknown messages are passed on and teach nothing (R4)", c do
      be_session(c.gateway, 1)
      frame = %Frame{system: 1, component: 9, id: 0xABCDEF, payload: <<1>>, crc_extra: nil, at: 1}
      assert %{delivered: 1} = Router.deliver(c.gateway, @source, [frame])
      # Not even when the id is a heartbeat's.
      assert %{unclaimed: 1} =
               Router.deliver(c.gateway, @source, [%{frame | system: 2, id: 0, payload: <<0::32, 2, 3>>}])

      assert Router.routes(c.gateway) == []
    end

    test "without a router nothing breaks" do
      assert %{unclaimed: 1} = deliver(make_ref(), attitude(1, 1))
      assert Router.routes(make_ref()) == []
      assert Router.send(make_ref(), {"main", 1}, "x") == {:error, :no_route}
      assert Router.forget(make_ref(), "a") == :ok
    end
  end

  describe "routes" do
    setup c, do: {:ok, tables: Tables.of(c.gateway)}

    defp learn(c, system, component, link, now),
      do: Routes.learn(c.tables, "main", system, component, {link, 1}, now)

    test "the way heard last, by component where it is heard (R1), else by system (R9)", c do
      learn(c, 1, 1, "a", 10)
      learn(c, 1, 154, "b", 20)
      assert Routes.best(c.tables, {"main", 1}) == {"b", 1}
      assert Routes.best(c.tables, {"main", 1}, component: 1) == {"a", 1}
      # MAV_COMP_ID_LOG is addressed and never talks.
      assert Routes.best(c.tables, {"main", 1}, component: 155) == {"b", 1}
      assert Routes.best(c.tables, {"main", 1}, link: "a") == {"a", 1}
      assert Routes.best(c.tables, {"main", 2}) == nil
      learn(c, 1, 1, "c", 30)
      assert Routes.best(c.tables, {"main", 1}, component: 1) == {"c", 1}
      assert Routes.ways(c.tables, {"main", 1}) == [{"c", 1}, {"b", 1}, {"a", 1}]
      assert Routes.ways(c.tables, {"main", 1}, 1) == [{"c", 1}, {"a", 1}]
    end

    test "have ages, and are swept when old", c do
      learn(c, 1, 1, "a", 0)
      learn(c, 2, 1, "a", 0)
      learn(c, 1, 1, "a", 250_000)

      assert [%{age_ms: 50_000, known_ms: 300_000}, %{age_ms: 300_000}] =
               c.tables |> Routes.list(300_000) |> Enum.sort()

      assert Sweeper.sweep(c.tables, 300_001) == 1
      assert [%{system: 1}] = Routes.list(c.tables, 300_001)
    end

    test "are cleared by system on a reboot (R6), forgotten by link and by peer", c do
      for system <- 1..3, peer <- 1..2, do: Routes.learn(c.tables, "main", system, 1, {"a", peer}, 0)
      :ok = Router.clear(c.gateway, {"main", 1})
      assert c.tables |> Routes.list(0) |> Enum.map(& &1.system) == [2, 2, 3, 3]
      :ok = Router.forget(c.gateway, "a", 2)
      assert c.tables |> Routes.list(0) |> Enum.map(& &1.peer) == [1, 1]
      :ok = Router.forget(c.gateway, "a")
      assert Routes.list(c.tables, 0) == []
    end

    test "are bounded", c do
      for n <- 1..16_384, do: :new = learn(c, n, 1, "a", 0)
      assert learn(c, 20_000, 1, "a", 0) == :full
      assert learn(c, 5, 1, "a", 7) == :ok
    end

    test "the best way is the newest of a plain list", c do
      property =
        :proper.forall(list({range(1, 3), range(0, 2), elements(["a", "b", "c"])}), fn heard ->
          :ets.delete_all_objects(c.tables.routes)

          for {{system, component, link}, n} <- Enum.with_index(heard),
              do: learn(c, system, component, link, n)

          Enum.all?(for(system <- 1..3, component <- 0..3, do: {system, component}), fn {system, component} ->
            of_system = Enum.filter(heard, &(elem(&1, 0) == system))
            of_component = Enum.filter(of_system, &(elem(&1, 1) == component and component != 0))
            expected = List.last(of_component) || List.last(of_system)
            expected = expected && {elem(expected, 2), 1}
            Routes.best(c.tables, {"main", system}, component: component) == expected
          end)
        end)

      assert :proper.quickcheck(property, [:quiet, numtests: 200])
    end
  end

  test "a heartbeat is read as far as it was sent (F7)" do
    assert Heartbeat.read(%Frame{id: 0, payload: <<0::32, 2, 12, 0, 0, 3>>}) == %Heartbeat{
             type: 2,
             autopilot: 12
           }

    assert Heartbeat.read(%Frame{id: 0, payload: <<0::32, 2>>}) == %Heartbeat{type: 2, autopilot: 0}
    assert Heartbeat.read(%Frame{id: 0, payload: <<0>>}) == %Heartbeat{type: 0, autopilot: 0}
    assert Heartbeat.read(%Frame{id: 1, payload: <<0>>}) == nil
  end

  @tag :capture_log
  test "a dead sweeper comes back, and the routes are still there", c do
    deliver(c.gateway, heartbeat(1))
    pid = Names.whereis(c.gateway, :router_sweeper)
    Process.exit(pid, :kill)
    eventually(fn -> Names.whereis(c.gateway, :router_sweeper) not in [nil, pid] end)
    assert Router.way(c.gateway, {"main", 1}) == {"a", :remote}
  end
end
