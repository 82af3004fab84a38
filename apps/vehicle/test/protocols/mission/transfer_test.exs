defmodule Protocols.Mission.TransferTest do
  use ExUnit.Case, async: true

  alias Aerie.LossyPlans
  alias Aerie.Vehicle.Firmware
  alias Protocols.Mission.{Item, Transfer}
  alias MavCodec.Messages, as: M

  @vehicle {1, 1}
  @us {237, 191}

  defp items(count, seed \\ 0) do
    for n <- 1..count//1 do
      %Item{
        command: 16,
        frame: 3,
        x: 473_977_428 + n * 100,
        y: 85_455_967 + seed,
        z: 20.0 + n,
        params: {0.0, 2.5, 0.0, nil}
      }
    end
  end

  defp transfer(op, style \\ :px4, type \\ 0, options \\ []) do
    {:ok, transfer} =
      Transfer.new(
        op,
        type,
        Keyword.merge(
          [protocol: Firmware.of(style), kind: "copter", target: @vehicle, us: @us, until: 60_000_000],
          options
        )
      )

    Transfer.handle(transfer, {:start, 0})
  end

  defp heard(transfer, message, now, source \\ @vehicle),
    do: Transfer.handle(transfer, {:message, message, source, now})

  defp sent(actions), do: for({:send, message} <- actions, do: message)

  defp result(actions),
    do: Enum.find_value(actions, fn action -> match?({:result, _}, action) && elem(action, 1) end)

  test "720 items by a radio whose answers take a quarter of a second are sent and read back, and read" do
    new = items(720)
    # What `Aerie.Control.Transfers.time_ms/2` gives 1,440 messages of 5 s.
    world =
      LossyPlans.new(:ardupilot, items(3), delay: {120, 130})
      |> LossyPlans.start({:upload, new}, 0, ms: 7_260_000)

    world = LossyPlans.finish(world)
    assert %{status: :completed, on_board: :new, items: ^new} = world.result
    assert world.result.ms > 300_000

    # What a vehicle has is known when it says so.
    read = &(world |> LossyPlans.start(:download, 0, &1) |> LossyPlans.finish())
    assert %{status: :completed, items: ^new} = read.(ms: 60_000, item_us: 5_000_000).result
    assert %{status: :timeout} = read.(ms: 60_000).result
  end

  describe "on a good link" do
    for style <- [:ardupilot, :px4] do
      test "#{style}: a plan is sent, read back and found right" do
        new = items(5)

        world =
          LossyPlans.new(unquote(style), items(3, 7), [])
          |> LossyPlans.start({:upload, new})
          |> LossyPlans.finish()

        assert %{status: :completed, on_board: :new, items: ^new, reason: nil} = world.result
        # COUNT, five items, LIST, five requests, ACK.
        assert world.sent == 13
        assert world.plan == new
        assert world.result.opaque_id == if(unquote(style) == :px4, do: world.opaque)
      end

      test "#{style}: a plan is read, and cleared" do
        old = items(4)
        world = LossyPlans.new(unquote(style), old, []) |> LossyPlans.start(:download) |> LossyPlans.finish()
        assert %{status: :completed, on_board: :read, items: ^old} = world.result

        world = world |> LossyPlans.start(:clear) |> LossyPlans.finish()
        assert %{status: :completed, on_board: :new, items: []} = world.result
        assert world.plan == []
      end

      test "#{style}: a plan without items clears" do
        world =
          LossyPlans.new(unquote(style), items(2), [])
          |> LossyPlans.start({:upload, []}, 1)
          |> LossyPlans.finish()

        assert %{status: :completed, on_board: :new} = world.result
        assert world.plan == []
      end
    end
  end

  describe "what the vehicle says" do
    test "W4: another type of plan is somebody else's" do
      {t, _start} = transfer({:upload, items(2)}, :px4, 1)
      assert {_t, []} = heard(t, %M.MissionRequestInt{seq: 0, mission_type: 0}, 1)
      assert {_t, actions} = heard(t, %M.MissionRequestInt{seq: 0, mission_type: 1}, 1)
      assert [%M.MissionItemInt{seq: 0, mission_type: 1, current: 0}] = sent(actions)
    end

    test "another system, component or ground station is not the vehicle" do
      {t, _start} = transfer({:upload, items(2)})
      request = %M.MissionRequestInt{seq: 0}
      assert {_t, []} = heard(t, request, 1, {2, 1})
      assert {_t, []} = heard(t, request, 1, {1, 191})
      assert {_t, []} = heard(t, %{request | target_system: 255, target_component: 190}, 1)
      assert {_t, [_item]} = heard(t, %{request | target_system: 237, target_component: 191}, 1)
    end

    test "W5: MISSION_REQUEST is answered with MISSION_ITEM_INT" do
      {t, _start} = transfer({:upload, items(2)}, :ardupilot)
      {_t, actions} = heard(t, %M.MissionRequest{seq: 1}, 1)
      assert [%M.MissionItemInt{seq: 1, param4: :nan, target_system: 1, target_component: 1}] = sent(actions)
    end

    test "W3: whatever it asks for again comes again; what is not in the plan does not" do
      {t, _start} = transfer({:upload, items(3)})
      {t, _item} = heard(t, %M.MissionRequestInt{seq: 0}, 1)
      {t, _item} = heard(t, %M.MissionRequestInt{seq: 1}, 2)
      {t, actions} = heard(t, %M.MissionRequestInt{seq: 0}, 3)
      assert [%M.MissionItemInt{seq: 0}] = sent(actions)
      assert {_t, []} = heard(t, %M.MissionRequestInt{seq: 3}, 4)
    end

    test "W3: ArduPilot's INVALID_SEQUENCE says that it has the item" do
      {t, _start} = transfer({:upload, items(3)}, :ardupilot)
      {t, _item} = heard(t, %M.MissionRequest{seq: 0}, 1)
      # Late, and about something else.
      assert {t, []} = heard(t, %M.MissionAck{type: 13}, 2)
      {t, actions} = Transfer.handle(t, {:tick, Transfer.wake_at(t)})
      assert [%M.MissionItemInt{seq: 0}] = sent(actions)
      {t, actions} = heard(t, %M.MissionAck{type: 13}, 2_000_000)
      assert [%M.MissionItemInt{seq: 1}] = sent(actions)
      assert {_t, []} = heard(t, %M.MissionAck{type: 13}, 2_000_001)
    end

    test "an acknowledgement before the last item was sent is that of something else" do
      {t, _start} = transfer({:upload, items(2)})
      assert {t, []} = heard(t, %M.MissionAck{type: 0}, 1)
      {t, _item} = heard(t, %M.MissionRequestInt{seq: 0}, 2)
      assert {_t, []} = heard(t, %M.MissionAck{type: 0}, 3)
    end

    test "W2: a plan that it refuses at once leaves the old one" do
      world =
        LossyPlans.new(:px4, items(2), refuse: {:count, 4})
        |> LossyPlans.start({:upload, items(9)})
        |> LossyPlans.finish()

      assert %{status: :rejected, on_board: :old, reason: "the vehicle refused it: NO_SPACE"} = world.result
      assert world.sent == 1
    end

    test "W2: an item that it refuses cancels the upload; what it has is read" do
      old = items(2)

      world =
        LossyPlans.new(:px4, old, refuse: {:item, 3})
        |> LossyPlans.start({:upload, items(9)})
        |> LossyPlans.finish()

      assert %{status: :rejected, on_board: :other, items: ^old, reason: "the vehicle refused it: INVALID"} =
               world.result

      assert world.plan == old
    end

    test "W1: a vehicle that says nothing is asked six times at least, for 15 s" do
      {t, start} = transfer({:upload, items(2)})
      assert [%M.MissionCount{count: 2}] = sent(start)
      assert Transfer.wake_at(t) == 1_500_000

      {_t, sends, actions, now} =
        Enum.reduce_while(1..50, {t, 1, [], 0}, fn _n, {t, sends, _actions, _now} ->
          now = Transfer.wake_at(t)
          {t, actions} = Transfer.handle(t, {:tick, now})
          go = if result(actions), do: :halt, else: :cont
          {go, {t, sends + length(sent(actions)), actions, now}}
        end)

      assert %{status: :timeout, on_board: :unknown, reason: "the vehicle does not answer"} = result(actions)
      assert sends in 6..12 and now in 15_000_000..18_000_000
    end

    test "an item that it has differently is named" do
      wrong = List.update_at(items(3), 1, &%{&1 | z: 21.0})
      world = LossyPlans.new(:px4, [], []) |> LossyPlans.start({:upload, items(3)})
      # Another ground station is faster.
      world =
        world |> LossyPlans.soon(430, {:plan, wrong}) |> Map.put(:delay, {60, 61}) |> LossyPlans.finish()

      assert %{status: :failed, on_board: :other, mismatch: 1, reason: reason} = world.result
      assert reason =~ "item 1 has z 21.0 and not 22.0"
    end

    test "W8: floats are compared as 32 bits; ArduPilot's item 0 is home, and it keeps no frame of what has no place" do
      [home | rest] = items(3)
      sent = [home, %{hd(rest) | params: {0.1, 2.5, 0.0, nil}}, %Item{command: 20, frame: 2}]
      {t, _start} = transfer({:upload, sent}, :ardupilot)
      {t, _item} = heard(t, %M.MissionRequest{seq: 2}, 1)
      {t, actions} = heard(t, %M.MissionAck{type: 0}, 2)
      assert [%M.MissionRequestList{}] = sent(actions)
      {t, _request} = heard(t, %M.MissionCount{count: 3}, 3)

      stored = [
        %{home | x: 1, y: 2, z: 584.09},
        %{Enum.at(sent, 1) | params: {Item.float32(0.1), 2.5, 0.0, 0.0}},
        %{Enum.at(sent, 2) | frame: 0}
      ]

      {_t, actions} =
        stored
        |> Enum.with_index()
        |> Enum.reduce({t, []}, fn {item, seq}, {t, _} ->
          heard(t, Item.message(item, seq, 0, @us), 4 + seq)
        end)

      assert %{status: :completed, on_board: :new} = result(actions)
    end
  end

  describe "PX4 rejects what it acknowledged" do
    test "by an EVENT" do
      world =
        LossyPlans.new(:px4, [], reject_after: true)
        |> LossyPlans.start({:upload, items(3)})
        |> LossyPlans.finish()

      assert %{status: :rejected, on_board: :new, reason: reason} = world.result
      assert reason == "PX4 rejected it after the upload: it needs a take-off"
    end

    test "by an EVENT that is lost: MISSION_CURRENT shows it" do
      {t, _} = transfer({:upload, items(1)})
      {t, _} = heard(t, %M.MissionRequestInt{seq: 0}, 1)
      {t, _} = heard(t, %M.MissionAck{type: 0, opaque_id: 77}, 2)
      {t, _} = heard(t, %M.MissionCount{count: 1, opaque_id: 77}, 3)
      {t, actions} = heard(t, Item.message(hd(items(1)), 0, 0, @us), 4)
      assert result(actions) == nil
      {t, _} = heard(t, %M.MissionCurrent{mission_id: 77, mission_state: 1}, 5)
      {_t, actions} = Transfer.handle(t, {:tick, Transfer.wake_at(t)})
      assert %{status: :rejected, on_board: :new} = result(actions)

      # Nothing heard: accepted is all that can be said.
      {t, _} = heard(t, %M.MissionCurrent{mission_id: 76, mission_state: 2}, 6)
      {_t, actions} = Transfer.handle(%{t | verdict: nil}, {:tick, Transfer.wake_at(t)})
      assert %{status: :accepted, on_board: :new} = result(actions)

      {_t, actions} = heard(t, %M.MissionCurrent{mission_id: 77, mission_state: 2}, 6)
      assert %{status: :completed} = result(actions)
    end

    test "a warning is not a rejection" do
      assert Firmware.Px4.Adapter.plan_verdict(%M.Event{id: 22_091_529, log_levels: 0x64}, 0, 1) == :ignore
    end
  end

  describe "cancelling, deadlines and reboots" do
    test "W6: cancelling tells the vehicle, and finds out what it has" do
      old = items(2)
      world = LossyPlans.new(:ardupilot, old, []) |> LossyPlans.start({:upload, items(50)})
      world = world |> LossyPlans.soon(300, :cancel) |> LossyPlans.finish()
      assert %{status: :cancelled, on_board: :other, items: ^old} = world.result
      assert world.plan == old and world.upload == nil
    end

    test "W6: a request after the end is answered" do
      {t, _} = transfer({:upload, items(3)})
      {t, actions} = Transfer.handle(t, {:cancel, 10})
      assert [%M.MissionAck{type: 15}] = sent(actions)
      {_t, actions} = heard(t, %M.MissionRequestInt{seq: 1}, 20)
      assert [%M.MissionAck{type: 15, mission_type: 0}] = sent(actions)
    end

    test "nothing is sent after the deadline, and a transfer past it is not begun" do
      {t, _} = transfer({:upload, items(3)}, :px4, 0, until: 1_000_000)
      assert Transfer.wake_at(t) == 1_000_000
      {t, actions} = Transfer.handle(t, {:tick, 1_000_000})
      assert %{status: :timeout, on_board: :old} = result(actions)
      assert Transfer.wake_at(t) == nil
      assert {_t, []} = heard(t, %M.MissionRequestInt{seq: 0}, 1_000_001)

      {:ok, late} =
        Transfer.new(:download, 0,
          protocol: Firmware.Px4.Adapter,
          kind: "copter",
          target: @vehicle,
          us: @us,
          until: 5
        )

      assert {_t, [{:result, %{status: :expired}}]} = Transfer.handle(late, {:start, 5})
    end

    test "a reboot in the middle: the vehicle has what it had" do
      old = items(2)
      world = LossyPlans.new(:px4, old, seed: 3) |> LossyPlans.start({:upload, items(100)})
      world = world |> LossyPlans.soon(700, :reboot) |> LossyPlans.finish()
      assert %{status: :failed, on_board: :other, items: ^old} = world.result
    end

    test "a plan has a limit" do
      assert {:error, "the plan has 5001 items; at most 5000" <> _} =
               Transfer.new({:upload, items(5001)}, 0,
                 protocol: Firmware.Px4.Adapter,
                 kind: "copter",
                 target: @vehicle,
                 us: @us,
                 until: 5
               )
    end
  end

  test "W7: a download begins again when the plan changes on the way" do
    {t, _} = transfer(:download)
    {t, _} = heard(t, %M.MissionCount{count: 2, opaque_id: 5}, 1)
    {t, _} = heard(t, Item.message(hd(items(1)), 0, 0, @us), 2)
    {t, actions} = heard(t, %M.MissionCurrent{mission_id: 6}, 3)
    assert [%M.MissionRequestList{}] = sent(actions)
    {t, _} = heard(t, %M.MissionCount{count: 1, opaque_id: 6}, 4)
    {_t, actions} = heard(t, Item.message(hd(items(1, 3)), 0, 0, @us), 5)
    assert %{status: :completed, opaque_id: 6, items: [_one]} = result(actions)
  end

  describe "W1: a vehicle that has ended the transfer ignores requests for items" do
    # Time passes to `at`.
    defp idle(transfer, at, sent \\ []) do
      case Transfer.wake_at(transfer) do
        wake when wake != nil and wake <= at ->
          {transfer, actions} = Transfer.handle(transfer, {:tick, wake})
          idle(transfer, at, sent ++ actions)

        _later ->
          {transfer, sent}
      end
    end

    defp begun(transfer, now) do
      {transfer, actions} = heard(transfer, %M.MissionCount{count: 2}, now)
      assert [%M.MissionRequestInt{seq: 0}] = sent(actions)
      transfer
    end

    test "the plan is read from its start" do
      {transfer, _list} = transfer(:download)
      transfer = begun(transfer, 10_000)

      # PX4 after an error acknowledgement of somebody, or after five seconds in which the link lost everything.
      {transfer, actions} = idle(transfer, 7_000_000)

      assert [%M.MissionRequestList{} | _again] =
               actions |> sent() |> Enum.reject(&is_struct(&1, M.MissionRequestInt))

      transfer = begun(transfer, 7_100_000)
      {transfer, _next} = heard(transfer, Item.message(hd(items(1)), 0, 0, @us), 7_200_000)
      {_transfer, actions} = heard(transfer, Item.message(hd(items(1)), 1, 0, @us), 7_300_000)
      assert %{status: :completed, items: [_zero, _one]} = result(actions)
    end

    test "and, if that happens again and again, the transfer fails with the reason" do
      {transfer, _list} = transfer(:download, :px4, 0, until: 300_000_000)

      {_transfer, result, at} =
        Enum.reduce_while(1..10, {transfer, nil, 0}, fn n, {transfer, nil, at} ->
          {transfer, actions} = transfer |> begun(at + 10_000) |> idle(at + 8_000_000)

          if result(actions),
            do: {:halt, {transfer, result(actions), n}},
            else: {:cont, {transfer, nil, at + 8_000_000}}
        end)

      assert %{status: :timeout, reason: reason} = result
      assert reason =~ "begun again" and at == 4
    end
  end

  test "progress is reported at most once per per cent" do
    {t, start} = transfer({:upload, items(1000)})

    {_t, actions} =
      Enum.reduce(0..999, {t, start}, fn seq, {t, all} ->
        {t, actions} = heard(t, %M.MissionRequestInt{seq: seq}, seq)
        {t, all ++ actions}
      end)

    assert length(for {:progress, _} = p <- actions, do: p) in 99..101
  end

  for style <- [:ardupilot, :px4] do
    test "#{style}: 500 items at 25 % loss in both directions" do
      for seed <- 1..6 do
        new = items(500)
        world = LossyPlans.new(unquote(style), items(3, 1), loss: 0.25, doubled: 0.05, seed: seed)
        world = world |> LossyPlans.start({:upload, new}, 0, rtt: 40_000) |> LossyPlans.finish()
        assert %{status: :completed, on_board: :new} = world.result
        assert world.plan == new

        world = world |> LossyPlans.start(:download, 0, rtt: 40_000) |> LossyPlans.finish()
        assert %{status: :completed, items: ^new} = world.result
      end
    end
  end
end
