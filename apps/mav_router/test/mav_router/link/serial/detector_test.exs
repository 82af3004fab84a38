defmodule MavRouter.Link.Serial.DetectorTest do
  use ExUnit.Case, async: true

  import Aerie.LinkCase, only: [heartbeat: 1, attitude: 2]
  import :proper_types, except: [binary: 0]

  alias MavRouter.Link.Serial.Detector
  alias MavRouter.Link.Serial.Finding
  alias MavCodec.CRC.DvbS2

  defp port(n, origin \\ :usb), do: %{path: "/dev/p#{n}", key: n, origin: origin}

  # The detector after events, and all their actions.
  defp run(detector \\ Detector.new(), events) do
    Enum.reduce(events, {detector, []}, fn {ms, event}, {detector, actions} ->
      {detector, more} = Detector.handle(detector, event, ms)
      {detector, actions ++ more}
    end)
  end

  # Simulated ports: how each answers the detector's actions, until it has decided. `world` is
  # `%{key => fn baud, ms -> bytes end}` or `{:refuses, reason}`.
  defp live(detector, ports, world, limit \\ 60_000) do
    {detector, actions} = Detector.handle(detector, {:ports, ports}, 0)
    loop(detector, world, %{}, [], actions, 0, [], limit)
  end

  defp loop(_detector, _world, _bauds, _queue, [{:found, key, finding, bytes} | _], now, log, _limit),
    do: {:found, key, finding, bytes, now, Enum.reverse(log)}

  defp loop(_detector, _world, _bauds, _queue, [{:failed, findings} | _], now, log, _limit),
    do: {:failed, findings, now, Enum.reverse(log)}

  defp loop(detector, world, bauds, queue, [action | actions], now, log, limit) do
    {bauds, queue} = answer(action, world, bauds, queue, now)
    loop(detector, world, bauds, queue, actions, now, [action | log], limit)
  end

  defp loop(detector, world, bauds, queue, [], now, log, limit) do
    assert now < limit, "no decision"
    due = Enum.sort_by(queue, &elem(&1, 0), :asc) |> List.first()

    case due do
      {at, key, event} when at <= now + 250 ->
        event = if is_function(event), do: event.(), else: event
        {detector, actions} = Detector.handle(detector, {key, event}, at)
        loop(detector, world, bauds, List.delete(queue, due), actions, max(at, now), log, limit)

      _none ->
        {detector, actions} = Detector.handle(detector, :tick, now + 250)
        loop(detector, world, bauds, queue, actions, now + 250, log, limit)
    end
  end

  defp answer({:open, key, _path, baud}, world, bauds, queue, now) do
    case world[key] do
      {:refuses, reason} -> {bauds, queue ++ [{now, key, {:open_failed, reason}}]}
      :hangs -> {bauds, queue}
      _speaks -> {Map.put(bauds, key, {baud, now}), queue ++ [{now, key, :opened}]}
    end
  end

  defp answer({:set, key, baud}, _world, bauds, queue, now),
    do: {Map.put(bauds, key, {baud, now}), queue ++ [{now + 5, key, :set}]}

  defp answer({:read, key, ms}, world, bauds, queue, now) do
    {baud, _since} = bauds[key]

    said =
      if is_function(world[key], 3),
        do: world[key].(baud, now, bauds[{key, :asked}]),
        else: world[key].(baud, now)

    {bauds, queue ++ [{now + max(ms, 1), key, {:read, said}}]}
  end

  defp answer({:write, key, bytes}, _world, bauds, queue, _now),
    do: {Map.put(bauds, {key, :asked}, {elem(bauds[key], 0), bytes}), queue}

  defp answer({:close, key}, _world, bauds, queue, _now),
    do: {bauds, Enum.reject(queue, &(elem(&1, 1) == key))}

  defp at_baud(right, bytes), do: fn baud, _ms -> if baud == right, do: bytes, else: noise(baud) end
  defp noise(seed), do: for(n <- 1..100, into: "", do: <<:erlang.phash2({seed, n}, 256)>>)
  defp silent, do: fn _baud, _ms -> "" end
  # Once a second, and only then.
  defp seconds(right) do
    fn baud, ms ->
      if rem(ms, 1000) < 250,
        do: if(baud == right, do: heartbeat(1), else: binary_part(noise(baud), 0, 30)),
        else: ""
    end
  end

  test "the first port with a heartbeat wins, at its baud rate; the others are closed" do
    world = %{1 => silent(), 2 => at_baud(921_600, attitude(1, 1) <> heartbeat(1)), 3 => silent()}
    assert {:found, 2, finding, bytes, ms, log} = live(Detector.new(), [port(1), port(2), port(3)], world)
    assert %Finding{path: "/dev/p2", condition: :vehicle, protocol: :mavlink2, baud: 921_600} = finding
    assert bytes =~ heartbeat(1)
    assert ms < 5_000
    assert [{:open, 1, "/dev/p1", 57_600}, {:open, 2, _, _}, {:open, 3, _, _} | _] = log
    closed = for {:close, key} <- log, do: key
    assert Enum.sort(closed) == [1, 3]
  end

  test "heartbeats once a second are found at every candidate rate" do
    for right <- Detector.bauds() do
      assert {:found, 1, %{baud: ^right}, _, ms, _log} =
               live(Detector.new(), [port(1)], %{1 => seconds(right)})

      assert ms < 20_000
    end
  end

  test "at 57600 and 115200 within five seconds, even with one heartbeat a second" do
    for right <- [57_600, 115_200, 921_600] do
      assert {:found, 1, _, _, ms, _} = live(Detector.new(), [port(1)], %{1 => seconds(right)})
      assert ms <= 5_000
    end
  end

  test "what was right the last time is tried first" do
    detector = Detector.new(hint: %{path: "/dev/p2", baud: 38_400})

    assert {:found, 2, %{baud: 38_400}, _, ms, log} =
             live(detector, [port(1), port(2)], %{1 => silent(), 2 => seconds(38_400)})

    assert ms <= 1_500
    assert [{:open, 2, _, 38_400}, {:open, 1, _, 38_400} | _] = log
  end

  test "configured ports are tried first, and alone" do
    ports = [port(1, :configured), port(2), port(3, :configured)]
    both = at_baud(57_600, heartbeat(1))
    assert {:found, 3, _, _, _, log} = live(Detector.new(), ports, %{1 => silent(), 2 => both, 3 => both})
    refute Enum.any?(log, &match?({:open, 2, _, _}, &1))

    assert {:found, 2, _, _, ms, log} =
             live(Detector.new(), ports, %{1 => silent(), 2 => both, 3 => {:refuses, :enoent}})

    assert Enum.find_index(log, &(&1 == {:close, 1})) < Enum.find_index(log, &match?({:open, 2, _, _}, &1))
    assert ms in 4_800..7_000
  end

  describe "a search for MSP (Q3)" do
    # Speaks when it is asked at this rate.
    defp answers(right, reply) do
      fn
        ^right, _ms, {^right, "$M<" <> <<0, 2, 2>>} -> reply
        _baud, _ms, _asked -> ""
      end
    end

    defp variant(name), do: msp(:reply, name)

    defp msp(direction, payload),
      do:
        IO.iodata_to_binary(
          MavCodec.Msp.Frame.encode(%MavCodec.Msp.Frame{direction: direction, id: 2, payload: payload})
        )

    test "asks ports where nothing comes, each rate once; the one that answers as Betaflight or iNav is it" do
      for {name, right} <- [{"BTFL", 115_200}, {"INAV", 57_600}, {"BTFL", 921_600}] do
        world = %{1 => silent(), 2 => answers(right, variant(name)), 3 => silent()}

        assert {:found, 2, %{condition: :vehicle, baud: ^right} = finding, "", ms, log} =
                 live(Detector.new(ask: true), [port(1), port(2), port(3)], world)

        assert Finding.format(finding) =~ ~r/MSP v1 at \d+ baud, answers as (Betaflight|iNav)/
        assert ms < 17_000
        asked = for {:write, 2, bytes} <- log, do: bytes
        assert length(asked) in 1..3 and Enum.uniq(asked) == ["$M<" <> <<0, 2, 2>>]
      end
    end

    test "a port where MAVLink, NMEA or anything else comes is never asked" do
      nmea = "$GPGLL,5057.970,N,00146.110,E,142451,A*27\r\n"

      for {says, why} <- [
            {heartbeat(1), "it speaks MAVLink"},
            {nmea, "NMEA"},
            {noise(7), "no known protocol"}
          ] do
        assert {:failed, [finding], _ms, log} =
                 live(Detector.new(ask: true), [port(1)], %{1 => fn _baud, _ms -> says end})

        assert Finding.format(finding) =~ why
        refute Enum.any?(log, &match?({:write, _, _}, &1))
      end
    end

    test "a vehicle whose heartbeats come once in one, two, five or ten seconds is never asked, whatever its rate" do
      for period <- [1_000, 2_000, 5_000, 10_000],
          right <- [57_600, 115_200, 921_600, 9_600],
          first <- [0, 700, 9_900] do
        {:ok, last} = Agent.start_link(fn -> -1 end)

        # What came since it was read last, as it is read at this rate.
        says = fn baud, ms ->
          n = if ms < first, do: -1, else: div(ms - first, period)
          came? = Agent.get_and_update(last, &{n > &1, n})
          if(came?, do: if(baud == right, do: heartbeat(1), else: binary_part(noise(baud), 0, 1)), else: "")
        end

        assert {:failed, [finding], _ms, log} = live(Detector.new(ask: true), [port(1)], %{1 => says})
        refute Enum.any?(log, &match?({:write, _, _}, &1))
        refute finding.condition == :silent
      end
    end

    test "ports of the second turn are asked too" do
      ports = [port(1, :configured), port(2)]
      world = %{1 => silent(), 2 => answers(921_600, variant("BTFL"))}
      assert {:found, 2, %{baud: 921_600}, "", _ms, _log} = live(Detector.new(ask: true), ports, world)
    end

    test "what answers otherwise is named" do
      for {reply, why} <- [
            {variant("ARDU"), ~s(answers as "ARDU")},
            {variant(<<0, 1, 255>>), ~s(answers as "")},
            {msp(:request, ""), "our own question comes back"},
            {"$M<", "our own question comes back"},
            {msp(:error, ""), "MSP v1"},
            {"what?\r\n", "115200"}
          ] do
        assert {:failed, [finding], _ms, _log} =
                 live(Detector.new(ask: true), [port(1)], %{1 => answers(115_200, reply)})

        assert Finding.format(finding) =~ why
      end

      assert {:failed, [%{condition: :silent}], _ms, _log} =
               live(Detector.new(ask: true), [port(1)], %{1 => silent()})
    end

    test "only a search for MSP asks" do
      assert {:failed, _findings, _ms, log} =
               live(Detector.new(), [port(1)], %{1 => answers(115_200, variant("BTFL"))})

      refute Enum.any?(log, &match?({:write, _, _}, &1))
    end
  end

  test "of two ports of one flight controller it is always the first" do
    speaks = at_baud(57_600, heartbeat(1))
    late = fn baud, ms -> if ms > 300, do: speaks.(baud, ms), else: "" end
    assert {:found, 1, _, _, _, _} = live(Detector.new(), [port(1), port(2)], %{1 => late, 2 => speaks})
    # But it does not wait for long.
    assert {:found, 2, _, _, ms, _} = live(Detector.new(), [port(1), port(2)], %{1 => silent(), 2 => speaks})
    assert ms < 1_000
  end

  test "every condition is named, with evidence and advice" do
    statistics = <<0x14, 16, 19, 99, 151, 1, 2, 3, 8, 88, 148>>
    crsf = <<0xC8, 12, statistics::binary, DvbS2.of(statistics)>>

    world = %{
      1 => silent(),
      2 => at_baud(9_600, :binary.copy("$GPGLL,5057.970,N,00146.110,E,142451,A*27\r\n", 20)),
      3 => at_baud(420_000, :binary.copy(crsf, 60)),
      4 => at_baud(115_200, "$M>\x03\x01\x00\x01.-"),
      5 => at_baud(115_200, "nsh> ps\r\n  PID COMMAND\r\n    0 Idle Task\r\n"),
      6 => fn baud, _ms -> noise(baud) end,
      7 => at_baud(57_600, attitude(1, 1)),
      8 => {:refuses, :eacces},
      9 => {:refuses, {:in_use, "mavproxy.py (process 812)"}},
      10 => {:refuses, :enotty},
      11 => :hangs
    }

    assert {:failed, findings, ms, _log} = live(Detector.new(), Enum.map(1..11, &port/1), world)
    assert ms <= 20_250

    assert [
             %{condition: :silent, advice: "is it powered" <> _},
             %{
               condition: :other_protocol,
               protocol: :nmea,
               baud: 9_600,
               advice: "this is a GPS receiver" <> _
             },
             %{
               condition: :other_protocol,
               protocol: :crsf,
               baud: 420_000,
               advice: "this is the line between radio" <> _
             },
             %{condition: :other_protocol, protocol: :msp1, baud: 115_200},
             %{condition: :other_protocol, protocol: :console, baud: 115_200, evidence: "PX4's console" <> _},
             %{condition: :noise, advice: "give the baud rate" <> _},
             %{condition: :no_heartbeat, protocol: :mavlink2, baud: 57_600},
             %{condition: :no_permission, advice: "add the user to the group dialout" <> _},
             %{condition: :in_use, evidence: "in use by mavproxy.py (process 812)"},
             %{condition: :not_serial},
             %{condition: :fault, evidence: "opening it takes too long"}
           ] = findings

    text = Finding.summary(findings)
    assert text =~ "no vehicle heard: /dev/p1: nothing in"
    assert text =~ "/dev/p2: NMEA at 9600 baud, "
    assert text =~ "; and 7 ports more"
    for finding <- findings, do: assert(String.printable?(Finding.format(finding)))
  end

  test "a silent port takes five seconds, no port none" do
    assert {:failed, [%{condition: :silent}], ms, _} = live(Detector.new(), [port(1)], %{1 => silent()})
    assert ms in 4_800..6_300
    assert {:failed, [], 0, []} = live(Detector.new(), [], %{})
    assert Finding.summary([]) =~ "no serial port found"

    assert {:failed, [%{condition: :silent}], _, _} =
             live(Detector.new(bauds: [57_600]), [port(1)], %{1 => silent()})
  end

  test "waits for the end of boot text: MAVLink follows on the same line" do
    boots = at_baud(115_200, "Init ArduCopter V4.6.3 (92b0cd78)\n\nFree RAM: 524288\n")

    world = fn baud, ms ->
      if ms < 4_000, do: boots.(baud, ms), else: at_baud(115_200, heartbeat(1)).(baud, ms)
    end

    assert {:found, 1, %{baud: 115_200}, _, ms, _} = live(Detector.new(), [port(1)], %{1 => world})
    assert ms < 5_000
  end

  test "a port that comes during the search joins it" do
    {detector, actions} =
      run([{0, {:ports, [port(1)]}}, {1, {1, :opened}}, {900, {:ports, [port(1), port(2)]}}])

    assert [{:open, 1, _, _}, {:read, 1, _}, {:open, 2, "/dev/p2", _}] = actions

    {_detector, actions} =
      run(detector, [{901, {2, :opened}}, {950, {2, {:read, heartbeat(1)}}}, {1_600, :tick}])

    assert {:found, 2, _, _} = List.last(actions)
  end

  test "a port that is in use is tried again for two seconds" do
    {detector, actions} =
      run([{0, {:ports, [port(1)]}}, {1, {1, {:open_failed, :eagain}}}, {250, :tick}, {251, {1, :opened}}])

    assert [{:open, 1, "/dev/p1", 57_600}, {:open, 1, "/dev/p1", 57_600}, {:read, 1, _}] = actions
    assert {_, [{:found, 1, _, _}]} = run(detector, [{300, {1, {:read, heartbeat(1)}}}])

    {_, actions} = run([{0, {:ports, [port(1)]}}, {2_000, {1, {:open_failed, :ebusy}}}])
    assert [_, {:close, 1}, {:failed, [%{condition: :in_use}]}] = actions
  end

  test "a port that does not support the first rate is opened at the next; one that supports none is reported" do
    {detector, actions} =
      run([{0, {:ports, [port(1)]}}, {1, {1, {:open_failed, :einval}}}, {2, {1, :opened}}])

    assert [{:open, 1, path, 57_600}, {:open, 1, path, 115_200}, {:read, 1, _}] = actions
    assert {_, [{:found, 1, %{baud: 115_200}, _}]} = run(detector, [{300, {1, {:read, heartbeat(1)}}}])

    none = for n <- 1..length(Detector.bauds()), do: {n, {1, {:open_failed, :einval}}}
    {_, actions} = run([{0, {:ports, [port(1)]}} | none])

    assert {:failed, [%{condition: :fault, evidence: "it supports none of the baud rates"}]} =
             List.last(actions)
  end

  test "a rate that a port does not support is skipped; an unplugged port is reported" do
    {_detector, actions} =
      run([
        {0, {:ports, [port(1)]}},
        {0, {1, :opened}},
        {1_200, {1, {:read, ""}}},
        {1_201, {1, {:set_failed, :einval}}},
        {1_202, {1, :set}},
        {1_300, {1, {:read_failed, :eio}}}
      ])

    assert [
             {:open, _, _, 57_600},
             _,
             {:set, 1, 115_200},
             {:set, 1, 921_600},
             _,
             {:close, 1},
             {:failed, [finding]}
           ] = actions

    assert %{condition: :fault, evidence: "unplugged"} = finding
  end

  # What a port may send: one of these, for any time, in any order.
  defp event do
    bytes =
      oneof([
        :proper_types.binary(),
        heartbeat(1),
        attitude(1, 1),
        "nsh> help me please\r\n",
        "$M>\x03\x01\x00\x01.-"
      ])

    event =
      oneof([
        :opened,
        :set,
        {:read, bytes},
        {:read, ""},
        {:open_failed, oneof([:enoent, :eacces, :ebusy, :eagain, "words"])},
        {:set_failed, oneof([:einval, :eio])},
        {:read_failed, :eio},
        {:failed, :killed}
      ])

    oneof([
      {integer(1, 4), event},
      {1, {:read, heartbeat(1)}},
      :tick,
      {:ports, :proper_types.list(oneof([port(1, :configured), port(2, :by_id), port(3), port(4)]))}
    ])
  end

  test "whatever happens: no port is written to or left open, and the search ends" do
    property =
      :proper.forall(:proper_types.list({integer(0, 400), event()}), fn steps ->
        {events, _} = Enum.map_reduce(steps, 0, fn {wait, event}, at -> {{at + wait, event}, at + wait} end)
        {detector, actions} = run([{0, {:ports, [port(1, :configured), port(2)]}} | events])
        late = Enum.max([0 | Enum.map(events, &elem(&1, 0))]) + 60_000
        {_detector, last} = run(detector, for(n <- 0..3, do: {late + n * 1000, :tick}))
        all = actions ++ last

        only_known?(all) and ends_once?(all) and closed?(all) and deserved?(all, events)
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 400]) == true, inspect(:proper.counterexample())
  end

  defp only_known?(actions),
    do: Enum.all?(actions, &(elem(&1, 0) in [:open, :set, :read, :close, :found, :failed]))

  # With one result, which is the last action.
  defp ends_once?(actions) do
    Enum.count(actions, &(elem(&1, 0) in [:found, :failed])) == 1 and
      elem(List.last(actions), 0) in [:found, :failed]
  end

  defp closed?(actions) do
    opened = for {:open, key, _, _} <- actions, do: key
    closed = for {:close, key} <- actions, do: key
    kept = for {:found, key, _, _} <- actions, do: key
    Enum.sort(Enum.uniq(opened)) == Enum.sort(closed ++ kept)
  end

  # Found only where there was a heartbeat.
  defp deserved?(actions, events) do
    Enum.all?(actions, fn
      {:found, key, %{condition: :vehicle}, bytes} ->
        byte_size(bytes) <= 4_096 and
          Enum.any?(events, fn {_at, event} -> event == {key, {:read, heartbeat(1)}} end)

      _other ->
        true
    end)
  end
end
