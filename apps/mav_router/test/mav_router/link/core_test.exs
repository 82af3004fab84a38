defmodule MavRouter.Link.CoreTest do
  use ExUnit.Case, async: true

  import Aerie.LinkCase, only: [attitude: 2, number: 1]
  import :proper_types, except: [binary: 0]

  alias MavRouter.Link.Core
  alias MavRouter.Link.Core.Snapshot
  alias MavRouter.Link.Spec

  @at 1_700_000_000_000_000

  defp now(ms), do: {ms, @at + ms * 1000}

  defp core(text, options \\ []), do: Core.new(Spec.parse!(text), [seed: 1] ++ options)

  # The core after events at their times, and the actions of the last event.
  defp run(core, events) do
    Enum.reduce(events, {core, []}, fn {ms, event}, {core, _actions} -> Core.handle(core, event, now(ms)) end)
  end

  defp up(text, options \\ []) do
    elem(run(core(text, options), [{0, :start}, {0, {:opened, %{local: "here"}}}]), 0)
  end

  defp delivered(actions),
    do: for({:deliver, peer, frames} <- actions, do: {peer, Enum.map(frames, &number/1)})

  test "connects, fails, waits, connects again: the first time at once" do
    {core, actions} = run(core("tcp:127.0.0.1:5760"), [{0, :start}])
    assert :open in actions
    assert Snapshot.text(core, 0) == "connecting to 127.0.0.1:5760"

    {core, actions} = Core.handle(core, {:failed, :econnrefused}, now(1))
    assert {:retry_in, 0} in actions
    {core, actions} = run(core, [{1, :retry}, {2, {:failed, :econnrefused}}])
    assert [wait] = for({:retry_in, wait} <- actions, do: wait)
    assert wait in 250..500

    seconds = :erlang.float_to_binary(wait / 1000, decimals: 1)
    assert Snapshot.text(core, 2) == "connection refused by 127.0.0.1:5760, next try in #{seconds} s"

    assert %{status: :down, reason: "connection refused by 127.0.0.1:5760", retry_in_ms: ^wait} =
             Snapshot.of(core, 2)

    {core, _} = Core.handle(core, :retry, now(1000))
    assert Snapshot.text(core, 1000) =~ "again (connection refused"
  end

  test "after a short connection that brought frames, the next attempt comes soon" do
    {core, actions} =
      Enum.reduce(1..9, {up("tcp:127.0.0.1:1"), []}, fn n, {core, _} ->
        ms = 100 * n
        run(core, [{ms, {:closed, :closed}}, {ms, :retry}, {ms, {:opened, %{}}}])
      end)

    assert actions != []
    {_core, actions} = run(core, [{1_000, {:read, [{:remote, attitude(1, 1)}]}}, {1_001, {:closed, :closed}}])
    assert [wait] = for({:retry_in, wait} <- actions, do: wait)
    assert wait in 250..500
  end

  test "after a long connection the next attempt comes at once, after a short one it does not" do
    {_core, actions} = run(up("tcp:127.0.0.1:1"), [{5_000, {:closed, :closed}}])
    assert {:retry_in, 0} in actions and :close in actions

    flapping =
      Enum.reduce(1..4, {up("tcp:127.0.0.1:1"), []}, fn n, {core, _} ->
        run(core, [{n, {:closed, :closed}}, {n, :retry}, {n, {:opened, %{}}}])
      end)

    {_core, actions} = Core.handle(elem(flapping, 0), {:closed, :closed}, now(10))
    assert [wait] = for({:retry_in, wait} <- actions, do: wait)
    assert wait >= 1000
  end

  for step <- [-3_600, 3_600] do
    test "the system clock is set by #{step} s: everything was heard as long ago as before" do
      step = unquote(step) * 1_000_000
      {core, _} = run(up("udpin:127.0.0.1:0"), [{1_000, {:read, [{:a, attitude(1, 1)}]}}, {2_000, :tick}])
      assert %{last_heard: heard, since: since} = Snapshot.of(core, 2_000)
      {core, actions} = Core.handle(core, :tick, {2_250, @at + 2_250_000 + step})
      assert :publish_snapshot in actions
      assert %{last_heard: heard_now, since: since_now, status: :up} = Snapshot.of(core, 2_250)
      assert {heard_now, since_now} == {heard + step, since + step}
      # Once, not with each tick.
      {core, _} = Core.handle(core, :tick, {2_500, @at + 2_500_000 + step})
      assert Snapshot.of(core, 2_500).last_heard == heard_now
    end
  end

  test "reads of one peer in a batch are one delivery, in order; each peer has its own parser" do
    <<a::binary-size(12), b::binary>> = attitude(1, 1)

    {core, actions} =
      run(up("udpin::1"), [
        {5,
         {:read,
          [{:x, attitude(1, 1)}, {:y, attitude(2, 7)}, {:x, attitude(1, 2) <> attitude(1, 3)}, {:y, a}]}}
      ])

    assert delivered(actions) == [x: [1, 2, 3], y: [7]]
    # The rest of a frame that was split over two datagrams (F12).
    {core, actions} = Core.handle(core, {:read, [{:y, b}]}, now(6))
    assert delivered(actions) == [y: [1]]
    assert %{frames_in: 5, messages: %{30 => 5}} = Core.counters(core)
  end

  test "the start of a frame that never ends delays nothing and is counted" do
    core = up("udpin::1")

    {core, actions} =
      run(core, [{1, {:read, [{:x, attitude(1, 1)}, {:x, <<0xFD, 255, 0>>}, {:x, attitude(1, 2)}]}}])

    assert delivered(actions) == [x: [1, 2]]
    assert Core.counters(core).resync_bytes == 3
  end

  test "half a frame is given up after a silence, but not by a link that stood still and has not read the rest yet" do
    <<a::binary-size(12), b::binary>> = attitude(1, 1)
    {core, _} = run(up("tcp:127.0.0.1:1"), [{1, {:read, [{:remote, a}]}}])
    # Its timer was first.
    {late, actions} = run(core, [{1_000, :tick}, {1_001, {:read, [{:remote, b}]}}])
    assert delivered(actions) == [remote: [1]]
    assert Core.counters(late).resync_bytes == 0

    {core, actions} = run(core, [{250, :tick}, {500, :tick}, {501, {:read, [{:remote, b}]}}])
    assert delivered(actions) == []
    assert Core.counters(core).resync_bytes > 0
  end

  test "datagram peers are forgotten after a minute of silence, with their routes; counters stay" do
    {core, _} = run(up("udpin::1"), [{1, {:read, [{:x, attitude(1, 1)}, {:y, attitude(1, 1)}]}}])
    {core, actions} = run(core, [{50_000, {:read, [{:x, attitude(1, 2)}]}}, {60_001, :tick}])
    assert {:forget, :y} in actions
    assert Map.keys(core.peers.map) == [:x]
    assert Core.counters(core).frames_in == 3
  end

  test "if there is no room, a newcomer replaces the earliest unknown peer, if there is one" do
    core = up("udpin::1", max_peers: 2)
    {core, _} = run(core, [{0, {:read, [{:x, attitude(1, 1)}]}}, {4_000, {:read, [{:y, attitude(1, 1)}]}}])
    {core, actions} = Core.handle(core, {:read, [{:z, attitude(1, 1)}]}, now(4_001))
    assert delivered(actions) == []
    assert Core.counters(core).peers_refused == 1
    {core, actions} = Core.handle(core, {:read, [{:z, attitude(1, 1)}]}, now(5_000))
    assert delivered(actions) == [z: [1]]
    assert {:forget, :x} in actions
    assert Map.keys(core.peers.map) == [:y, :z]
  end

  test "a known peer is never replaced" do
    core = up("udpin::1", max_peers: 2)
    {core, _} = run(core, [{0, {:read, [{:x, attitude(1, 1)}]}}, {600, {:read, [{:x, attitude(1, 2)}]}}])
    {core, _} = run(core, [{700, {:read, [{:y, attitude(1, 1)}]}}, {30_000, {:read, [{:z, attitude(1, 1)}]}}])
    assert Map.keys(core.peers.map) == [:x, :z]
    {core, actions} = Core.handle(core, {:read, [{:y, attitude(1, 1)}]}, now(30_001))
    assert actions == []
    assert Map.keys(core.peers.map) == [:x, :z]
    assert Core.counters(core).peers_refused == 1
  end

  test "of ten thousand forged senders a second few are parsed; a known peer loses nothing" do
    core = up("udpin::1", max_peers: 1024)

    {core, _} =
      run(core, [{0, {:read, [{:known, attitude(1, 0)}]}}, {600, {:read, [{:known, attitude(1, 1)}]}}])

    # Ten seconds: a hundred of them, and a frame of the peer, in each read.
    {core, joined, heard} =
      Enum.reduce(1..1000, {core, 0, []}, fn n, {core, joined, heard} ->
        reads = for k <- 1..100, do: {{n, k}, attitude(rem(k, 250) + 2, 1)}
        {core, actions} = Core.handle(core, {:read, reads ++ [{:known, attitude(1, n)}]}, now(600 + n * 10))
        assert :publish not in actions
        new = Enum.count(actions, &match?({:join, _peer, _text}, &1))
        {core, joined + new, heard ++ for({:deliver, :known, frames} <- actions, f <- frames, do: number(f))}
      end)

    assert heard == Enum.to_list(1..1000)
    # The burst, and a hundred per second.
    assert joined in 1_500..1_513
    assert map_size(core.peers.map) <= 1024
    counters = Core.counters(core)
    assert counters.peers_refused == 100_000 - joined
    assert counters.frames_in == joined + 1_002
    assert counters.bytes_in == 101_002 * byte_size(attitude(1, 1))
  end

  test "two hundred honest vehicles that come at once are peers with their first frame, and lose none" do
    core = up("udpin::1", max_peers: 1024)

    {core, joined} =
      Enum.reduce(0..4, {core, 0}, fn second, {core, joined} ->
        reads = for n <- 1..200, do: {{:vehicle, n}, attitude(n, second)}
        {core, actions} = Core.handle(core, {:read, reads}, now(second * 1_000))
        assert Enum.count(actions, &match?({:deliver, _, [_]}, &1)) == 200
        {core, joined + Enum.count(actions, &match?({:join, _, _}, &1))}
      end)

    assert joined == 200
    assert %{peers_refused: 0, frames_in: 1_000} = Core.counters(core)
  end

  test "the cost of a forged sender does not depend on how many peers there are" do
    work = fn peers ->
      core = up("udpin::1", max_peers: 2_000)

      core =
        Enum.reduce(1..peers, core, fn n, core ->
          elem(Core.handle(core, {:read, [{n, attitude(1, 1)}]}, now(n * 11)), 0)
        end)

      at = now(peers * 11 + 1)
      {core, _} = Core.handle(core, {:read, for(n <- 1..600, do: {{:filler, n}, attitude(1, 1)})}, at)
      reads = for n <- 1..1_000, do: {{:made_up, n}, attitude(1, 1)}
      {:reductions, before} = Process.info(self(), :reductions)
      {_core, []} = Core.handle(core, {:read, reads}, at)
      {:reductions, later} = Process.info(self(), :reductions)
      div(later - before, 1_000)
    end

    assert work.(10) <= 60
    assert work.(1_000) <= 60
  end

  test "datagrams that were dropped before they were read are counted, and shown while the overload lasts" do
    core = up("udpin::1")
    assert Snapshot.of(core, 0).overload == nil
    {core, actions} = run(core, [{1_000, {:count, :kernel_dropped, 5}}])
    assert actions == [{:emit, :overload, %{datagrams: 5}, %{}}]
    {core, actions} = run(core, [{1_001, {:count, :shed, 7}}, {1_250, :tick}])
    assert :publish_snapshot in actions
    assert %{overload: %{since: since, datagrams: 12}, text: text} = Snapshot.of(core, 1_250)
    assert since == @at + 1_000_000
    assert text =~ "12 datagrams came faster than they could be read"
    assert %{kernel_dropped: 5, shed: 7} = Core.counters(core)

    {core, _} = run(core, [{11_000, :tick}])
    assert %{overload: %{}} = Snapshot.of(core, 11_000)
    {core, actions} = run(core, [{11_001, :tick}])
    assert {:emit, :relieved, %{datagrams: 12}, %{}} in actions
    assert Snapshot.of(core, 11_001).overload == nil
  end

  test "frames that a session did not take are counted, and shown while that lasts" do
    core = up("udpin::1")
    assert Snapshot.of(core, 0).behind == nil

    assert {core, [{:warn, "a vehicle's session does not keep up: 5 frames" <> _}]} =
             run(core, [{1_000, {:count, :overload, 5}}])

    assert {core, []} = run(core, [{1_001, {:count, :overload, 7}}])
    {core, _} = run(core, [{1_250, :tick}])
    assert %{behind: %{since: since, frames: 12}, overload: nil, text: text} = Snapshot.of(core, 1_250)
    assert since == @at + 1_000_000
    assert text =~ "12 frames came faster than their vehicle's session took them"
    assert %{overload: 12} = Core.counters(core)
    {core, _} = run(core, [{11_000, :tick}])
    assert %{behind: %{}} = Snapshot.of(core, 11_000)
    {core, _} = run(core, [{11_001, :tick}])
    assert Snapshot.of(core, 11_001).behind == nil
  end

  test "what a transport warns of is logged at the first connection, not at each" do
    {:ok, spec} = Spec.parse("udpin::1")
    {core, _} = run(Core.new(spec, []), [{0, :start}])
    {core, actions} = run(core, [{1, {:opened, %{local: "127.0.0.1:1", warning: "little room"}}}])
    assert {:warn, "little room"} in actions
    {core, _} = run(core, [{5_000, {:closed, :closed}}, {60_000, :retry}])
    {_core, actions} = run(core, [{60_001, {:opened, %{local: "127.0.0.1:1", warning: "little room"}}}])
    assert :publish in actions
    refute {:warn, "little room"} in actions
  end

  test "garbage from a thousand addresses makes no peer" do
    reads = for n <- 1..1000, do: {n, <<0xFD, 9, 0, n::16, 1, 2, 3>>}
    {core, actions} = Core.handle(up("udpin::1"), {:read, reads}, now(1))
    assert delivered(actions) == [] and core.peers.map == %{}
    assert Core.counters(core).bytes_in == 8000
  end

  test "connections of a server come, go, and are bounded" do
    core = up("tcpin::1", max_peers: 1)
    {core, _} = Core.handle(core, {:peer_up, 1, "a"}, now(1))
    assert {core, [{:drop, 2}]} = Core.handle(core, {:peer_up, 2, "b"}, now(1))
    {core, _} = Core.handle(core, {:read, [{1, attitude(1, 1)}]}, now(2))
    {core, actions} = Core.handle(core, {:peer_down, 1, :closed}, now(3))
    assert {:forget, 1} in actions
    assert {^core, []} = Core.handle(core, {:peer_down, 2, :closed}, now(3))
    assert %{frames_in: 1, peers_refused: 1} = Core.counters(core)
  end

  test "records keep their own times, and a damaged one costs only itself" do
    records = [{1, attitude(1, 1)}, {2, <<0xFD, 9>>}, {3, attitude(1, 2)}]
    {_core, actions} = Core.handle(up("replay:x.tlog"), {:records, records}, now(9))
    assert [{:deliver, :remote, frames}] = actions
    assert Enum.map(frames, &{&1.at, number(&1)}) == [{1, 1}, {3, 2}]
  end

  test "a link that hears nothing is idle, and says so; a UDP client then resolves its name again" do
    core = up("udpout:127.0.0.1:1")
    assert %{status: :up, text: "connected to 127.0.0.1:1"} = Snapshot.of(core, 9_999)
    assert %{status: :idle, text: "connected to 127.0.0.1:1, nothing heard"} = Snapshot.of(core, 10_000)
    {core, actions} = Core.handle(core, :tick, now(30_000))
    assert :close in actions and {:retry_in, 0} in actions
    assert core.reason == "nothing heard from 127.0.0.1:1 for 30 s"
  end

  test "X6: a path by which a vehicle is reached stays open however long it is silent; any other is forgotten" do
    sender = {{127, 0, 0, 1}, 5}
    udpin = up("udpin:127.0.0.1:0", needed?: &(&1 == sender))

    {udpin, _} =
      run(udpin, for(peer <- [sender, {{127, 0, 0, 1}, 6}], do: {0, {:read, [{peer, attitude(1, 1)}]}}))

    {udpin, actions} = Core.handle(udpin, :tick, now(3_600_000))
    assert for({:forget, peer} <- actions, do: peer) == [{{127, 0, 0, 1}, 6}]
    assert Map.keys(udpin.peers.map) == [sender]

    udpout = up("udpout:127.0.0.1:1", needed?: &(&1 == :remote))
    assert {%{phase: :up}, []} = Core.handle(udpout, :tick, now(3_600_000)) |> without_publishing()
    found = %{up("serial:auto", needed?: &(&1 == :remote)) | heard: 0}
    assert {%{phase: :up}, []} = Core.handle(found, :tick, now(3_600_000)) |> without_publishing()
  end

  defp without_publishing({core, actions}), do: {core, actions -- [:publish_snapshot]}

  test "X6: silence of less than an hour does not open a link of high latency again" do
    slow = Core.new(Spec.parse!("udpout:127.0.0.1:1", options: %{high_latency: true}), seed: 1)
    {slow, _} = run(slow, [{0, :start}, {0, {:opened, %{local: "here"}}}])
    assert {%{phase: :up}, _} = Core.handle(slow, :tick, now(3_599_999))
    assert {%{phase: :down}, _} = Core.handle(slow, :tick, now(3_600_000))
  end

  describe "a serial port" do
    alias MavRouter.Link.Serial.Finding
    alias MavCodec.Sniff

    @sniffed %{protocol: :nmea, confidence: 0.99, evidence: "2 sentences (GPGGA)", heartbeat: false}

    defp garbage(core, from, to) do
      Enum.reduce(from..to//250, {core, []}, fn ms, {core, all} ->
        {core, _} = Core.handle(core, {:read, [{:remote, <<0, 1, 2>>}]}, now(ms))
        {core, actions} = Core.handle(core, :tick, now(ms))
        {core, all ++ actions}
      end)
    end

    test "whose bytes contain no frame for five seconds is examined every ten" do
      {core, actions} = garbage(up("/dev/ttyX,57600"), 250, 4_750)
      refute :sniff in actions
      {core, actions} = garbage(core, 5_000, 14_750)
      assert Enum.count(actions, &(&1 == :sniff)) == 1
      {core, actions} = Core.handle(core, {:sniffed, "/dev/ttyX", 57_600, @sniffed}, now(14_800))
      assert :publish in actions

      assert [{:emit, :garbled, _, %{finding: %Finding{protocol: :nmea}}}] =
               for({:emit, _, _, _} = e <- actions, do: e)

      assert Snapshot.text(core, 14_800) ==
               "connected, but no MAVLink on /dev/ttyX: NMEA at 57600 baud, 2 sentences (GPGGA)"

      # A good frame ends that.
      {core, _} = run(core, [{14_900, {:read, [{:remote, attitude(1, 1)}]}}, {15_000, :tick}])
      assert Snapshot.of(core, 15_000).diagnosis == []
      # The result comes late: nothing is wrong any more.
      assert {_core, []} = Core.handle(core, {:sniffed, "/dev/ttyX", 57_600, @sniffed}, now(15_100))
    end

    test "that was found by a search is then searched for again" do
      {core, actions} = garbage(up("serial:auto"), 250, 5_250)
      assert :sniff in actions
      {core, actions} = Core.handle(core, {:sniffed, "/dev/ttyX", 57_600, @sniffed}, now(5_300))
      assert :close in actions and {:retry_in, 0} in actions
      assert core.reason == "no more MAVLink on /dev/ttyX: NMEA at 57600 baud, 2 sentences (GPGGA)"
    end

    test "that is silent stays open, unless it was found by a search" do
      assert {%{phase: :up}, _} = run(up("/dev/ttyX,57600"), [{60_000, :tick}])
      assert {%{phase: :up}, _} = run(up("serial:auto"), [{29_000, :tick}])

      assert {%{phase: :down, reason: "nothing heard from any serial port for 30 s"}, _} =
               run(up("serial:auto"), [{30_000, :tick}])
    end

    test "searches begin every ten seconds, with what was found the last time" do
      findings = [Finding.from_listening("/dev/ttyX", 9_600, @sniffed), Finding.silent("/dev/ttyY", 5.0)]
      {core, _} = run(core("serial:auto"), [{0, :start}, {5_000, {:failed, {:undetected, findings}}}])
      assert Snapshot.of(core, 5_000).diagnosis == findings
      assert core.reason =~ "no vehicle heard: /dev/ttyX: NMEA at 9600 baud"

      {core, actions} = run(core, [{5_000, :retry}, {10_000, {:failed, {:undetected, []}}}])
      assert {:retry_in, 5_000} in actions
      found = Finding.from_listening("/dev/ttyX", 57_600, Sniff.classify(attitude(1, 1)))
      {core, actions} = run(core, [{15_000, :retry}, {15_100, {:opened, %{finding: found, baud: 57_600}}}])
      refute :reconnected in actions
      assert %{found: %{path: "/dev/ttyX", baud: 57_600}, diagnosis: []} = core
      {core, _} = Core.handle(core, {:closed, "it was unplugged"}, now(20_000))
      assert core.found.baud == 57_600
      {_core, actions} = run(core, [{20_000, :retry}, {20_100, {:opened, %{}}}])
      assert :reconnected in actions
    end
  end

  test "the end of a recording is final" do
    {core, actions} = run(up("replay:x.tlog?speed=max"), [{5, {:ended, "all done"}}])
    assert :close in actions
    assert %{status: :ended, text: "all done"} = Snapshot.of(core, 5)

    for event <- [:retry, :start, {:opened, %{}}, {:read, []}],
        do: assert(core == elem(run(core, [{6, event}]), 0))
  end

  test "rates come from the last second, and fall back to nothing" do
    core = up("udpin::1")
    read = {:read, [{:x, attitude(1, 1)}]}
    events = for n <- 0..8, event <- [read, :tick], do: {n * 250, event}
    {core, actions} = run(core, events)
    assert Snapshot.of(core, 2000).rates.frames_in == 4.0
    assert :publish_snapshot in actions
    {core, _} = run(core, for(n <- 9..14, do: {n * 250, :tick}))
    assert Snapshot.of(core, 3500).rates.frames_in == 0.0
    assert {_core, []} = Core.handle(core, :tick, now(3750))
  end

  test "per source loss is in the snapshot (R7)" do
    {core, _} =
      run(
        up("udpin::1"),
        for(n <- [1, 2, 4] ++ Enum.to_list(5..60), do: {n, {:read, [{:x, attitude(1, n)}]}})
      )

    assert %{{1, 1} => %{lost: 1, received: 59}} = Snapshot.of(core, 60).sources
    {core, _} = run(core, [{70_000, :tick}])
    assert core.peers.map == %{}
    assert %{{1, 1} => %{lost: 1}} = Snapshot.of(core, 60).sources
  end

  describe "any events in any order" do
    test "keep the invariants of the state machine" do
      links = elements(["tcp:h:1", "udpin::1", "tcpin::1", "udpout:h:1", "replay:f"])

      property =
        :proper.forall({links, list(event())}, fn {text, events} ->
          events
          |> Enum.with_index()
          |> Enum.scan({core(text, max_peers: 3), :closed, true}, fn {event, n}, {core, conn, _kept?} ->
            {next, actions} = Core.handle(core, event, now(n * 100))
            {next, conn(conn, actions, event), kept?(core, next, actions, conn)}
          end)
          |> Enum.all?(&elem(&1, 2))
        end)

      assert :proper.quickcheck(property, [:quiet, numtests: 500]) == true, inspect(:proper.counterexample())
    end

    # What the process would know about the connection.
    defp conn(conn, actions, event) do
      cond do
        :close in actions -> :closed
        :open in actions -> :opening
        match?({:opened, _}, event) and conn == :opening -> :open
        match?({:failed, _}, event) and conn == :opening -> :closed
        true -> conn
      end
    end

    defp kept?(before, next, actions, conn) do
      waits = for {:retry_in, wait} <- actions, do: wait
      snapshot = Snapshot.of(next, 0)

      # It opens only if nothing is open; a link that is down has exactly one timer.
      Enum.count(actions, &(&1 == :open)) <= 1 and
        (:open not in actions or conn == :closed) and
        (next.phase == :down and before.phase != :down) == (waits != []) and
        Enum.all?(waits, &(&1 in 0..30_000)) and
        map_size(next.peers.map) <= 3 and
        (before.phase != :ended or next.phase == :ended) and
        Enum.all?(
          %MavRouter.Link.Core.Counters{} |> Map.from_struct() |> Map.delete(:messages) |> Map.keys(),
          &(Map.get(Core.counters(next), &1) >= Map.get(Core.counters(before), &1))
        ) and
        is_binary(snapshot.text) and
        (before.phase == :up or for({:deliver, _, _} <- actions, do: 1) == [])
    end

    defp event do
      peer = elements([:remote, 1, 2, 3, 4])

      bytes =
        oneof([
          :proper_types.binary(),
          elements([
            attitude(1, 1),
            attitude(2, 2),
            binary_part(attitude(1, 3), 0, 20),
            attitude(1, 1) <> attitude(1, 2)
          ])
        ])

      frequency([
        {2, :start},
        {4, {:opened, exactly(%{local: "here"})}},
        {2, {:failed, elements([:econnrefused, :timeout, "words", {:weird, 1}])}},
        {1, {:closed, elements([:closed, :econnreset, {:shutdown, :x}])}},
        {4, :retry},
        {4, :tick},
        {6, {:read, list({peer, bytes})}},
        {2, {:records, list({integer(), bytes})}},
        {3, {:peer_up, peer, "a peer"}},
        {2, {:peer_down, peer, :closed}},
        {1, {:ended, "over"}},
        {1, {:count, elements([:dropped_out, :unclaimed]), range(0, 9)}}
      ])
    end
  end
end
