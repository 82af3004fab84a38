defmodule MavRouter.Router.DeliverTest do
  @moduledoc "What becomes of frames: sessions, routes, and vehicles that are started."
  use ExUnit.Case, async: true
  use Aerie.LinkCase

  alias Aerie.FakeVehicles
  alias Aerie.Base.Names
  alias MavRouter.Router
  alias MavRouter.Tables
  alias MavCodec.Frame

  @origin %{id: "a", network: "main", peer: :remote}

  setup do
    {:ok, gateway: gateway()}
  end

  defp gateway(config \\ %{}, vehicles \\ 400), do: start_parts(config, FakeVehicles.parts(vehicles))

  # Frames of bytes, as a parser gives them.
  defp parse(bytes),
    do: bytes |> IO.iodata_to_binary() |> then(&MavCodec.Parser.push(MavCodec.Parser.new(), &1, 5)) |> elem(0)

  defp deliver(gateway, bytes, origin \\ @origin), do: Aerie.Reader.deliver(gateway, origin, parse(bytes))

  test "each vehicle in a read gets one message, in order", c do
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

  test "an autopilot's heartbeat starts its vehicle, whose first frames are those of the read (H2, H4)", c do
    assert %{unclaimed: 1} = deliver(c.gateway, attitude(1, 1))
    assert Names.whereis(c.gateway, :session, {"main", 1}) == nil
    assert %{delivered: 2, sessions: [session]} = deliver(c.gateway, [attitude(1, 1), heartbeat(1)])
    assert session == Names.whereis(c.gateway, :session, {"main", 1})
    # A second one changes nothing.
    assert %{delivered: 1, sessions: [^session]} = deliver(c.gateway, heartbeat(1))
  end

  test "texts from before its first heartbeat go to the vehicle, a bounded number, and none of other systems",
       c do
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

  test "ground stations, radios and payloads start no vehicle and are remembered", c do
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

  test "two vehicles with one id on two networks never meet", c do
    be_session(c.gateway, 1, "red")
    assert %{delivered: 1} = deliver(c.gateway, attitude(1, 1), %{@origin | network: "red"})
    assert %{unclaimed: 1} = deliver(c.gateway, attitude(1, 1), %{@origin | network: "blue"})
    assert Router.route(c.gateway, {"red", 1}) == {"a", :remote}
  end

  @tag :capture_log
  test "our own frames that come back are counted and go nowhere" do
    gateway = gateway(%{mavlink: %{system_id: 245, component_id: 191}})
    be_session(gateway, 245)
    assert %{looped: 1, delivered: 0} = deliver(gateway, heartbeat(245, component: 191))
    assert %{delivered: 1} = deliver(gateway, heartbeat(245, component: 1))
    assert Router.routes(gateway) |> Enum.map(& &1.component) == [1]
  end

  test "vehicles are bounded, and a refused one is not tried again for a while" do
    gateway = gateway(%{}, 2)
    assert %{delivered: 2} = deliver(gateway, [heartbeat(1), heartbeat(2)])

    assert %{refused: 3, delivered: 1} =
             deliver(gateway, [heartbeat(3), attitude(3, 1), heartbeat(4), heartbeat(2)])

    assert %{refused: 1} = deliver(gateway, heartbeat(3))
  end

  test "of many vehicles that come together a few are started at once, the others by Starter; all get their first frames" do
    gateway = gateway()
    deliver = &deliver(gateway, &1, %{@origin | network: &2})
    keys = many_vehicles(gateway, deliver)

    for key <- keys do
      eventually(fn -> Names.whereis(gateway, :session, key) end)
      assert_receive {:session, ^key, "a", [%{id: 0}]}
    end

    eventually(fn -> :ets.info(Tables.of(gateway).waiting, :size) == 0 end)

    assert Enum.map(frames(300), &number/1) == Enum.to_list(0..299)
  end

  test "a vehicle that is being started is asked for once, and its session gets what came meanwhile, up to a bound" do
    gateway = gateway()
    starter = Names.whereis(gateway, :vehicle_starter)
    :sys.suspend(starter, Aerie.Patience.ms())
    # With frames waiting a link leaves the making to the starter.
    for n <- 1..65, do: send(self(), {:waiting, n})
    assert %{delivered: 1, sessions: []} = deliver(gateway, heartbeat(1))
    assert %{delivered: 1, unclaimed: 0, sessions: []} = deliver(gateway, heartbeat(1))
    for n <- 1..126, do: assert(%{delivered: 1, sessions: []} = deliver(gateway, attitude(1, n)))
    assert %{unclaimed: 1, delivered: 0} = deliver(gateway, attitude(1, 127))
    # Nobody could tell in which order the frames of two links came.
    assert %{unclaimed: 1} = deliver(gateway, attitude(1, 7), %{@origin | id: "b"})
    {:messages, messages} = Process.info(starter, :messages)
    assert Enum.count(messages, &(&1 == :more)) == 1
    :sys.resume(starter, Aerie.Patience.ms())
    assert_receive {:session, {"main", 1}, "a", [%{id: 0}, %{id: 0} | attitudes]}
    assert Enum.map(attitudes, &number/1) == Enum.to_list(1..126)
    assert %{delivered: 1, sessions: [_session]} = deliver(gateway, attitude(1, 128))
    assert_receive {:session, {"main", 1}, {"a", :remote}, [last]}
    assert number(last) == 128
    assert :ets.tab2list(Tables.of(gateway).early) == []
  end

  test "vehicles wait for their start however long it takes, beyond the end of what starts them, and lose nothing" do
    gateway = gateway()
    starter = Names.whereis(gateway, :vehicle_starter)
    :sys.suspend(starter, Aerie.Patience.ms())
    for n <- 1..65, do: send(self(), {:waiting, n})
    for system <- 1..3, do: assert(%{delivered: 1, sessions: []} = deliver(gateway, heartbeat(system)))
    in_an_hour = System.monotonic_time(:millisecond) + 3_600_000
    MavRouter.Router.Sweeper.sweep(Tables.of(gateway), in_an_hour)
    assert %{delivered: 1, unclaimed: 0} = deliver(gateway, attitude(2, 7))
    Process.exit(starter, :kill)

    for system <- [1, 3], do: assert_receive({:session, {"main", ^system}, "a", [%{id: 0}]})
    assert_receive {:session, {"main", 2}, "a", [%{id: 0}, %{id: 30}]}
    assert :ets.tab2list(Tables.of(gateway).early) == []
  end

  test "of a vehicle that is being started the frames are kept, but not what was read with them, nor a long read" do
    gateway = gateway()
    :sys.suspend(Names.whereis(gateway, :vehicle_starter), Aerie.Patience.ms())
    for n <- 1..65, do: send(self(), {:waiting, n})
    assert %{delivered: 1} = deliver(gateway, heartbeat(1))

    frames = for n <- 1..16, do: attitude(1, n)
    assert %{delivered: 16} = deliver(gateway, [frames | :binary.copy(<<0>>, 60_000)])
    assert %{unclaimed: 17} = deliver(gateway, [frames | attitude(1, 17)])

    for {_row, [_, _ | _] = kept} <- :ets.tab2list(Tables.of(gateway).early), frame <- kept do
      assert :binary.referenced_byte_size(frame.bytes) < 300
      assert :binary.referenced_byte_size(frame.payload) < 300
    end
  end

  test "each frame of a vehicle that starts while it sends arrives once, in its order" do
    gateway = gateway()
    for n <- 1..65, do: send(self(), {:waiting, n})

    for system <- 1..100 do
      assert %{delivered: 1, sessions: []} = deliver(gateway, heartbeat(system))
      sent = speak(gateway, system, 1)
      # The heartbeat, and then what it said.
      assert [0 | numbers] = heard(system, sent + 1, [])
      assert numbers == Enum.to_list(1..sent)
    end

    assert :ets.tab2list(Tables.of(gateway).early) == []
    refute_received {:session, _key, _sender, _frames}
  end

  # Until its session is there, and three more times.
  defp speak(gateway, system, n) do
    assert %{delivered: 1, sessions: sessions} = deliver(gateway, attitude(system, n))

    cond do
      sessions != [] ->
        for more <- (n + 1)..(n + 3), do: deliver(gateway, attitude(system, more))
        n + 3

      n > 100 ->
        eventually(fn -> Names.whereis(gateway, :session, {"main", system}) end)
        speak(gateway, system, n + 1)

      true ->
        speak(gateway, system, n + 1)
    end
  end

  defp heard(_system, left, got) when left <= 0, do: got

  defp heard(system, left, got) do
    assert_receive {:session, {"main", ^system}, "a", frames}
    heard(system, left - length(frames), got ++ Enum.map(frames, &if(&1.id == 0, do: 0, else: number(&1))))
  end

  test "what was kept of a vehicle for which there is no room counts as dropped" do
    gateway = gateway(%{}, 0)
    test = self()

    :telemetry.attach(
      {gateway, :dropped},
      [:aerie, :router, :dropped],
      fn _event, %{frames: n}, metadata, _ ->
        if metadata.gateway == gateway, do: send(test, {:dropped, n, metadata})
      end,
      nil
    )

    on_exit(fn -> :telemetry.detach({gateway, :dropped}) end)
    starter = Names.whereis(gateway, :vehicle_starter)
    :sys.suspend(starter, Aerie.Patience.ms())
    for n <- 1..65, do: send(self(), {:waiting, n})
    deliver(gateway, heartbeat(1))
    for n <- 1..4, do: deliver(gateway, attitude(1, n))
    :sys.resume(starter, Aerie.Patience.ms())
    assert_receive {:dropped, 5, %{system: 1, reason: :refused}}
    assert %{unclaimed: 1} = deliver(gateway, attitude(1, 5))
    assert :ets.tab2list(Tables.of(gateway).early) == []
  end

  test "the frames by which a vehicle was found come before those that its session gets as soon as it is there" do
    gateway = gateway()
    starter = Names.whereis(gateway, :vehicle_starter)
    :sys.suspend(starter, Aerie.Patience.ms())
    for n <- 1..65, do: send(self(), {:waiting, n})
    assert %{delivered: 1, sessions: []} = deliver(gateway, heartbeat(1))
    # Another link that hears it, or the starter's own work while it waits for a processor.
    assert {:ok, _session} = Aerie.FakeVehicles.ensure(gateway, {"main", 1})
    assert %{delivered: 1} = deliver(gateway, attitude(1, 1))
    :sys.resume(starter, Aerie.Patience.ms())
    assert_receive {:session, {"main", 1}, "a", [%{id: 30}]}
    assert_received {:session, {"main", 1}, "a", [%{id: 0}]}
    :sys.get_state(starter, Aerie.Patience.ms())
    assert :ets.info(Tables.of(gateway).waiting, :size) == 0
    refute_received {:session, _key, _sender, _frames}
  end

  test "a session gets frames from the moment it has its name, before it says that it has one" do
    gateway = gateway()
    :sys.suspend(Names.whereis(gateway, :vehicle_starter), Aerie.Patience.ms())
    for n <- 1..65, do: send(self(), {:waiting, n})
    assert %{delivered: 1, sessions: []} = deliver(gateway, heartbeat(1))
    assert %{delivered: 1, sessions: []} = deliver(gateway, attitude(1, 1))
    {:ok, session} = Agent.start_link(fn -> nil end, name: Names.via(gateway, :session, {"main", 1}))
    assert %{delivered: 1, sessions: [^session]} = deliver(gateway, attitude(1, 2))
  end

  test "new vehicles of one link cost another link nothing: each has its own allowance" do
    gateway = gateway()
    :sys.suspend(Names.whereis(gateway, :vehicle_starter), Aerie.Patience.ms())
    # However long this takes, some have to wait.
    flood = Stream.map(1..200, &deliver(gateway, heartbeat(&1)))
    assert Enum.any?(flood, &match?(%{delivered: 1, sessions: []}, &1))
    assert %{delivered: 1, sessions: [_session]} = deliver(gateway, heartbeat(201), %{@origin | id: "b"})
  end

  test "a link with many messages in its mailbox starts no vehicle itself" do
    gateway = gateway(%{})
    starter = Names.whereis(gateway, :vehicle_starter)
    :sys.suspend(starter, Aerie.Patience.ms())
    for n <- 1..65, do: send(self(), {:waiting, n})
    assert %{delivered: 1, sessions: []} = deliver(gateway, heartbeat(1))
    assert Names.whereis(gateway, :session, {"main", 1}) == nil
    :sys.resume(starter, Aerie.Patience.ms())
    eventually(fn -> Names.whereis(gateway, :session, {"main", 1}) end)
    for n <- 1..65, do: assert_received({:waiting, ^n})
    deliver(gateway, heartbeat(2))
    assert is_pid(Names.whereis(gateway, :session, {"main", 2}))
  end

  test "the longer the start of a vehicle takes, the longer is the pause before the next" do
    assert Enum.map([0, 2, 5, 10, 20, 5_000], &Router.Starter.pause/1) == [
             10,
             10,
             20,
             40,
             80,
             250
           ]
  end

  test "a session that does not keep up gets no frames until it does", c do
    be_session(c.gateway, 1)
    frames = parse(attitude(1, 1))
    tables = Tables.of(c.gateway)
    forget = fn -> :ets.delete_all_objects(tables.load) end
    for _ <- 1..2001, do: Aerie.Reader.deliver(c.gateway, @origin, frames)
    forget.()
    assert %{overload: 1, delivered: 0} = Aerie.Reader.deliver(c.gateway, @origin, frames)
    frames(1500)
    forget.()
    assert %{overload: 0, delivered: 1} = Aerie.Reader.deliver(c.gateway, @origin, frames)
  end

  test "system ids may have 32 bits (N3)", c do
    id = 4_000_000_000
    be_session(c.gateway, id)
    frame = %Frame{system: id, component: 1, id: 30, crc_extra: 39, payload: <<1::32-little>>, at: 1}
    assert %{delivered: 1} = Aerie.Reader.deliver(c.gateway, @origin, [frame])
    assert Router.route(c.gateway, {"main", id}) == {"a", :remote}
  end

  test "frames with an unknown message id go to the session and teach no route (R4)", c do
    be_session(c.gateway, 1)
    frame = %Frame{system: 1, component: 9, id: 0xABCDEF, payload: <<1>>, crc_extra: nil, at: 1}
    assert %{delivered: 1} = Aerie.Reader.deliver(c.gateway, @origin, [frame])
    # Not even when the id is a heartbeat's.
    assert %{unclaimed: 1} =
             Aerie.Reader.deliver(c.gateway, @origin, [%{frame | system: 2, id: 0, payload: <<0::32, 2, 3>>}])

    assert Router.routes(c.gateway) == []
  end

  test "without a router nothing breaks" do
    assert %{unclaimed: 1} = deliver(make_ref(), attitude(1, 1))
    assert Router.routes(make_ref()) == []
    assert Router.send(make_ref(), {"main", 1}, "x") == {:error, :no_route}
    assert Router.forget(make_ref(), "a") == :ok
  end

  @tag :capture_log
  test "a dead sweeper comes back, and the routes are still there", c do
    deliver(c.gateway, heartbeat(1))
    pid = Names.whereis(c.gateway, :router_sweeper)
    Process.exit(pid, :kill)
    eventually(fn -> Names.whereis(c.gateway, :router_sweeper) not in [nil, pid] end)
    assert Router.route(c.gateway, {"main", 1}) == {"a", :remote}
  end
end
