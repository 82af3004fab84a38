defmodule MavRouter.Router.BetweenVehiclesTest do
  @moduledoc "What vehicles hear of each other, and how many other listeners a link to vehicles has."
  use Aerie.EndpointCase, async: true

  alias MavRouter.Forward.GroundStations

  describe "between vehicles" do
    test "vehicles of a network hear each other's heartbeats and nothing else", c do
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
      # Who sends from this machine is judged as a client, whatever it says it is (here nobody judges).
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

    test "H5: a heartbeat with an id that a vehicle takes for its station's does not reach it", c do
      [_v5, v200, _v7] = all = for n <- [5, 200, 7], do: vehicle(c.gateway, "v#{n}", n)
      v5 = hd(all)
      got(all)
      beat = heartbeat(200, seq: 9)
      GroundStations.obeyed(c.gateway, {"main", 5}, {190, 200})
      # Of another network, of a higher id, and itself.
      GroundStations.obeyed(c.gateway, {"other", 7}, {1, 255})
      GroundStations.obeyed(c.gateway, {"main", 7}, {201, 255})
      GroundStations.obeyed(c.gateway, {"main", 200}, :unknown)
      say(v200, beat)
      assert %{"v5" => [], "v7" => [^beat]} = got(all)
      # Its very first one neither.
      late = endpoint(c.gateway, "late", side: :vehicle)
      say(late, heartbeat(195))
      assert %{"v5" => [], "v200" => []} = got(all)
      # The other way round, nobody's heartbeat counts for more than a vehicle's.
      say(v5, heartbeat(5, seq: 3))
      assert %{"v200" => []} = got(all)
      # The parameter was changed.
      GroundStations.obeyed(c.gateway, {"main", 5}, {255, 255})
      say(v200, beat)
      assert %{"v5" => [^beat]} = got(all)
    end

    test "H5: nor does it reach a router with many vehicles of which one takes the id for its station's", c do
      [router, v200] = all = for {name, n} <- [{"router", 5}, {"v200", 200}], do: vehicle(c.gateway, name, n)
      say(router, for(n <- 6..26, do: attitude(n, 1)))
      got(all)
      say(v200, heartbeat(200, seq: 9))
      assert %{"router" => [_beat]} = got(all)
      GroundStations.obeyed(c.gateway, {"main", 26}, {200, 200})
      say(v200, heartbeat(200, seq: 10))
      assert %{"router" => []} = got(all)
    end

    test "H5: redundant links and telemetry of a team carry no such heartbeat either" do
      gateway = start_parts(%{router: %{between_vehicles: :all}})
      v5 = vehicle(gateway, "v5", 5, group: "pair")
      second = vehicle(gateway, "second", 5, group: "pair")
      v200 = vehicle(gateway, "v200", 200)
      GroundStations.obeyed(gateway, {"main", 5}, {200, 200})
      got([v5, second, v200])
      say(v200, [attitude(200, 1), heartbeat(200, seq: 9)])
      got = got([v5, second])
      assert Enum.sort(got["v5"] ++ got["second"]) == [attitude(200, 1)]
    end

    test "vehicles of a crowd hear nothing of each other, and one more changes no receivers", c do
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
      say(part, heartbeat(1, type: 26, autopilot: 8, component: 2))
      got([part | all])
      say(v1, attitude(1, 2))
      assert %{"part" => [_]} = got(part)
    end

    test "fast heartbeats reach other vehicles at a bounded rate", c do
      all = for n <- 1..10, do: vehicle(c.gateway, "v#{n}", n)
      g = client(c.gateway, "g", 255)
      got([g | all])
      say(hd(all), for(n <- 1..100, do: heartbeat(1, seq: n)))
      got = got([g | all])
      assert length(got["g"]) == 100
      for %{name: name} <- tl(all), do: assert(length(got[name]) in 1..4)
    end

    test "router.between_vehicles decides" do
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

  describe "senders on a link to vehicles that are not vehicles" do
    # Peers of one link, all written to by one process.
    defp peers(gateway, names, since \\ 0) do
      tables = MavRouter.Tables.of(gateway)
      {:ok, owner} = MavRouter.Endpoints.Owner.new("port", side: :vehicle, networks: ["main"])
      MavRouter.Endpoints.put_owner(tables, owner)

      for name <- names do
        fields = [
          since: since,
          out: {:pid, self(), name},
          kind: :link,
          listens: MavRouter.Endpoints.listens?(tables, owner, :unknown)
        ]

        MavRouter.Endpoints.put(gateway, tables, Endpoint.new(gateway, {"port", name}, fields))
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
      Aerie.Reader.deliver(gateway, %{id: "port", network: "main", peer: peer}, parse(bytes))
    end

    test "on each link 8 unknown peers get broadcasts, and 32 that said what they are; vehicles do not count",
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

    test "a frame and a heartbeat cost the same beside 500 vehicles as beside 40" do
      work = fn count ->
        gateway = start_parts()
        peers(gateway, 1..count)
        tables = MavRouter.Tables.of(gateway)
        for n <- 1..count, do: MavRouter.Endpoints.note(tables, {"port", n}, heard_vehicle: true)

        frames =
          for n <- 1..50, bytes <- [attitude(1, n), heartbeat(1, type: 2, autopilot: 3)], do: parse(bytes)

        source = %{id: "port", network: "main", peer: 1}
        for one <- frames, do: Aerie.Reader.deliver(gateway, source, one)
        {:reductions, before} = Process.info(self(), :reductions)
        for one <- frames, do: Aerie.Reader.deliver(gateway, source, one)
        {:reductions, later} = Process.info(self(), :reductions)
        div(later - before, length(frames))
      end

      few = work.(40)
      assert few < 2_000
      assert work.(500) < 1.5 * few + 50
    end

    test "a new peer is a listener only among the first 8, and its heartbeat goes to no vehicle", c do
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

    test "their broadcasts do not go to every vehicle", c do
      peers(c.gateway, 1..100)
      for n <- 1..50, do: by_port(c.gateway, n, heartbeat(100 + n))
      heard_by()
      by_port(c.gateway, 100, attitude(9, 1))
      assert Enum.all?(heard_by(), fn {peer, 1} -> peer > 50 end)
    end
  end
end
