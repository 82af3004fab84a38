defmodule MavRouter.Sharing.TransferLockTest do
  use ExUnit.Case, async: true
  use Aerie.LinkCase

  alias MavRouter.Router
  alias MavRouter.Sharing.TransferLock.Transfer
  alias MavRouter.Sharing.TransferLock.Turn
  alias MavCodec.Messages, as: M

  @patience Aerie.Patience.ms()

  describe "a turn" do
    @a {:a, 255, 190}
    @b {:b, 254, 190}
    @c {:c, 253, 190}

    defp begun(who \\ @a, part \\ 0) do
      {:go, turn} = Turn.ask(Turn.new(), who, :begin, part, :first, 0)
      turn
    end

    test "is of the first who begins, until the vehicle ends what was begun; then of the next" do
      {:hold, turn} = Turn.ask(begun(), @b, :begin, 0, :b, 100)
      {:hold, turn} = Turn.ask(turn, @c, :begin, 0, :c, 110)
      assert {[], [], ^turn} = Turn.next(turn, 120)
      turn = turn |> Turn.answered({255, 190}, :more, 0, 130) |> Turn.answered({255, 190}, :end, 0, 140)
      assert {[:b], [], turn} = Turn.next(turn, 140)
      assert {:refuse, turn} = Turn.ask(turn, @a, :more, 0, :late, 150)
      assert {:go, _turn} = Turn.ask(turn, @b, :more, 0, :item, 150)
    end

    test "ends when all that was begun has ended, by mission type" do
      {:go, turn} = Turn.ask(begun(), @a, :begin, 1, :fence, 10)
      {:hold, turn} = Turn.ask(turn, @b, :begin, 0, :b, 20)
      turn = Turn.answered(turn, {255, 190}, :end, 0, 30)
      assert {[], [], turn} = Turn.next(turn, 30)
      assert {[:b], [], _turn} = turn |> Turn.answered({255, 190}, :end, 1, 40) |> Turn.next(40)
    end

    test "is not ended by an answer to somebody else" do
      turn = Turn.answered(begun(), {254, 190}, :end, 0, 30)
      assert {:hold, _turn} = Turn.ask(turn, @b, :begin, 0, :b, 40)
    end

    test "is over after a silence" do
      {:hold, turn} = Turn.ask(begun(), @b, :begin, 0, :b, 100)
      assert {[], [], turn} = Turn.next(turn, 4_999)
      assert {[:b], [], %{who: @b}} = Turn.next(turn, 5_000)
    end

    test "goes to nobody who has given up: one who repeated itself and stopped, one who asked once long ago" do
      {:hold, turn} = Turn.ask(begun(), @b, :begin, 0, :b1, 0)
      {:hold, turn} = Turn.ask(turn, @b, :begin, 0, :b2, 500)
      {:hold, turn} = Turn.ask(turn, @c, :begin, 0, :c, 600)
      turn = Turn.answered(turn, {255, 190}, :end, 0, 1_501)
      assert {[:c], [:b2], _turn} = Turn.next(turn, 1_501)
      # A repetition takes the place of what it repeats.
      {:hold, turn} = Turn.ask(begun(), @b, :begin, 0, :b1, 0)
      {:hold, turn} = Turn.ask(turn, @b, :begin, 0, :b2, 1_500)
      assert {[:b2], [], _turn} = turn |> Turn.answered({0, 0}, :end, 0, 1_600) |> Turn.next(1_600)
      {:hold, turn} = Turn.ask(begun(), @b, :begin, 0, :b, 0)
      turn = Enum.reduce(1..3, turn, &Turn.answered(&2, {255, 190}, :more, 0, &1 * 3_000))
      assert {[], [:b], %{waiting: []}} = Turn.next(turn, 10_000)
    end

    test "of the gateway is over when it is given back, neither by silence nor by an answer; and the gateway waits without asking again" do
      own = {:gateway, self()}
      {:go, turn} = Turn.take(Turn.new(), own, :own, 0)
      {:hold, turn} = Turn.ask(turn, @a, :begin, 0, :a1, 100)
      {:hold, turn} = Turn.ask(turn, @a, :begin, 0, :a2, 59_900)
      turn = Turn.answered(turn, {0, 0}, :end, 0, 59_900)
      assert {[], [], turn} = Turn.next(turn, 60_000)
      assert {[:a2], [], turn} = turn |> Turn.give_back(own) |> Turn.next(60_000)

      {:hold, turn} = Turn.take(turn, own, :own, 60_000)
      turn = Enum.reduce(61..80, turn, &Turn.answered(&2, {255, 190}, :more, 0, &1 * 1_000))
      assert {[], [], turn} = Turn.next(turn, 80_000)

      assert {[:own], [], %{who: ^own} = turn} =
               turn |> Turn.answered({255, 190}, :end, 0, 80_001) |> Turn.next(80_001)

      assert turn |> Turn.give_back(own) |> Turn.idle?()
      # It does not wait any more.
      {:hold, turn} = Turn.take(begun(), own, :own, 0)
      assert %{waiting: []} = Turn.give_back(turn, own)
    end

    test "whatever happens: only the holder of the turn sends, waiting is bounded, and everything ends" do
      who = :proper_types.oneof([@a, @b, @c, {:d, 255, 190}])
      said = :proper_types.oneof([:begin, :begin, :more, :end])

      op =
        :proper_types.oneof([
          {:ask, who, said, :proper_types.range(0, 2)},
          :take,
          :give_back,
          {:heard, :proper_types.oneof([{255, 190}, {254, 190}, {253, 190}, {0, 0}]), said,
           :proper_types.range(0, 2)},
          :next
        ])

      property =
        :proper.forall(:proper_types.list({op, :proper_types.range(0, 3_000)}), fn ops ->
          {turn, now} = Enum.reduce(ops, {Turn.new(), 0}, &step/2)
          turn = Turn.give_back(turn, {:gateway, self()})
          # Left alone, nobody has the turn for ever, and nobody waits for ever.
          {turn, _now} = Enum.reduce(1..100, {turn, now}, fn _n, acc -> step({:next, 1_000}, acc) end)
          Turn.idle?(turn)
        end)

      assert :proper.quickcheck(property, [:quiet, numtests: 500]) == true, inspect(:proper.counterexample())
    end

    defp step({{:ask, who, said, part}, dt}, {turn, now}) do
      now = now + dt
      before = turn
      {answer, turn} = Turn.ask(turn, who, said, part, {who, now}, now)
      free? = before.who == nil and before.waiting == []

      case answer do
        :go -> true = before.who == who or free?
        :hold -> true = said == :begin and Enum.any?(turn.waiting, &(&1.who == who))
        :refuse -> true = before.who != who
      end

      sane({turn, now})
    end

    defp step({{:heard, to, said, part}, dt}, {turn, now}),
      do: sane({Turn.answered(turn, to, said, part, now + dt), now + dt})

    defp step({:take, dt}, {turn, now}) do
      own = {:gateway, self()}
      had? = turn.who == own or Enum.any?(turn.waiting, &(&1.who == own))
      turn = if had?, do: turn, else: turn |> Turn.take(own, {own, now}, now + dt) |> elem(1)
      sane({turn, now + dt})
    end

    defp step({:give_back, dt}, {turn, now}), do: sane({Turn.give_back(turn, {:gateway, self()}), now + dt})

    defp step({:next, dt}, {turn, now}) do
      {items, _gave_up, after_it} = Turn.next(turn, now + dt)
      for {who, _at} <- items, do: ^who = after_it.who
      true = after_it.who != nil or after_it.waiting == []
      sane({after_it, now + dt})
    end

    defp sane({turn, _now} = state) do
      true = length(turn.waiting) <= 17
      true = Enum.uniq_by(turn.waiting, & &1.who) == turn.waiting
      true = turn.who == nil == (turn.open == [])
      state
    end
  end

  describe "through a gateway" do
    setup do
      # No turn is over because a busy machine takes long from one step to the next.
      gateway =
        start_parts(%{mavlink: %{system_id: 245, component_id: 191}}, options: [turns_clock: fn -> 0 end])

      {_id, port} = add_link(gateway, "udpin:127.0.0.1:0", id: "radio")
      vehicle = udp(port)
      say(vehicle, heartbeat(1))
      tables = MavRouter.Tables.of(gateway)
      eventually(fn -> Enum.any?(MavRouter.Endpoints.list(tables), & &1.heard_vehicle) end)
      {:ok, "gcs"} = MavRouter.Client.add(gateway, %{url: "udpin:127.0.0.1:0", id: "gcs"})
      client = snapshot(gateway, "gcs").port
      {:ok, gateway: gateway, vehicle: vehicle, a: udp(client), b: udp(client)}
    end

    defp udp(port) do
      {:ok, socket} = :gen_udp.open(0, [:binary, active: false, ip: {127, 0, 0, 1}])
      :ok = :gen_udp.connect(socket, {127, 0, 0, 1}, port)
      socket
    end

    defp say(socket, bytes), do: :ok = :gen_udp.send(socket, bytes)
    defp by(message, system), do: MavCodec.encode(message, system: system, component: 190)
    defp of_vehicle(message), do: MavCodec.encode(message, system: 1, component: 1)

    defp count(system, n, type \\ 0),
      do: by(%M.MissionCount{target_system: 1, target_component: 1, count: n, mission_type: type}, system)

    defp ack(to, type \\ 0),
      do: of_vehicle(%M.MissionAck{target_system: to, target_component: 190, mission_type: type})

    defp mark(system, n),
      do: by(%M.CommandLong{target_system: 1, target_component: 1, command: 512, param1: n * 1.0}, system)

    defp until(socket, mark, before \\ []) do
      {:ok, {_address, _port, bytes}} = :gen_udp.recv(socket, 0, @patience)
      if bytes == mark, do: Enum.reverse(before), else: until(socket, mark, [bytes | before])
    end

    test "the second upload waits until the vehicle has ended the first; everything else passes meanwhile",
         c do
      say(c.a, count(255, 3))
      until(c.vehicle, count(255, 3))
      say(c.b, count(254, 5))
      say(c.b, mark(254, 7))
      refute count(254, 5) in until(c.vehicle, mark(254, 7))
      say(c.vehicle, ack(255))
      until(c.a, ack(255))
      until(c.vehicle, count(254, 5))
      assert Enum.sum_by(Router.endpoints(c.gateway), & &1.counters.held) == 1
    end

    test "a request while nobody decides waits for a decision, and passes once", c do
      say(c.a, count(255, 3))
      until(c.vehicle, count(255, 3))
      turns = Aerie.Base.Names.whereis(c.gateway, :transfer_lock)
      :ok = :sys.suspend(turns, @patience)
      say(c.b, count(254, 5))
      own = Task.async(fn -> MavRouter.Sharing.TransferLock.take(c.gateway, {"main", 1}, :mission) end)
      # As a busy machine lets it stand still.
      Process.sleep(1_500)
      :ok = :sys.resume(turns, @patience)
      assert {:hold, {255, 190}} = Task.await(own, @patience)
      say(c.b, mark(254, 7))
      refute count(254, 5) in until(c.vehicle, mark(254, 7))
      say(c.vehicle, ack(255))
      until(c.vehicle, count(254, 5))
      say(c.b, mark(254, 8))
      refute count(254, 5) in until(c.vehicle, mark(254, 8))
      assert Enum.sum_by(Router.endpoints(c.gateway), & &1.counters.held) == 1
    end

    test "what would fall into another's transfer is refused, and counted", c do
      say(c.a, count(255, 3))
      until(c.vehicle, count(255, 3))
      item = by(%M.MissionItemInt{target_system: 1, target_component: 1, seq: 2}, 254)
      say(c.b, item)
      say(c.b, mark(254, 7))
      refute item in until(c.vehicle, mark(254, 7))
      assert Enum.sum_by(Router.endpoints(c.gateway), & &1.counters.out_of_turn) == 1
    end

    test "sessions of files have turns of their own", c do
      open = fn system ->
        by(%M.FileTransferProtocol{target_system: 1, target_component: 1, payload: <<0::16, 0, 4>>}, system)
      end

      closed =
        of_vehicle(%M.FileTransferProtocol{
          target_system: 255,
          target_component: 190,
          payload: <<1::16-little, 0, 128, 0, 1>>
        })

      say(c.a, open.(255))
      until(c.vehicle, open.(255))
      say(c.b, count(254, 5))
      until(c.vehicle, count(254, 5))
      say(c.b, open.(254))
      say(c.b, mark(254, 7))
      refute open.(254) in until(c.vehicle, mark(254, 7))
      say(c.vehicle, closed)
      until(c.vehicle, open.(254))
    end

    test "logs have turns of their own: a request of another would end the vehicle's sending", c do
      list = fn system ->
        by(%M.LogRequestList{target_system: 1, target_component: 1, end: 65_535}, system)
      end

      data = fn system -> by(%M.LogRequestData{target_system: 1, target_component: 1, id: 1}, system) end
      stop = fn system -> by(%M.LogRequestEnd{target_system: 1, target_component: 1}, system) end
      say(c.a, list.(255))
      until(c.vehicle, list.(255))
      say(c.b, data.(254))
      say(c.b, mark(254, 1))
      refute data.(254) in until(c.vehicle, mark(254, 1))
      # The first entry of two, and the last one.
      say(c.vehicle, of_vehicle(%M.LogEntry{id: 1, num_logs: 2, last_log_num: 2}))
      say(c.b, mark(254, 2))
      refute data.(254) in until(c.vehicle, mark(254, 2))
      say(c.vehicle, of_vehicle(%M.LogEntry{id: 2, num_logs: 2, last_log_num: 2}))
      until(c.vehicle, data.(254))

      # What would end another's download is kept from the vehicle.
      for frame <- [data.(255), stop.(255)], do: say(c.a, frame)
      say(c.a, mark(255, 3))
      assert [] = until(c.vehicle, mark(255, 3)) -- [mark(254, 2)]
      say(c.b, stop.(254))
      until(c.vehicle, data.(255))
    end

    test "logs: a download of the gateway waits for that of a client, and a client for the gateway's", c do
      data = by(%M.LogRequestData{target_system: 1, target_component: 1, id: 1}, 254)
      stop = by(%M.LogRequestEnd{target_system: 1, target_component: 1}, 254)
      say(c.b, data)
      until(c.vehicle, data)
      assert {:hold, {254, 190}} = MavRouter.Sharing.TransferLock.take(c.gateway, {"main", 1}, :log)
      MavRouter.Sharing.TransferLock.give_back(c.gateway, {"main", 1}, :log)
      say(c.b, stop)
      until(c.vehicle, stop)
      assert :go = eventually(fn -> taken(c.gateway) end)
      say(c.b, data)
      say(c.b, mark(254, 4))
      refute data in until(c.vehicle, mark(254, 4))
      MavRouter.Sharing.TransferLock.give_back(c.gateway, {"main", 1}, :log)
      until(c.vehicle, data)
    end

    # The end of another's turn may be under way.
    defp taken(gateway) do
      with {:hold, _whose} <- MavRouter.Sharing.TransferLock.take(gateway, {"main", 1}, :log) do
        MavRouter.Sharing.TransferLock.give_back(gateway, {"main", 1}, :log)
        nil
      end
    end

    test "a transfer of the gateway has its turn among those of clients, and gives it back when its process ends",
         c do
      vehicle = {"main", 1}
      assert :go = MavRouter.Sharing.TransferLock.take(c.gateway, vehicle, :mission)
      say(c.a, count(255, 3))
      say(c.a, mark(255, 1))
      refute count(255, 3) in until(c.vehicle, mark(255, 1))
      # It may give way.
      assert_receive {:transfer_wanted, ^vehicle, :mission}, @patience
      MavRouter.Sharing.TransferLock.give_back(c.gateway, vehicle, :mission)
      until(c.vehicle, count(255, 3))

      # The other way round, and told whose turn it is.
      test = self()

      {waiting, monitor} =
        spawn_monitor(fn ->
          send(test, MavRouter.Sharing.TransferLock.take(c.gateway, vehicle, :mission))
          assert_receive {:transfer_turn, ^vehicle, :mission}, @patience
          send(test, :turn)
          receive do: (:end -> :ok)
        end)

      assert_receive {:hold, {255, 190}}, @patience
      say(c.vehicle, ack(255))
      assert_receive :turn, @patience
      say(c.b, count(254, 5))
      say(c.b, mark(254, 2))
      refute count(254, 5) in until(c.vehicle, mark(254, 2))
      send(waiting, :end)
      assert_receive {:DOWN, ^monitor, :process, _pid, _normal}, @patience
      until(c.vehicle, count(254, 5))
    end

    test "without its process everything passes, and its successor knows nothing of the turns before", c do
      say(c.a, count(255, 3))
      until(c.vehicle, count(255, 3))
      old = Aerie.Base.Names.whereis(c.gateway, :transfer_lock)
      Process.exit(old, :kill)
      eventually(fn -> Aerie.Base.Names.whereis(c.gateway, :transfer_lock) not in [nil, old] end)
      say(c.b, count(254, 5))
      until(c.vehicle, count(254, 5))
    end
  end

  test "what frames say in a transfer" do
    said = fn message ->
      message |> MavCodec.encode(system: 255, component: 190) |> MavCodec.Frame.from_bytes(nil)
    end

    frame = fn message -> %{said.(message) | crc_extra: 0} end
    assert Transfer.asked(frame.(%M.MissionCount{count: 1, mission_type: 2})) == {:mission, :begin, 2}
    assert Transfer.asked(frame.(%M.MissionRequestInt{mission_type: 1})) == {:mission, :more, 1}
    assert Transfer.answered(frame.(%M.MissionCount{count: 0})) == {:mission, :end, 0}
    assert Transfer.answered(frame.(%M.MissionCount{count: 2})) == {:mission, :more, 0}
    # ListDirectory needs no session.
    assert Transfer.asked(frame.(%M.FileTransferProtocol{payload: <<0::16, 0, 3>>})) == nil

    assert Transfer.answered(frame.(%M.LogEntry{num_logs: 0})) == {:log, :end, 0}
    assert Transfer.answered(frame.(%M.LogData{id: 3})) == {:log, :more, 1}
    assert Transfer.asked(frame.(%M.LogErase{})) == {:log, :begin, 2}

    assert Transfer.answered(frame.(%M.FileTransferProtocol{payload: <<0::16, 0, 129, 1, 4, 10>>})) ==
             {:file, :end, 0}
  end
end
