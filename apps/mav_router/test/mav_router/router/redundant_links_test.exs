defmodule MavRouter.Router.RedundantLinksTest do
  @moduledoc "R8: redundant links, and loops."
  use Aerie.EndpointCase, async: true

  describe "another router that hears us twice" do
    setup c do
      v = vehicle(c.gateway, "v", 1)
      x = endpoint(c.gateway, "x", [])
      y = endpoint(c.gateway, "y", [])
      g = client(c.gateway, "g", 255)

      # What was seen is remembered for half a second to a second; a busy machine takes longer from one endpoint to the next.
      tables = MavRouter.Tables.of(c.gateway)
      {turn, until} = :ets.lookup_element(tables.settings, :seen_turn, 2)
      :ets.insert(tables.settings, {:seen_turn, {turn, until + 3_600_000}})
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

    test "a frame that went round before the loop was found dies out, and later ones do not go round", c do
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

    test "a frame that both links bring goes on once, and never from one link to the other", c do
      for n <- 1..20 do
        {first, second} = if rem(n, 2) == 0, do: {c.a, c.b}, else: {c.b, c.a}
        for e <- [first, second], do: say(e, attitude(1, n))
      end

      expected = for n <- 1..20, do: attitude(1, n)
      assert got(c.all) == %{"a" => [], "b" => [], "g" => expected}
      counts = for name <- ["a", "b"], do: counted(c.gateway, name).counters.duplicates
      assert Enum.sum(counts) >= 20
    end

    test "one link carries what goes to their vehicle: the better one, or the one configured for the class",
         c do
      order = message(command(1), 255, 190)
      say(c.g, order)
      assert %{"a" => [^order], "b" => []} = got(c.all)
      tables = MavRouter.Tables.of(c.gateway)
      :ets.insert(tables.scores, {{:carrier, "mast"}, "b"})
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

    test "redundant links without a group are found out: nothing twice, nothing back to its vehicle",
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

    test "Meter chooses the link that is heard better, and says so", c do
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
      :ok = :sys.suspend(Aerie.Base.Names.whereis(gateway, :router_meter), Aerie.Patience.ms())
      tables = MavRouter.Tables.of(gateway)
      state = MavRouter.Endpoints.Meter.new(gateway)

      put = fn id, received, lost ->
        sources = %{{1, 1} => %{received: received, lost: lost}}

        Aerie.Base.Store.put_link(gateway, id, %{
          id: id,
          status: :up,
          sources: sources,
          last_heard: System.os_time(:microsecond)
        })
      end

      for id <- ["a", "b"], do: put.(id, 100, 0)
      state = MavRouter.Endpoints.Meter.measure(state, tables, 0)
      assert_received {:carrier, "a"}
      put.("a", 150, 50)
      put.("b", 200, 0)
      state = MavRouter.Endpoints.Meter.measure(state, tables, 1_000)
      assert_received {:carrier, "b"}
      :ok = MavRouter.Endpoints.Meter.note_rtt(gateway, "a", 20)
      put.("a", 250, 50)
      MavRouter.Endpoints.Meter.measure(state, tables, 2_000)
      refute_received {:carrier, _}
      assert Router.route(gateway, {"main", 1}) != nil
    end
  end
end
