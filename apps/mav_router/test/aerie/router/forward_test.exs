defmodule Aerie.Router.ForwardTest do
  use ExUnit.Case, async: true
  use Aerie.LinkCase

  alias Aerie.Store
  alias Aerie.Router
  alias Aerie.Router.Endpoint
  alias MavCodec.Messages

  setup do
    {:ok, gateway: start_parts(%{mavlink: %{system_id: 245, component_id: 191}})}
  end

  # A process that is an endpoint and tells the test what comes: `{name, bytes, class}`.
  defp endpoint(gateway, name, options) do
    test = self()

    pid =
      start_supervised!(
        {Task,
         fn ->
           {:ok, endpoint} = Endpoint.attach(gateway, [id: name] ++ options)
           send(test, {:attached, name, endpoint})
           relay(test, name, endpoint)
         end},
        id: name
      )

    assert_receive {:attached, ^name, endpoint}
    %{pid: pid, name: name, endpoint: endpoint}
  end

  defp relay(test, name, endpoint) do
    receive do
      {:forward, bytes, class} ->
        Endpoint.taken(endpoint, length(bytes))
        for one <- bytes, do: send(test, {name, one, class})
        relay(test, name, endpoint)

      {:ingress, bytes} ->
        {frames, _} =
          MavCodec.Parser.push_datagram(MavCodec.Parser.new(), bytes, System.os_time(:microsecond))

        outcome = Endpoint.ingress(endpoint, frames)
        send(test, {:done, name, outcome})
        relay(test, name, endpoint)
    end
  end

  # Says bytes by an endpoint; afterwards everything that goes anywhere is on its way.
  defp say(endpoint, bytes) do
    name = endpoint.name
    send(endpoint.pid, {:ingress, IO.iodata_to_binary(bytes)})
    assert_receive {:done, ^name, outcome}
    outcome
  end

  defp message(struct, system, component, options \\ []),
    do: MavCodec.encode(struct, [system: system, component: component] ++ options)

  # What has come to the endpoints, each asked in turn so that nothing is on its way any more.
  defp got(endpoints) do
    Map.new(List.wrap(endpoints), fn %{name: name} = endpoint ->
      say(endpoint, [])
      {name, drain(name)}
    end)
  end

  defp drain(name) do
    receive do
      {^name, bytes, _class} -> [bytes | drain(name)]
    after
      0 -> []
    end
  end

  defp vehicle(gateway, name, system, options \\ []) do
    endpoint = endpoint(gateway, name, [side: :vehicle] ++ options)
    say(endpoint, heartbeat(system))
    endpoint
  end

  defp client(gateway, name, system, options \\ []) do
    endpoint = endpoint(gateway, name, options)
    say(endpoint, gcs(system))
    endpoint
  end

  defp gcs(system), do: heartbeat(system, type: 6, autopilot: 8, component: 190)

  defp command(target, component \\ 1, id \\ 400),
    do: %Messages.CommandLong{target_system: target, target_component: component, command: id}

  defp counted(gateway, name), do: Enum.find(Router.endpoints(gateway), &(&1.id == {name, :self}))

  test "what an endpoint says after its end goes nowhere and makes no vehicle", c do
    gone = endpoint(c.gateway, "gone", [])
    :ok = Endpoint.detach(gone.endpoint)
    # Like a vehicle's heartbeat, which a client may well send (a simulator behind it).
    assert %{unclaimed: 1, delivered: 0} = say(gone, heartbeat(9))
    assert Router.systems(c.gateway) == %{}
    assert Store.vehicles(c.gateway) == []
  end

  describe "rules" do
    setup c do
      v1 = vehicle(c.gateway, "v1", 1)
      v2 = vehicle(c.gateway, "v2", 2)
      g1 = client(c.gateway, "g1", 255)
      g2 = client(c.gateway, "g2", 254)
      all = [v1, v2, g1, g2]
      got(all)
      {:ok, v1: v1, v2: v2, g1: g1, g2: g2, all: all}
    end

    test "R1, R2: nobody addressed, or all: to everyone but the sender, as the bytes it was (R3)", c do
      bytes = attitude(1, 7)
      say(c.v1, bytes)
      assert got(c.all) == %{"v1" => [], "v2" => [bytes], "g1" => [bytes], "g2" => [bytes]}
      to_all = message(command(0, 0), 255, 190)
      say(c.g1, to_all)
      assert got(c.all) == %{"v1" => [to_all], "v2" => [to_all], "g1" => [], "g2" => [to_all]}
    end

    test "R1: a system that is addressed gets it, and nobody else", c do
      order = message(command(2), 255, 190)
      say(c.g1, order)
      assert got(c.all) == %{"v1" => [], "v2" => [order], "g1" => [], "g2" => []}
      answer = message(%Messages.CommandAck{command: 400, target_system: 255, target_component: 190}, 2, 1)
      say(c.v2, answer)
      assert got(c.all) == %{"v1" => [], "v2" => [], "g1" => [answer], "g2" => []}
    end

    test "R2: an unknown addressee's frame goes nowhere, and is counted", c do
      say(c.g1, message(command(77), 255, 190))
      assert got(c.all) |> Map.values() |> Enum.concat() == []
      assert counted(c.gateway, "g1").counters.no_route == 1
    end

    test "R2: the addressee behind the sender itself is no way either", c do
      say(c.v1, heartbeat(1, type: 26, autopilot: 8, component: 154))
      got(c.all)
      say(c.v1, message(command(1, 154), 1, 1))
      assert got(c.all) |> Map.values() |> Enum.concat() == []
    end

    test "R1: a component that is addressed gets it where it is; R9: one that never talks, where its system is",
         c do
      camera = endpoint(c.gateway, "camera", side: :vehicle)
      say(camera, heartbeat(1, type: 30, autopilot: 8, component: 100))
      got([camera | c.all])
      shoot = message(command(1, 100), 255, 190)
      say(c.g1, shoot)
      assert %{"camera" => [^shoot], "v1" => []} = got([camera | c.all])
      log = message(command(1, 155), 255, 190)
      say(c.g1, log)
      assert %{"camera" => [^log], "v1" => [^log]} = got([camera | c.all])
    end

    test "R4: an unknown message goes to everyone", c do
      unknown = <<0xFD, 3, 0, 0, 1, 1, 1, 0xABCDEF::24-little, 1, 1, 5, 9, 9>>
      say(c.v1, unknown)
      assert got(c.all) == %{"v1" => [], "v2" => [unknown], "g1" => [unknown], "g2" => [unknown]}
    end

    test "F10: an addressee that was cut off is all", c do
      # Every byte of it is zero, so that only one is sent.
      cut = message(%Messages.ParamRequestList{}, 255, 190)
      assert <<0xFD, 1, _::binary>> = cut
      say(c.g1, cut)
      assert %{"v1" => [^cut], "v2" => [^cut], "g2" => [^cut]} = got(c.all)
    end

    test "S8: SETUP_SIGNING goes nowhere, not even to a sniffer", c do
      sniffer = endpoint(c.gateway, "sniffer", sniffer: true)
      say(c.g1, message(%Messages.SetupSigning{target_system: 1, target_component: 1}, 255, 190))
      assert got([sniffer | c.all]) |> Map.values() |> Enum.concat() == []
      assert counted(c.gateway, "g1").counters.secret == 1
    end

    test "S10: a signed frame is forwarded as it is, right or wrong", c do
      signing = MavCodec.Signing.new(:binary.copy(<<7>>, 32), link_id: 3)

      {signed, _signing} =
        MavCodec.Signing.encode(signing, %Messages.Attitude{roll: 0.5}, system: 1, component: 1)

      forged = binary_part(signed, 0, byte_size(signed) - 1) <> <<0>>

      for bytes <- [signed, forged] do
        say(c.v1, bytes)
        assert %{"g1" => [^bytes]} = got(c.all)
      end
    end

    test "a sniffer gets what is addressed to others as well", c do
      sniffer = endpoint(c.gateway, "sniffer", sniffer: true)
      order = message(command(2), 255, 190)
      say(c.g1, order)
      assert %{"sniffer" => [^order], "v1" => [], "v2" => [^order]} = got([sniffer | c.all])
    end

    test "our own frames that come back go nowhere", c do
      assert %{looped: 1} = say(c.g1, heartbeat(245, component: 191, type: 18, autopilot: 8))
      assert got(c.all) |> Map.values() |> Enum.concat() == []
    end

    test "R5: what is for us has arrived: it goes no further, and nobody is missing", c do
      say(c.g1, message(command(245, 191), 255, 190))
      assert got(c.all) |> Map.values() |> Enum.concat() == []
      assert counted(c.gateway, "g1").counters.no_route == 0
      # Another part of our system is somebody else.
      say(c.g1, message(command(245, 7), 255, 190))
      assert counted(c.gateway, "g1").counters.no_route == 1
    end

    test "what an autopilot orders itself is no order for others (PX4: to 1/0 and 0/0, four times)", c do
      for _ <- 1..4, target <- [0, 1], do: say(c.v1, message(command(target, 0, 20), 1, 1))
      assert got(c.all) |> Map.values() |> Enum.concat() == []
      # Its own camera elsewhere gets it.
      camera = endpoint(c.gateway, "camera", side: :vehicle)
      say(camera, heartbeat(1, type: 30, autopilot: 8, component: 100))
      got([camera | c.all])
      own = message(command(0, 0, 1000), 1, 1)
      say(c.v1, own)
      assert %{"camera" => [^own], "v2" => [], "g1" => []} = got([camera | c.all])
    end

    test "who may only read is not heard", c do
      reader = client(c.gateway, "reader", 200, role: :read_only)
      say(reader, message(command(1), 200, 190))
      assert %{"v1" => [], "g1" => []} = got(c.all)
      assert counted(c.gateway, "reader").counters.read_only == 2
      bytes = attitude(1, 1)
      say(c.v1, bytes)
      assert %{"reader" => [^bytes]} = got(reader)
    end

    test "an endpoint that is gone is forgotten with its routes", c do
      Process.exit(c.g1.pid, :kill)
      # First the endpoint goes, then its routes.
      eventually(fn -> Router.way(c.gateway, {"main", 255}) == nil end)
      assert counted(c.gateway, "g1") == nil
      say(c.v1, attitude(1, 1))
      assert %{"g2" => [_]} = got(c.g2)
    end

    test "order is kept between what is for all and what is for one", c do
      ack = message(%Messages.CommandAck{command: 400, target_system: 255, target_component: 190}, 1, 1)
      all = [attitude(1, 1), attitude(1, 2), ack, attitude(1, 3)]
      say(c.v1, all)
      assert %{"g1" => ^all} = got(c.all)
    end

    test "R6: a boot time that began anew clears the system's routes", c do
      time = fn ms ->
        message(%Messages.SystemTime{time_boot_ms: ms, time_unix_usec: 1_000_000_000_000_000}, 1, 1)
      end

      other = endpoint(c.gateway, "old", side: :vehicle)
      say(other, heartbeat(1, component: 77, type: 30, autopilot: 8))

      # The clock is sure after three readings over a second; all of them by one process, as those of a link are.
      at = fn ms, us -> Enum.map(parse(time.(ms)), &%{&1 | at: us}) end
      deliver(c.gateway, "v1", at.(500_000, 0))
      assert Enum.any?(Router.routes(c.gateway), &(&1.link == "old"))
      for n <- 0..4, do: deliver(c.gateway, "v1", at.(1_000 + n * 500, n * 500_000))
      refute Enum.any?(Router.routes(c.gateway), &(&1.link == "old"))
    end
  end

  describe "between vehicles" do
    test "a large network's vehicles hear heartbeats of each other, and all that is for them", c do
      all = for n <- 1..10, do: vehicle(c.gateway, "v#{n}", n)
      g = client(c.gateway, "g", 255)
      got([g | all])
      [v1 | others] = all
      beat = heartbeat(1, seq: 9)
      say(v1, [attitude(1, 1), beat, attitude(1, 2)])
      first = attitude(1, 1)
      last = attitude(1, 2)
      got = got([g | all])
      assert got["g"] == [first, beat, last]
      for %{name: name} <- others, do: assert(got[name] == [beat])
      order = message(command(7), 1, 1)
      say(v1, order)
      assert %{"v7" => [^order], "v6" => []} = got(all)
      # A part of the vehicle itself that is reached by another way gets everything.
      camera = endpoint(c.gateway, "camera", side: :vehicle)
      say(camera, heartbeat(1, type: 30, autopilot: 8, component: 100))
      got([camera | all])
      say(v1, first)
      assert %{"camera" => [^first]} = got(camera)
    end

    test "a crowd hears nothing of each other, and a vehicle that comes to it costs the others no look", c do
      all = for n <- 1..40, do: vehicle(c.gateway, "v#{n}", n)
      g = client(c.gateway, "g", 255)
      got([g | all])
      [v1 | others] = all
      beat = heartbeat(1, seq: 9)
      say(v1, [attitude(1, 1), beat])
      got = got([g | all])
      assert got["g"] == [attitude(1, 1), beat]
      for %{name: name} <- others, do: assert(got[name] == [])
      # Its own other parts hear it, by whichever way they are reached.
      part = endpoint(c.gateway, "part", side: :vehicle)
      say(part, heartbeat(1, component: 2))
      got([part | all])
      say(v1, attitude(1, 2))
      assert %{"part" => [_]} = got(part)
    end

    test "heartbeats that come faster than anybody needs them reach other vehicles at a bounded rate", c do
      all = for n <- 1..10, do: vehicle(c.gateway, "v#{n}", n)
      g = client(c.gateway, "g", 255)
      got([g | all])
      say(hd(all), for(n <- 1..100, do: heartbeat(1, seq: n)))
      got = got([g | all])
      assert length(got["g"]) == 100
      for %{name: name} <- tl(all), do: assert(length(got[name]) in 1..4)
    end

    test "as configured" do
      for {between, expected} <- [all: 2, heartbeats: 1, none: 0] do
        gateway = start_parts(%{router: %{between_vehicles: between}})
        v1 = vehicle(gateway, "#{between} 1", 1)
        v2 = vehicle(gateway, "#{between} 2", 2)
        got([v1, v2])
        say(v1, [attitude(1, 1), heartbeat(1, seq: 9)])
        assert length(got(v2)[v2.name]) == expected
      end
    end
  end

  describe "senders on a link to vehicles that are none" do
    # Peers of one link, all written to by one process.
    defp peers(gateway, names, since \\ 0) do
      tables = Router.Tables.of(gateway)
      {:ok, owner} = Router.Owner.new("port", side: :vehicle, networks: ["main"])
      Router.Endpoints.put_owner(tables, owner)

      for name <- names do
        fields = [
          since: since,
          out: {:pid, self(), name},
          kind: :link,
          listens: Router.Endpoints.listens?(tables, owner, :unknown)
        ]

        Router.Endpoints.put(gateway, tables, Endpoint.new(gateway, {"port", name}, fields))
      end
    end

    defp heard_by do
      receive do
        {:forward, name, bytes, _class} -> [{name, length(bytes)} | heard_by()]
      after
        0 -> []
      end
    end

    defp by_port(gateway, peer, bytes) do
      Router.deliver(gateway, %{id: "port", network: "main", peer: peer}, parse(bytes))
    end

    test "of a link 8 that nobody knows hear what others broadcast, 32 that said who they are; vehicles need no place",
         c do
      peers(c.gateway, 1..100)
      v = vehicle(c.gateway, "v", 1)
      heard_by()
      say(v, attitude(1, 1))
      assert length(heard_by()) == 8

      for n <- 1..10, do: by_port(c.gateway, n, heartbeat(100 + n))
      for n <- 40..100, do: by_port(c.gateway, n, heartbeat(255, type: 6, autopilot: 8))
      heard_by()
      say(v, attitude(1, 2))
      assert length(heard_by()) == 32
    end

    test "a frame costs the same beside five hundred vehicles as beside forty, a heartbeat too" do
      work = fn count ->
        gateway = start_parts()
        peers(gateway, 1..count)
        tables = Router.Tables.of(gateway)
        for n <- 1..count, do: Router.Endpoints.note(tables, {"port", n}, heard_vehicle: true)

        frames =
          for n <- 1..50, bytes <- [attitude(1, n), heartbeat(1, type: 2, autopilot: 3)], do: parse(bytes)

        source = %{id: "port", network: "main", peer: 1}
        for one <- frames, do: Router.deliver(gateway, source, one)
        {:reductions, before} = Process.info(self(), :reductions)
        for one <- frames, do: Router.deliver(gateway, source, one)
        {:reductions, later} = Process.info(self(), :reductions)
        div(later - before, length(frames))
      end

      few = work.(40)
      assert few < 2_000
      assert work.(500) < 1.5 * few + 50
    end

    test "who has just come gets a place among the first 8 only, and its heartbeat goes to no vehicle", c do
      peers(c.gateway, 1..100, System.os_time(:microsecond) + 60_000_000)
      for n <- 1..40, do: by_port(c.gateway, n, heartbeat(100 + n))
      for n <- 41..100, do: by_port(c.gateway, n, heartbeat(255, type: 6, autopilot: 8))
      heard_by()
      for n <- 61..100, do: by_port(c.gateway, n, heartbeat(254, type: 6, autopilot: 8))
      assert length(heard_by()) <= 40 * 8
      v = vehicle(c.gateway, "v", 1)
      heard_by()
      say(v, attitude(1, 1))
      assert length(heard_by()) <= 8
    end

    test "what they say is not multiplied by the number of vehicles", c do
      peers(c.gateway, 1..100)
      for n <- 1..50, do: by_port(c.gateway, n, heartbeat(100 + n))
      heard_by()
      by_port(c.gateway, 100, attitude(9, 1))
      assert Enum.all?(heard_by(), fn {peer, 1} -> peer > 50 end)
    end
  end

  describe "another router that hears us twice" do
    setup c do
      v = vehicle(c.gateway, "v", 1)
      x = endpoint(c.gateway, "x", [])
      y = endpoint(c.gateway, "y", [])
      g = client(c.gateway, "g", 255)
      got([v, x, y, g])
      {:ok, v: v, x: x, y: y, g: g}
    end

    # What goes out by the one comes in by the other, until nothing does any more; how often.
    defp around(c, n \\ 0) do
      case got([c.x, c.y]) do
        %{"x" => [], "y" => []} ->
          n

        %{"x" => by_x, "y" => by_y} when n < 100 ->
          say(c.y, by_x)
          say(c.x, by_y)
          around(c, n + 1)

        _forever ->
          :forever
      end
    end

    test "a frame that goes round since before that was found out dies, later ones do not go round", c do
      say(c.v, attitude(1, 1))
      assert around(c) in 1..20
      got(c.g)
      say(c.v, [attitude(1, 2), attitude(1, 3)])
      assert around(c) == 1
      expected = [attitude(1, 2), attitude(1, 3)]
      assert %{"g" => ^expected} = got(c.g)
      # What is for the vehicle reaches it once.
      order = message(command(1), 255, 190)
      say(c.g, order)
      around(c)
      assert %{"v" => [^order]} = got(c.v)
      say(c.g, gcs(255))
      assert around(c) in 1..20
      say(c.g, heartbeat(255, type: 6, autopilot: 8, component: 190, seq: 9))
      assert around(c) == 1
    end
  end

  describe "redundant links" do
    setup c do
      a = endpoint(c.gateway, "a", side: :vehicle, group: "mast")
      b = endpoint(c.gateway, "b", side: :vehicle, group: "mast")
      g = client(c.gateway, "g", 255)
      for e <- [a, b], do: say(e, heartbeat(1))
      got([a, b, g])
      {:ok, a: a, b: b, g: g, all: [a, b, g]}
    end

    test "what both bring goes on once, whichever was first, and never from one to the other", c do
      for n <- 1..20 do
        {first, second} = if rem(n, 2) == 0, do: {c.a, c.b}, else: {c.b, c.a}
        for e <- [first, second], do: say(e, attitude(1, n))
      end

      expected = for n <- 1..20, do: attitude(1, n)
      assert got(c.all) == %{"a" => [], "b" => [], "g" => expected}
      counts = for name <- ["a", "b"], do: counted(c.gateway, name).counters.duplicates
      assert Enum.sum(counts) >= 20
    end

    test "what goes to their vehicle goes by one of them; the better one; by class where that is said", c do
      order = message(command(1), 255, 190)
      say(c.g, order)
      assert %{"a" => [^order], "b" => []} = got(c.all)
      tables = Router.Tables.of(c.gateway)
      :ets.insert(tables.scores, {{:pick, "mast"}, "b"})
      say(c.g, order)
      assert %{"a" => [], "b" => [^order]} = got(c.all)
      beat = gcs(255)
      say(c.g, beat)
      assert %{"a" => [], "b" => [^beat]} = got(c.all)

      # Commands twice (R8: receivers live with that), files by the other one.
      for name <- ["a", "b"],
          do: :ok = Router.configure(c.gateway, name, carry: %{"control" => "all", "bulk" => "a"})

      file = message(%Messages.LogRequestData{target_system: 1, target_component: 1, count: 5}, 255, 190)
      say(c.g, [order, file])
      assert %{"a" => [^order, ^file], "b" => [^order]} = got(c.all)
    end

    test "links that are not said to be redundant are found out: nothing twice, nothing back to its vehicle",
         c do
      x = endpoint(c.gateway, "x", side: :vehicle)
      y = endpoint(c.gateway, "y", side: :vehicle)
      for e <- [x, y], do: say(e, heartbeat(5))
      got([x, y | c.all])

      for n <- 1..5, e <- [x, y], do: say(e, attitude(5, n))
      expected = for n <- 1..5, do: attitude(5, n)
      assert %{"g" => ^expected, "x" => [], "y" => []} = got([x, y | c.all])
      # A frame that it addresses to itself does not reach it by its other radio.
      say(x, message(command(5, 1, 20), 5, 1))
      assert %{"x" => [], "y" => [], "g" => []} = got([x, y | c.all])
    end

    test "the meter takes the link that is heard better, and says so", c do
      ref = make_ref()
      test = self()
      gateway = c.gateway

      :telemetry.attach(
        ref,
        [:aerie, :router, :carrier],
        fn _, _, m, _ -> m.gateway == gateway && send(test, {:carrier, m.link}) end,
        nil
      )

      on_exit(fn -> :telemetry.detach(ref) end)
      :ok = :sys.suspend(Aerie.Names.whereis(gateway, :router_meter))
      tables = Router.Tables.of(gateway)
      state = %{gateway: gateway, at: nil, tallies: %{}, sequences: %{}, losses: %{}, choices: %{}}

      put = fn id, received, lost ->
        sources = %{{1, 1} => %{received: received, lost: lost}}

        Aerie.Store.put_link(gateway, id, %{
          id: id,
          status: :up,
          sources: sources,
          last_heard: System.os_time(:microsecond)
        })
      end

      for id <- ["a", "b"], do: put.(id, 100, 0)
      state = Router.Meter.measure(state, tables, 0)
      assert_received {:carrier, "a"}
      put.("a", 150, 50)
      put.("b", 200, 0)
      state = Router.Meter.measure(state, tables, 1_000)
      assert_received {:carrier, "b"}
      :ok = Router.Meter.note_rtt(gateway, "a", 20)
      put.("a", 250, 50)
      Router.Meter.measure(state, tables, 2_000)
      refute_received {:carrier, _}
      assert Router.way(gateway, {"main", 1}) != nil
    end
  end

  describe "networks" do
    setup c do
      red = vehicle(c.gateway, "red", 1, networks: ["red"])
      blue = vehicle(c.gateway, "blue", 1, networks: ["blue"])
      two = vehicle(c.gateway, "two", 2, networks: ["blue"])
      {:ok, red: red, blue: blue, two: two, all: [red, blue, two]}
    end

    test "do not meet: same ids, other vehicles", c do
      r = client(c.gateway, "r", 255, networks: ["red"])
      b = client(c.gateway, "b", 255, networks: ["blue"])
      all = [r, b | c.all]
      got(all)
      say(c.red, attitude(1, 1))
      first = attitude(1, 1)
      assert %{"r" => [^first], "b" => [], "blue" => [], "two" => []} = got(all)
      order = message(command(1), 255, 190)
      say(b, order)
      assert %{"blue" => [^order], "red" => [], "r" => []} = got(all)
    end

    test "who sees several sees one system of an id, of the network that is named first, and is told which not",
         c do
      g = client(c.gateway, "g", 255, networks: ["red", "blue"])
      all = [g | c.all]
      got(all)
      first = attitude(1, 1)
      other = attitude(2, 1)
      say(c.red, first)
      say(c.blue, attitude(1, 2))
      say(c.two, other)
      assert %{"g" => [^first, ^other]} = got(all)
      assert %{hidden: [{"blue", 1}]} = counted(c.gateway, "g")
      orders = for id <- [1, 2], do: message(command(id), 255, 190)
      say(g, orders)
      [one, two] = orders
      assert %{"red" => [^one], "blue" => [], "two" => [^two]} = got(all)
      answer = message(%Messages.CommandAck{command: 400, target_system: 255, target_component: 190}, 2, 1)
      say(c.two, answer)
      assert %{"g" => [^answer]} = got(g)
    end

    test "who names none sees all, those too that come later; a later one hides nothing", c do
      g = client(c.gateway, "g", 255)
      assert %{networks: ["main", "red", "blue"]} = counted(c.gateway, "g")
      # By name it would come before the others.
      late = [
        vehicle(c.gateway, "late", 1, networks: ["amber"]),
        vehicle(c.gateway, "three", 3, networks: ["amber"])
      ]

      all = [g | late] ++ c.all
      assert %{networks: ["main", "red", "blue", "amber"], hidden: hidden} = counted(c.gateway, "g")
      assert Enum.sort(hidden) == [{"amber", 1}, {"blue", 1}]
      got(all)
      [red, three] = for id <- [1, 3], do: attitude(id, 1)
      say(c.red, red)
      say(hd(late), attitude(1, 2))
      say(List.last(late), three)
      assert %{"g" => [^red, ^three]} = got(all)

      # Both ways, although it said nothing since.
      order = message(command(3), 255, 190)
      say(g, order)
      answer = message(%Messages.CommandAck{command: 400, target_system: 255, target_component: 190}, 3, 1)
      say(List.last(late), answer)
      assert %{"g" => [^answer], "three" => [^order], "late" => []} = got(all)

      for endpoint <- late, do: stop_supervised!(endpoint.name)
      eventually(fn -> counted(c.gateway, "g").networks == ["main", "red", "blue"] end)
    end
  end

  describe "a client that sees the ids of a network with a number added" do
    setup c do
      red = vehicle(c.gateway, "red", 1, networks: ["red"])
      blue = vehicle(c.gateway, "blue", 1, networks: ["blue"])
      offsets = %{"blue" => 10}
      g = client(c.gateway, "g", 255, networks: ["red", "blue"], id_offsets: offsets)
      plain = client(c.gateway, "plain", 254, networks: ["blue"])
      all = [red, blue, g, plain]
      got(all)
      {:ok, red: red, blue: blue, g: g, plain: plain, all: all}
    end

    test "sees both vehicles of one id; others see what was said (R3)", c do
      mine = attitude(1, 1)
      theirs = attitude(1, 2)
      say(c.red, mine)
      say(c.blue, theirs)

      shown =
        MavCodec.encode(%Messages.Attitude{time_boot_ms: 2, roll: 0.5, yaw: 1.0},
          system: 11,
          component: 1,
          seq: 2
        )

      assert %{"g" => [^mine, ^shown], "plain" => [^theirs], "red" => [], "blue" => []} = got(c.all)
      assert %{hidden: [], id_offsets: %{"blue" => 10}} = counted(c.gateway, "g")
    end

    test "reaches the one that it means, by that one's own id, and its answer comes under the other", c do
      say(c.g, message(command(11), 255, 190))
      order = message(command(1), 255, 190)
      assert %{"blue" => [^order], "red" => []} = got(c.all)
      say(c.g, order)
      assert %{"blue" => [], "red" => [^order]} = got(c.all)
      ack = %Messages.CommandAck{command: 400, target_system: 255, target_component: 190}
      say(c.blue, message(ack, 1, 1))
      shown = message(ack, 11, 1)
      assert %{"g" => [^shown], "plain" => []} = got(c.all)
      # Nobody is meant by it.
      say(c.g, message(command(12), 255, 190))
      assert got(c.all) |> Map.values() |> Enum.concat() == []
      assert counted(c.gateway, "g").counters.no_route == 1
      # What is for all is for all.
      everyone = message(command(0, 0), 255, 190)
      say(c.g, everyone)
      assert %{"blue" => [^everyone], "red" => [^everyone]} = got(c.all)
    end

    test "what is signed is not changed but refused, and counted; of another network it passes (S10)", c do
      signing = MavCodec.Signing.new(:binary.copy(<<7>>, 32), link_id: 3)
      {signed, _} = MavCodec.Signing.encode(signing, %Messages.Attitude{roll: 0.5}, system: 1, component: 1)
      say(c.blue, signed)
      assert %{"g" => [], "plain" => [^signed]} = got(c.all)
      assert counted(c.gateway, "g").counters.refused == 1
      say(c.red, signed)
      assert %{"g" => [^signed]} = got(c.all)
      {order, _} = MavCodec.Signing.encode(signing, command(11), system: 255, component: 190)
      say(c.g, order)
      assert %{"blue" => [], "red" => []} = got(c.all)
      assert counted(c.gateway, "g").counters.refused == 2
    end

    test "filters and rate limits go by the ids that it sees; two of one id have their rates each", c do
      :ok =
        Router.configure(c.gateway, "g",
          rate_limits: %{"ATTITUDE" => 0.001},
          filter_out: %{block_systems: [12]}
        )

      for n <- 1..3, e <- [c.red, c.blue], do: say(e, attitude(1, n))
      assert %{"g" => [_, _]} = got(c.g)
      two = vehicle(c.gateway, "two", 2, networks: ["blue"])
      say(two, attitude(2, 1))
      assert %{"g" => []} = got(c.g)
    end

    test "can be changed while it runs; an id that two networks have is hidden still", c do
      :ok = Router.configure(c.gateway, "g", id_offsets: nil)
      assert %{hidden: [{"blue", 1}], id_offsets: %{}} = counted(c.gateway, "g")
      say(c.blue, attitude(1, 1))
      assert %{"g" => []} = got(c.g)
      eleven = vehicle(c.gateway, "eleven", 11, networks: ["red"])
      :ok = Router.configure(c.gateway, "g", id_offsets: %{"blue" => 10})
      assert %{hidden: [{"blue", 1}]} = counted(c.gateway, "g")
      got([eleven | c.all])
      say(c.blue, attitude(1, 2))
      assert %{"g" => []} = got(c.g)
      assert {:error, _} = Router.configure(c.gateway, "g", id_offsets: %{"blue" => 300})
    end
  end

  describe "another vehicle with the id of one that was there before" do
    setup c do
      first = vehicle(c.gateway, "first", 1)
      other = vehicle(c.gateway, "other", 1)
      g = client(c.gateway, "g", 255)
      sniffer = endpoint(c.gateway, "sniffer", sniffer: true)
      all = [first, other, g, sniffer]
      got(all)
      :ok = Router.Apart.put(c.gateway, {"main", 1}, [{"other", :self}])
      {:ok, first: first, other: other, g: g, sniffer: sniffer, all: all}
    end

    test "goes to nobody but sniffers, and gets no orders", c do
      mine = attitude(1, 1)
      theirs = attitude(1, 2)
      say(c.first, mine)
      say(c.other, theirs)
      answer = message(%Messages.CommandAck{command: 400, target_system: 255, target_component: 190}, 1, 1)
      say(c.other, answer)
      order = message(command(1), 255, 190)
      say(c.g, order)
      got = got(c.all)

      assert %{
               "first" => [^order],
               "other" => [],
               "g" => [^mine],
               "sniffer" => [^mine, ^theirs, ^answer, ^order]
             } = got

      assert counted(c.gateway, "other").counters.collided == 2
      assert Router.way(c.gateway, {"main", 1}) == {"first", :self}
      # Nor do its other parts.
      say(c.other, heartbeat(1, type: 30, autopilot: 8, component: 100))
      assert %{"g" => []} = got(c.all)
      say(c.g, message(command(1, 100), 255, 190))
      assert %{"other" => []} = got(c.all)
    end

    test "the same bytes of both are no copies of each other", c do
      same = heartbeat(1, seq: 77)
      say(c.other, same)
      say(c.first, same)
      assert %{"g" => [^same]} = got(c.g)
      assert counted(c.gateway, "first").counters.duplicates == 0
      assert counted(c.gateway, "other").counters.duplicates == 0
    end

    test "its reboot is not the first one's (R6)", c do
      deliver = fn ms, us ->
        time = message(%Messages.SystemTime{time_boot_ms: ms, time_unix_usec: 1_000_000_000_000_000}, 1, 1)
        deliver(c.gateway, "other", Enum.map(parse(time), &%{&1 | at: us}))
      end

      deliver.(500_000, 0)
      for n <- 0..4, do: deliver.(1_000 + n * 500, n * 500_000)
      assert Router.way(c.gateway, {"main", 1}) == {"first", :self}
    end

    test "when there is one again it is a way to it, as before", c do
      test = self()
      ref = make_ref()
      gateway = c.gateway

      :telemetry.attach(
        ref,
        [:aerie, :router, :collision],
        fn _, _, m, _ -> m.gateway == gateway && send(test, {:collision, m.system, m.links}) end,
        nil
      )

      on_exit(fn -> :telemetry.detach(ref) end)
      :ok = Router.Apart.put(c.gateway, {"main", 1}, [])
      assert_received {:collision, 1, []}
      :ok = Router.Apart.put(c.gateway, {"main", 1}, [])
      refute_received {:collision, _, _}
      bytes = attitude(1, 5)
      say(c.other, bytes)
      assert %{"g" => [^bytes]} = got(c.all)
      assert Router.way(c.gateway, {"main", 1}) == {"other", :self}
    end
  end

  describe "rules of an endpoint" do
    setup c, do: {:ok, v: vehicle(c.gateway, "v", 1), w: vehicle(c.gateway, "w", 2)}

    test "filters in and out, by message, system, component and source", c do
      out = client(c.gateway, "out", 254, out: %{block_messages: ["ATTITUDE"], block_sources: ["w"]})
      into = client(c.gateway, "in", 253, in: %{allow_messages: ["HEARTBEAT"]})
      got([c.v, c.w, out, into])
      beat = heartbeat(1, seq: 1)
      say(c.v, [attitude(1, 1), beat])
      say(c.w, heartbeat(2, seq: 1))
      say(into, message(command(1), 253, 190))

      assert %{"out" => [^beat], "v" => []} =
               Map.update!(got([out, c.v]), "v", &(&1 -- [heartbeat(2, seq: 1)]))

      assert %{filtered_out: 2} = counted(c.gateway, "out").counters
      assert %{filtered_in: 1} = counted(c.gateway, "in").counters
    end

    test "rate limits count each message and each component for itself", c do
      slow = client(c.gateway, "slow", 254, rate_limits: %{"ATTITUDE" => 0.001})
      got(slow)
      for n <- 1..5, do: say(c.v, attitude(1, n))
      for n <- 1..5, do: say(c.w, attitude(2, n))
      say(c.v, heartbeat(1, seq: 3))
      expected = [attitude(1, 1), attitude(2, 1), heartbeat(1, seq: 3)]
      assert %{"slow" => ^expected} = got(slow)
      assert counted(c.gateway, "slow").counters.limited == 8
    end

    test "an endpoint that takes nothing any more is told less, and it is counted by class", c do
      lazy = self()
      {:ok, endpoint} = Endpoint.attach(c.gateway, id: "lazy")
      for n <- 1..5_000, do: deliver(c.gateway, "v", parse(attitude(1, n)))

      assert %{counters: %{dropped_state: 904, frames_out: 4_096}, waiting: 4_096} =
               counted(c.gateway, "lazy")

      assert Process.info(lazy, :message_queue_len) |> elem(1) >= 4_096
      :ok = Endpoint.taken(endpoint, 4_096)
      deliver(c.gateway, "v", parse(attitude(1, 1)))
      assert %{counters: %{frames_out: 4_097}} = counted(c.gateway, "lazy")

      assert {:error, "there is an endpoint lazy already"} =
               Task.async(fn -> Endpoint.attach(c.gateway, id: "lazy") end) |> Task.await()

      :ok = Endpoint.detach(endpoint)
      assert counted(c.gateway, "lazy") == nil
      # What it says now is heard by nobody.
      assert %{delivered: 0, unclaimed: 1} = Endpoint.ingress(endpoint, parse(heartbeat(44)))
      assert Router.way(c.gateway, {"main", 44}) == nil
    end
  end

  defp parse(bytes), do: elem(MavCodec.Parser.push(MavCodec.Parser.new(), bytes, 5), 0)

  defp deliver(gateway, id, frames),
    do: Router.deliver(gateway, %{id: id, network: "main", peer: :self}, frames)
end
