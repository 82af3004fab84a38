defmodule MavRouter.Endpoints.MeterTest do
  @moduledoc "What is measured of redundant links, and which one carries."
  use Aerie.LinkCase, async: true

  alias Aerie.Base.Store
  alias MavRouter.Endpoints.Meter
  alias MavRouter.Tables
  alias MavRouter.Routes.Score

  @loopback {127, 0, 0, 1}

  test "a link that falls silent is worth less and less in its snapshot as well" do
    gateway = start_parts()
    {id, port} = add_link(gateway, "udpin:127.0.0.1:0")
    {:ok, socket} = :gen_udp.open(0, [:binary, ip: @loopback])

    # It speaks until its score has been seen: on a busy machine one heartbeat may be old before it is measured.
    spoken = :counters.new(1, [])

    before =
      eventually(fn ->
        seq = rem(:counters.get(spoken, 1), 256)
        :counters.add(spoken, 1, 1)
        :ok = :gen_udp.send(socket, @loopback, port, heartbeat(1, seq: seq))

        match?(%{quality: %{score: s}} when s > 90, MavRouter.Link.get(gateway, id)) &&
          MavRouter.Link.get(gateway, id)
      end)

    assert %{quality: %{group: nil, carries: nil}} = before
    eventually(fn -> MavRouter.Link.get(gateway, id).quality.score < 70 end)
  end

  describe "the choice" do
    setup do
      gateway = start_parts()
      tables = Tables.of(gateway)
      # The test does the measuring here.
      :ok = :sys.suspend(Aerie.Base.Names.whereis(gateway, :router_meter), Aerie.Patience.ms())
      {:ok, gateway: gateway, tables: tables}
    end

    test "of Meter: by loss, round trip and age; with hysteresis", c do
      state = MavRouter.Endpoints.Meter.new(c.gateway)

      for id <- ["a", "b"] do
        {:ok, owner} = MavRouter.Endpoints.Owner.new(id, group: "mast")
        MavRouter.Endpoints.put_owner(c.tables, owner)
      end

      # {frames received, frames lost, round trip, silent for ms}, of a and b each second.
      seconds = [
        {{100, 0, 100, 0}, {100, 0, 100, 0}, "a"},
        # A little worse, twice: no change.
        {{100, 0, 250, 0}, {100, 0, 50, 0}, "a"},
        {{100, 0, 250, 0}, {100, 0, 50, 0}, "a"},
        {{100, 0, 50, 0}, {100, 0, 50, 0}, "a"},
        # A little worse for three readings.
        {{100, 0, 300, 0}, {100, 0, 50, 0}, "a"},
        {{100, 0, 300, 0}, {100, 0, 50, 0}, "a"},
        {{100, 0, 300, 0}, {100, 0, 50, 0}, "b"},
        # Much worse: at once.
        {{100, 0, 50, 0}, {0, 400, 50, 0}, "a"},
        # Silence is the worst.
        {{0, 0, 50, 9_000}, {100, 0, 50, 0}, "b"}
      ]

      Enum.reduce(Enum.with_index(seconds), {state, %{"a" => {0, 0}, "b" => {0, 0}}}, fn
        {{a, b, expected}, second}, {state, sums} ->
          now = System.os_time(:microsecond)

          sums =
            for {id, {new, gone, rtt, silent}} <- [{"a", a}, {"b", b}], into: %{} do
              {received, lost} = sums[id]
              sources = %{{1, 1} => %{received: received + new, lost: lost + gone}}
              heard = now - silent * 1000
              Store.put_link(c.gateway, id, %{id: id, status: :up, sources: sources, last_heard: heard})
              # It replaces the last one; `Meter.note_rtt/3` would average them.
              :ets.insert(c.tables.scores, {{:rtt, id}, rtt, second * 1000})
              {id, {received + new, lost + gone}}
            end

          state = Meter.measure(state, c.tables, second * 1000)
          assert {second, :ets.lookup_element(c.tables.scores, {:carrier, "mast"}, 2)} == {second, expected}
          {state, sums}
      end)

      assert %{score: score, rtt_ms: 50, carries: true, group: "mast"} = Meter.quality(c.gateway, "b")
      assert score > Score.useless()
      assert %{carries: false} = Meter.quality(c.gateway, "a")
      assert Meter.quality(c.gateway, "none") == nil
    end

    test "what was measured is averaged, and old after half a minute", c do
      :ok = Meter.note_rtt(c.gateway, "a", 100)
      :ok = Meter.note_rtt(c.gateway, "a", 50)
      assert [{_, 75.0, at}] = :ets.lookup(c.tables.scores, {:rtt, "a"})
      :ets.insert(c.tables.scores, {{:rtt, "a"}, 5_000, at - 31_000})
      :ok = Meter.note_rtt(c.gateway, "a", 50)
      assert [{_, 50, _}] = :ets.lookup(c.tables.scores, {:rtt, "a"})
    end
  end
end
