defmodule MavRouter.Router.PureTest do
  @moduledoc "The router's values: properties against what they promise."
  use ExUnit.Case, async: true

  import :proper_types, only: [list: 1, elements: 1, range: 2, oneof: 1, non_empty: 1, binary: 1]

  alias MavRouter.Endpoints.Output.Batch
  alias MavRouter.Endpoints.Queue.Budget
  alias MavRouter.Endpoints.Queue.TrafficClass
  alias MavRouter.Forward.Dedupe
  alias MavRouter.Endpoints.Owner.Filter
  alias MavRouter.Endpoints.Queue.SendQueue
  alias MavRouter.Endpoints.Owner
  alias MavRouter.Endpoints.Queue.ClassQueue
  alias MavRouter.Endpoints.Owner.RateLimit
  alias MavRouter.Routes.Score
  alias MavRouter.Tables
  alias MavCodec.Frame

  defp check(property, n \\ 200), do: assert(:proper.quickcheck(property, [:quiet, numtests: n]) == true)

  describe "ForwardingTable" do
    alias MavRouter.Endpoints.Endpoint
    alias MavRouter.Endpoints
    alias MavRouter.Routes
    alias MavRouter.Forward.Table

    defp tables do
      # Where endpoints tell that they are there is not needed here.
      name = {__MODULE__, make_ref()}
      :ok = Aerie.Base.Names.register(name, :router, nil)
      {name, Tables.create(name, [])}
    end

    test "brought up to date it is what reading it again gives, whatever changed" do
      :proper.forall(list({range(1, 5), elements([:put, :remove, :vehicle, :client, :owner])}), fn steps ->
        {gateway, tables} = tables()
        {:ok, owner} = Owner.new("l", side: :vehicle, networks: ["main"])
        Endpoints.put_owner(tables, owner)

        {forwarding, _} =
          Enum.reduce(steps, {Table.read(tables), 0}, fn {n, what}, {forwarding, skipped} ->
            key = {"l", n}

            case what do
              :put -> Endpoints.put(gateway, tables, Endpoint.new(gateway, key, out: {:pid, self(), n}))
              :remove -> Endpoints.remove(tables, key)
              :vehicle -> Endpoints.note(tables, key, side: nil, heard_vehicle: true)
              :client -> Endpoints.note(tables, key, side: :client, heard_vehicle: false)
              :owner -> Endpoints.put_owner(tables, owner)
            end

            # Several changes are taken in at once as well.
            if rem(skipped + n, 3) == 0,
              do: {forwarding, skipped + 1},
              else: {Table.refresh(forwarding, tables), skipped}
          end)

        forwarding = Table.refresh(forwarding, tables)
        Map.delete(forwarding, :audience) == Map.delete(Table.read(tables), :audience)
      end)
      |> check()
    end

    test "one more endpoint costs as much among a thousand as among ten" do
      work = fn others ->
        {gateway, tables} = tables()
        {:ok, owner} = Owner.new("l", side: :vehicle, networks: ["main"])
        Endpoints.put_owner(tables, owner)
        put = &Endpoints.put(gateway, tables, Endpoint.new(gateway, {"l", &1}, heard_vehicle: true))
        for n <- 1..others, do: put.(n)
        forwarding = Table.read(tables)
        put.(:new)
        {:reductions, before} = Process.info(self(), :reductions)
        forwarding = Table.refresh(forwarding, tables)
        {:reductions, later} = Process.info(self(), :reductions)
        assert map_size(forwarding.paths) == others + 1
        later - before
      end

      assert work.(1_000) < 3 * work.(10) + 500
    end

    test "the routes of one peer are forgotten without a look at the others'" do
      {_gateway, tables} = tables()
      for n <- 1..5_000, do: Routes.learn(tables, "main", n, 1, {"l", n}, 0)
      {:reductions, before} = Process.info(self(), :reductions)
      Routes.forget(tables, "l", 17)
      {:reductions, later} = Process.info(self(), :reductions)
      assert later - before < 500
      refute Routes.known?(tables, {"main", 17})
      assert length(Routes.list(tables, 0)) == 4_999
      Routes.forget_system(tables, {"main", 18}, :_, :_)
      Routes.sweep(tables, 1)
      assert :ets.info(tables.heard_by, :size) == :ets.info(tables.routes, :size)
    end
  end

  describe "Classify" do
    test "every message has a class, and what flies comes before what can wait" do
      for id <- MavCodec.Dialects.All.ids(), do: assert(TrafficClass.of(id) in TrafficClass.classes())
      of = &TrafficClass.of(MavCodec.Dialects.All.message_id(&1))

      assert Enum.map(~w(COMMAND_LONG COMMAND_ACK ATTITUDE PARAM_VALUE LOG_DATA), of) ==
               TrafficClass.classes()

      assert TrafficClass.of(0xABCDEF) == :state

      assert for(class <- TrafficClass.classes(), do: TrafficClass.parse(Atom.to_string(class))) ==
               TrafficClass.classes()
    end

    test "runs are the frames, cut where the class changes" do
      :proper.forall(non_empty(list(elements([0, 30, 33, 77, 22, 120]))), fn ids ->
        frames = for {id, n} <- Enum.with_index(ids), do: %Frame{id: id, bytes: <<n>>}
        runs = TrafficClass.runs(frames)

        Enum.flat_map(runs, &elem(&1, 1)) == Enum.map(frames, & &1.bytes) and
          Enum.all?(runs, fn {_class, bytes, n} -> length(bytes) == n end) and
          Enum.flat_map(runs, fn {class, _, n} -> List.duplicate(class, n) end) ==
            Enum.map(ids, &TrafficClass.of/1) and
          Enum.chunk_every(runs, 2, 1, :discard) |> Enum.all?(fn [a, b] -> elem(a, 0) != elem(b, 0) end)
      end)
      |> check()
    end
  end

  describe "Batch" do
    test "datagrams hold all frames whole, in order, and are as large as they may be" do
      :proper.forall(non_empty(list(range(12, 280))), fn sizes ->
        frames =
          for {size, n} <- Enum.with_index(sizes), do: %Frame{bytes: :binary.copy(<<rem(n, 256)>>, size)}

        %{datagrams: datagrams} = frames |> Batch.new() |> Batch.packed()
        joined = frames |> Enum.map(& &1.bytes) |> IO.iodata_to_binary()
        ends = frames |> Enum.scan(0, fn frame, at -> at + byte_size(frame.bytes) end) |> scan_ends(frames)
        cuts = datagrams |> Enum.map(&byte_size/1) |> Enum.scan(&(&1 + &2))

        IO.iodata_to_binary(datagrams) == joined and Enum.all?(cuts, &(&1 in ends)) and
          Enum.all?(datagrams, &(byte_size(&1) <= Batch.datagram())) and
          Enum.chunk_every(datagrams, 2, 1, :discard)
          |> Enum.all?(fn [a, b] -> byte_size(a) + byte_size(b) > 920 end)
      end)
      |> check()
    end
  end

  defp scan_ends(_unused, frames), do: frames |> Enum.map(&byte_size(&1.bytes)) |> Enum.scan(&(&1 + &2))

  describe "Filter" do
    test "passes what a plain reading of the lists passes" do
      axis = fn values -> oneof([[], list(elements(values))]) end

      spec =
        {axis.([0, 30]), axis.([0, 30]), axis.([1, 2]), axis.([1, 2]), axis.([1, 154]), axis.([1, 154]),
         axis.(["a"]), axis.(["a"])}

      frame = {elements([0, 30, 33]), elements([1, 2, 3]), elements([1, 154, 0]), elements(["a", "b"])}

      :proper.forall({spec, frame}, fn {{am, bm, as, bs, ac, bc, ao, bo}, {id, system, component, source}} ->
        {:ok, filter} =
          Filter.compile(%{
            allow_messages: am,
            block_messages: bm,
            allow_systems: as,
            block_systems: bs,
            allow_components: ac,
            block_components: bc,
            allow_sources: ao,
            block_sources: bo
          })

        expected =
          Enum.all?([{am, bm, id}, {as, bs, system}, {ac, bc, component}, {ao, bo, source}], fn {allow, block,
                                                                                                 value} ->
            (allow == [] or value in allow) and value not in block
          end)

        Filter.pass?(filter, %Frame{id: id, system: system, component: component}, source) == expected
      end)
      |> check(500)
    end

    test "takes names in any case and ids; says what it does not know; an empty one is nothing" do
      assert Filter.compile(%{allow_messages: [], block_systems: nil}) == {:ok, nil}
      {:ok, filter} = Filter.compile(%{block_messages: ["attitude", 33, "24"]})

      for {id, passes} <- [{30, false}, {33, false}, {24, false}, {0, true}],
          do: assert(Filter.pass?(filter, %Frame{id: id}, "") == passes)

      for bad <- [
            %{block_messages: ["ATITUDE"]},
            %{allow_systems: [-1]},
            %{allow_components: [256]},
            %{x: []},
            %{allow_systems: 1},
            []
          ] do
        assert {:error, words} = Filter.compile(bad)
        assert is_binary(words)
      end
    end
  end

  describe "RateLimit" do
    test "over any time no more than the rate and one, and never long without when there is enough" do
      :proper.forall({range(1, 100), non_empty(list(range(0, 50_000)))}, fn {hz, gaps} ->
        {:ok, limits} = RateLimit.compile(%{"ATTITUDE" => hz})
        interval = limits[30]
        times = Enum.scan(gaps, &(&1 + &2))

        {passed, _} =
          Enum.flat_map_reduce(times, nil, fn now, due ->
            case RateLimit.pass(due, interval, now) do
              {:pass, due} -> {[now], due}
              :drop -> {[], due}
            end
          end)

        Enum.all?(Enum.with_index(passed), fn {from, i} ->
          passed
          |> Enum.drop(i)
          |> Enum.with_index(1)
          |> Enum.all?(fn {to, n} -> n <= (to - from) / interval + 2 end)
        end) and hd(times) == hd(passed)
      end)
      |> check()
    end

    test "a regular source loses nothing at its own rate, and half at half of it" do
      {:ok, limits} = RateLimit.compile(%{30 => 10})

      passed = fn times ->
        Enum.reduce(times, {0, nil}, fn now, {n, due} ->
          case RateLimit.pass(due, limits[30], now) do
            {:pass, due} -> {n + 1, due}
            :drop -> {n, due}
          end
        end)
        |> elem(0)
      end

      assert passed.(for i <- 0..99, do: i * 100_000 + rem(i * 7919, 20_000)) == 100
      assert passed.(for i <- 0..199, do: i * 50_000) in 100..101
      {:ok, %{30 => never}} = RateLimit.compile(%{30 => 0})
      assert {:pass, due} = RateLimit.pass(nil, never, 0)
      assert RateLimit.pass(due, never, 86_400_000_000) == :drop
      assert RateLimit.compile(%{}) == {:ok, nil}

      for bad <- [%{"X" => 1}, %{30 => -1}, %{30 => "fast"}, :all],
          do: assert({:error, _} = RateLimit.compile(bad))
    end
  end

  describe "Queue" do
    test "bounded; drops the oldest of the least; within a class nothing is overtaken or lost but what was told" do
      step = oneof([{:push, elements(TrafficClass.classes()), range(1, 300)}, :pop])

      :proper.forall(list(step), fn steps ->
        start =
          {ClassQueue.new(max_frames: 10, max_bytes: 1_000), Map.new(TrafficClass.classes(), &{&1, []}), true}

        {_queue, _model, ok} =
          Enum.reduce(Enum.with_index(steps), start, fn
            {{:push, class, size}, n}, {queue, model, ok} ->
              frame = <<n::32, 0::size(size * 8)>>
              {queue, dropped} = ClassQueue.push(queue, class, [frame], 0)
              model = Map.update!(model, class, &(&1 ++ [frame]))

              model =
                Enum.reduce(dropped, model, fn {class, count}, model ->
                  Map.update!(model, class, &Enum.drop(&1, count))
                end)

              {queue, model, ok and sane?(queue, model, dropped)}

            {:pop, _n}, {queue, model, ok} ->
              case {ClassQueue.pop(queue, 0), Enum.find(TrafficClass.classes(), &(model[&1] != []))} do
                {nil, nil} ->
                  {queue, model, ok}

                {{{class, frame}, queue}, class} ->
                  {queue, Map.update!(model, class, &tl/1), ok and hd(model[class]) == frame}

                _other ->
                  {queue, model, false}
              end
          end)

        ok
      end)
      |> check(300)
    end

    defp sane?(queue, model, dropped) do
      depth = Map.new(queue.waiting, fn {class, waiting} -> {class, :queue.len(waiting)} end)
      rank = fn class -> Enum.find_index(TrafficClass.classes(), &(&1 == class)) end
      least = TrafficClass.classes() |> Enum.reverse() |> Enum.find(&(depth[&1] > 0))
      all = model |> Map.values() |> Enum.concat()

      queue.frames <= 10 and queue.bytes <= 1_000 and
        depth == Map.new(model, fn {class, list} -> {class, length(list)} end) and
        queue.bytes == Enum.sum_by(all, &byte_size/1) and
        Enum.all?(dropped, fn {class, _n} -> least == nil or rank.(class) >= rank.(least) end)
    end

    test "what waited for a second is next, whatever its class" do
      {queue, %{}} = ClassQueue.push(ClassQueue.new(), :bulk, ["old"], 0)
      {queue, %{}} = ClassQueue.push(queue, :control, ["a", "b"], 999)
      assert {{:control, "a"}, _} = ClassQueue.pop(queue, 999)
      assert {{:bulk, "old"}, queue} = ClassQueue.pop(queue, 1_000)
      assert {{:control, "a"}, _} = ClassQueue.pop(queue, 1_000)
    end
  end

  describe "Budget and Outlet" do
    test "never more than the rate, one burst and one frame; nothing waits while there is room" do
      :proper.forall({range(100, 50_000), non_empty(list({range(0, 500), range(12, 280)}))}, fn {rate, steps} ->
        {budget, sent, now, ok} =
          Enum.reduce(steps, {Budget.new(rate, 0), 0, 0, true}, fn {gap, size}, {budget, sent, now, ok} ->
            now = now + gap
            budget = Budget.fill(budget, now)
            waited = Budget.fill(budget, now + Budget.wait_ms(budget))
            ok = ok and Budget.open?(waited)

            if Budget.open?(budget),
              do: {Budget.spend(budget, size), sent + size, now, ok},
              else: {budget, sent, now, ok}
          end)

        ok and sent <= rate * now / 1000 + budget.capacity + 280
      end)
      |> check()
    end

    test "a radio without room slows it down, one with room lets it go again, never beyond the line (RADIO_STATUS)" do
      budget = Budget.new(Budget.of_baud(57_600), 0)
      slow = Enum.reduce(1..50, budget, fn _, budget -> Budget.radio(budget, 5, 0) end)
      assert_in_delta Budget.rate(slow), 5760 * 0.05, 0.1
      fast = Enum.reduce(1..50, slow, fn _, budget -> Budget.radio(budget, 100, 0) end)
      assert Budget.rate(fast) == 5760
      assert Budget.radio(slow, 255, 0) == slow
      # A radio that was exchanged, or does not report any more, does not leave its link slow for good.
      assert Budget.rate(Budget.fill(slow, 10_000)) == Budget.rate(slow)
      assert Budget.rate(Budget.fill(slow, 10_001)) == 5760
    end

    test "what is important goes first through a line that is too slow, and all that is shed is counted" do
      send_queue = SendQueue.new([bytes_per_s: 1_000, queue: [max_frames: 50]], 0)

      {sent, send_queue, dropped} =
        Enum.reduce(0..999, {[], send_queue, %{}}, fn ms, {sent, send_queue, dropped} ->
          {send_queue, d1} = SendQueue.push(send_queue, :bulk, [:binary.copy("b", 100)], ms)

          {send_queue, d2} =
            if rem(ms, 100) == 0,
              do: SendQueue.push(send_queue, :control, [:binary.copy("c", 20)], ms),
              else: {send_queue, %{}}

          dropped =
            dropped |> Map.merge(d1, fn _, a, b -> a + b end) |> Map.merge(d2, fn _, a, b -> a + b end)

          case SendQueue.next(send_queue, ms) do
            {:send, bytes, send_queue} -> {[IO.iodata_to_binary(bytes) | sent], send_queue, dropped}
            _wait -> {sent, send_queue, dropped}
          end
        end)

      sent = IO.iodata_to_binary(sent)
      assert sent |> String.graphemes() |> Enum.count(&(&1 == "c")) >= 9 * 20
      assert byte_size(sent) <= 1_000 + 300 + 100
      assert Map.keys(dropped) == [:bulk]
      assert (dropped.bulk + send_queue.queue.frames + div(byte_size(sent), 100)) in 995..1010
    end

    test "what could not be written stays" do
      send_queue = SendQueue.new([], 0)
      assert SendQueue.free?(send_queue)
      assert SendQueue.next(send_queue, 0) == :empty
      {send_queue, %{}} = SendQueue.push(send_queue, :state, ["one", "two"], 0)
      refute SendQueue.free?(send_queue)
      assert {:send, ["one", "two"], rest} = SendQueue.next(send_queue, 0)
      assert SendQueue.free?(rest)
      assert {:send, ["one", "two"], _} = SendQueue.next(send_queue, 0)
    end
  end

  describe "Score" do
    test "better in every way is never worse" do
      reading = {range(0, 100), range(0, 2_000), range(0, 60_000)}

      :proper.forall({reading, reading}, fn {{l1, r1, a1}, {l2, r2, a2}} ->
        of = fn l, r, a -> Score.of(%{loss: l / 100, rtt_ms: r, age_ms: a}) end
        best = of.(min(l1, l2), min(r1, r2), min(a1, a2))
        best >= of.(l1, r1, a1) and best >= of.(l2, r2, a2) and best <= 100 and of.(l1, r1, a1) >= 0
      end)
      |> check()
    end

    test "two that are about as good do not take turns; a better one is taken, a useless one is left" do
      choice = Score.choose(Score.none(), %{"a" => 80.0, "b" => 80.0})
      assert choice.link == "a"
      jitter = for n <- 1..50, do: %{"a" => 80.0 + rem(n * 7, 5), "b" => 80.0 + rem(n * 11, 5)}
      assert Enum.reduce(jitter, choice, &Score.choose(&2, &1)).link == "a"
      assert Score.choose(choice, %{"a" => 80.0, "b" => 95.0}).link == "b"

      slightly =
        Enum.scan(1..3, choice, fn _, choice -> Score.choose(choice, %{"a" => 80.0, "b" => 86.0}) end)

      assert Enum.map(slightly, & &1.link) == ["a", "a", "b"]
      assert Score.choose(choice, %{"a" => 2.0, "b" => 6.0}).link == "b"
      assert Score.choose(choice, %{"b" => 1.0}).link == "b"
      assert Score.choose(choice, %{}).link == nil
    end
  end

  describe "Dedupe" do
    setup do
      :ok = Aerie.Base.Names.register(make_ref(), :router, nil)
      gateway = make_ref()
      :ok = Aerie.Base.Names.register(gateway, :router, nil)
      {:ok, tables: Tables.create(gateway, []), now: System.monotonic_time(:millisecond)}
    end

    test "the same bytes from another endpoint are a duplicate, from the same one they are not (R7)", c do
      refute Dedupe.duplicate?(c.tables, "frame", :a, :related, c.now)
      assert Dedupe.duplicate?(c.tables, "frame", :b, :related, c.now + 100)
      refute Dedupe.duplicate?(c.tables, "frame", :a, :related, c.now + 100)
      refute Dedupe.duplicate?(c.tables, "other", :b, :related, c.now + 100)
    end

    test "from the same one again and again it goes round in a loop", c do
      passed = for n <- 0..40, do: not Dedupe.duplicate?(c.tables, "frame", :a, :related, c.now + n * 100)
      # Also after what is remembered was turned over.
      assert passed == List.duplicate(true, 16) ++ List.duplicate(false, 25)
      # Not for ever: an hour later it is news.
      passed = for n <- 0..99, do: not Dedupe.duplicate?(c.tables, "slow", :a, :related, c.now + n * 300)
      assert Enum.all?(passed)
      refute Dedupe.duplicate?(c.tables, "tick", :a, :related, c.now + 10_000)
      refute Dedupe.duplicate?(c.tables, "tick", :a, :related, c.now + 20_000)
      refute Dedupe.duplicate?(c.tables, "frame", :a, :related, c.now + 30_000)
    end

    test "what was only noted is a duplicate from elsewhere, and none from where it came", c do
      :ok = Dedupe.note(c.tables, "order", :a, :related, c.now)
      :ok = Dedupe.note(c.tables, "order", :a, :related, c.now)
      refute Dedupe.duplicate?(c.tables, "order", :a, :related, c.now)
      assert Dedupe.duplicate?(c.tables, "order", :b, :related, c.now)
    end

    test "is forgotten after a second, remembered for half of one", c do
      refute Dedupe.duplicate?(c.tables, "frame", :a, :related, c.now)
      assert Dedupe.duplicate?(c.tables, "frame", :b, :related, c.now + 499)
      for ms <- [600, 1_200, 1_800], do: Dedupe.duplicate?(c.tables, "tick", :a, :related, c.now + ms)
      refute Dedupe.duplicate?(c.tables, "frame", :b, :related, c.now + 1_900)
    end

    test "what somebody sends who may not command suppresses no command, nor a client a vehicle's telemetry",
         c do
      refute Dedupe.duplicate?(c.tables, "frame", :stranger, :clients, c.now)
      refute Dedupe.duplicate?(c.tables, "frame", :operator, :cleared, c.now)
      refute Dedupe.duplicate?(c.tables, "frame", :vehicle, :related, c.now)

      for scope <- [:clients, :cleared, :related],
          do: assert(Dedupe.duplicate?(c.tables, "frame", :other, scope, c.now))

      # Another router brings a vehicle's frame back.
      refute Dedupe.duplicate?(c.tables, "telemetry", :vehicle, :related, c.now)
      assert Dedupe.duplicate?(c.tables, "telemetry", :router, :clients, c.now)
    end

    test "is bounded", c do
      for n <- 1..50_000, do: Dedupe.duplicate?(c.tables, <<n::32>>, :a, :related, c.now)
      {a, b} = c.tables.seen
      assert :ets.info(a, :size) <= 8_193 and :ets.info(b, :size) <= 8_193
      assert Dedupe.duplicate?(c.tables, <<50_000::32>>, :b, :related, c.now)
    end

    test "each frame of two links passes once, whichever was first", c do
      :proper.forall(list({elements([:a, :b]), binary(4)}), fn heard ->
        {x, y} = c.tables.seen
        for table <- [x, y], do: :ets.delete_all_objects(table)

        passed =
          Enum.reject(heard, fn {from, bytes} -> Dedupe.duplicate?(c.tables, bytes, from, :related, c.now) end)

        firsts = Enum.uniq_by(heard, &elem(&1, 1)) |> Map.new(fn {from, bytes} -> {bytes, from} end)
        passed == Enum.filter(heard, fn {from, bytes} -> firsts[bytes] == from end)
      end)
      |> check()
    end
  end

  test "rules: an error names the rule that is wrong" do
    assert {:ok, %Owner{side: :client, networks: ["a", "b"]}} =
             Owner.new("x", side: :client, networks: ["a", "b", "a"], group: nil)

    for {key, bad} <- [
          side: :left,
          networks: [],
          networks: "a",
          role: :king,
          sniffer: 1,
          bytes_per_s: 0,
          carry: %{x: 1},
          queue: [max: 1],
          in: 3,
          rate_limits: %{"NONE" => 1},
          colour: 1
        ] do
      assert {:error, words} = Owner.new("x", [{key, bad}])
      assert words =~ Atom.to_string(key)
    end
  end
end
