defmodule MavRouter.Router.RedundantTest do
  @moduledoc "Groups of redundant links: what is measured of each, and which one carries what."
  use Aerie.VehicleCase, async: true

  alias Aerie.Base.Store
  alias MavRouter.Router
  alias MavRouter.Router.{Meter, Routes, Tables}
  alias MavRouter.Router.Routes.{LinkSelector, Score}
  alias MavCodec.Messages, as: M
  alias MavCodec.Parser

  @loopback {127, 0, 0, 1}
  @key {"main", 1}

  # One autopilot with a radio for each of `ports`, which delays what goes through it by so many ms in each direction. It
  # answers TIMESYNC where it was asked, and tells the test what else it hears.
  defp autopilot(radios) do
    test = self()

    spawn_link(fn ->
      radios =
        for {port, delay} <- radios do
          {:ok, socket} = :gen_udp.open(0, [:binary, ip: @loopback, active: true])
          {socket, {port, delay}}
        end

      send(self(), :beat)
      fly(test, Map.new(radios), 0)
    end)
  end

  defp fly(test, radios, seq) do
    receive do
      :beat ->
        Process.send_after(self(), :beat, 100)

        for {_socket, {port, _delay}} = radio <- radios,
            do: say(radio, port, heartbeat(1, seq: rem(seq, 256)))

        fly(test, radios, seq + 1)

      {:udp, socket, _address, _port, bytes} ->
        {port, delay} = radios[socket]
        Process.send_after(self(), {:heard, socket, port, bytes}, delay)
        fly(test, radios, seq)

      {:heard, socket, port, bytes} ->
        {frames, _parser} = Parser.push_datagram(Parser.new(), bytes, nil)
        for frame <- frames, do: answer(test, {socket, radios[socket]}, port, frame)
        fly(test, radios, seq)

      {:say, socket, port, bytes} ->
        :gen_udp.send(socket, @loopback, port, bytes)
        fly(test, radios, seq)
    end
  end

  defp say({socket, {_port, delay}}, port, bytes),
    do: Process.send_after(self(), {:say, socket, port, bytes}, delay)

  defp answer(test, radio, port, frame) do
    case MavCodec.decode(frame) do
      {:ok, %M.Timesync{tc1: 0, ts1: ts1}} ->
        now = System.os_time(:nanosecond)
        say(radio, port, MavCodec.encode(%M.Timesync{tc1: now, ts1: ts1}, system: 1, component: 1))

      {:ok, message} ->
        send(test, {:by, port, message})

      {:error, _unknown} ->
        :ok
    end
  end

  test "round trips of TIMESYNC by each link make its score, the better one carries, and the snapshot shows it" do
    config = %{
      mavlink: %{system_id: 245, component_id: 191, read_gcs_parameters: false, request_streams: false}
    }

    gateway = Aerie.GatewayCase.start_gateway(config, with: [:router, :links])
    radio = fn id -> add_link(gateway, "udpin:127.0.0.1:0", id: id, options: [router: [group: "mast"]]) end
    # By name the slow one would come first.
    {"a-slow", slow} = radio.("a-slow")
    {"b-fast", fast} = radio.("b-fast")
    autopilot(%{slow => 200, fast => 0})

    quality = fn id -> (MavRouter.Link.get(gateway, id) || %{})[:quality] || %{} end
    eventually(fn -> quality.("a-slow")[:rtt_ms] && quality.("b-fast")[:rtt_ms] end)
    # However busy this machine is, the delays are in it.
    assert quality.("a-slow").rtt_ms >= 400
    assert %{group: "mast", loss: loss, age_ms: age} = quality.("a-slow")
    assert loss == 0.0 and is_integer(age)
    order = MavCodec.encode(%M.CommandLong{target_system: 1, command: 400}, system: 245, component: 191)

    # Our own words go by it, too. An answer that a busy machine delays turns the choice for a while.
    eventually(fn ->
      :ok = Router.send(gateway, @key, order)
      assert_receive {:by, by, %M.CommandLong{command: 400}}
      {a, b} = {quality.("a-slow"), quality.("b-fast")}
      by == fast and b.carries and not a.carries and b.score > a.score
    end)

    # What is configured for a class goes before, and one link may be asked for.
    for id <- ["a-slow", "b-fast"], do: :ok = Router.configure(gateway, id, carry: %{"control" => "a-slow"})
    :ok = Router.send(gateway, @key, order)
    assert_receive {:by, ^slow, %M.CommandLong{command: 400}}
    :ok = Router.send(gateway, @key, order, link: "b-fast")
    assert_receive {:by, ^fast, %M.CommandLong{command: 400}}
    for id <- ["a-slow", "b-fast"], do: :ok = Router.configure(gateway, id, carry: %{"control" => "all"})
    :ok = Router.send(gateway, @key, order)
    for port <- [slow, fast], do: assert_receive({:by, ^port, %M.CommandLong{command: 400}})
  end

  test "a link that falls silent is worth less and less in its snapshot, too" do
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
      # Here it is the test that measures.
      :ok = :sys.suspend(Aerie.Base.Names.whereis(gateway, :router_meter), Aerie.Patience.ms())
      {:ok, gateway: gateway, tables: tables}
    end

    test "of Meter: by loss, round trip and age; with hysteresis", c do
      state = Router.Meter.new(c.gateway)

      for id <- ["a", "b"] do
        {:ok, owner} = Router.Owner.new(id, group: "mast")
        Router.Endpoints.put_owner(c.tables, owner)
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
              # Not the mean with what was before: that is `Meter.note_rtt/3`'s.
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

    test "what is configured goes before what is measured, until nothing comes by it", c do
      both = ["a", "b"]
      assert LinkSelector.links(c.tables, "mast", both, nil) == ["a"]
      :ets.insert(c.tables.scores, {{:carrier, "mast"}, "b"})
      assert LinkSelector.links(c.tables, "mast", both, nil) == ["b"]
      assert LinkSelector.links(c.tables, "mast", both, "a") == ["a"]
      assert LinkSelector.links(c.tables, "mast", both, "c") == ["b"]
      assert LinkSelector.links(c.tables, "mast", both, :all) == both
      assert LinkSelector.links(c.tables, "mast", ["a"], "b") == ["a"]

      for {score, carries} <- [{80.0, "a"}, {0.0, "b"}] do
        :ets.insert(c.tables.scores, {{:score, "a"}, %{score: score, loss: nil, rtt_ms: nil, age_ms: nil}})
        assert LinkSelector.links(c.tables, "mast", both, "a") == [carries]
      end
    end

    test "a link that does not hear the vehicle any more is passed over, however good it is for others", c do
      ways = [{"a", :self}, {"b", :self}]
      for way <- ways, do: Routes.learn(c.tables, "main", 1, 1, way, 10_000)
      assert LinkSelector.within_reach(c.tables, @key, ways) == ways
      Routes.learn(c.tables, "main", 1, 1, {"b", :self}, 14_000)
      assert LinkSelector.within_reach(c.tables, @key, ways) == ways
      Routes.learn(c.tables, "main", 1, 1, {"b", :self}, 15_001)
      assert LinkSelector.within_reach(c.tables, @key, ways) == [{"b", :self}]
      # With neither heard any more both are as good as before.
      assert LinkSelector.within_reach(c.tables, {"main", 9}, ways) == ways
    end
  end
end
