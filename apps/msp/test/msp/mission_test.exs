defmodule Msp.MissionTest do
  use ExUnit.Case, async: true

  alias MavCodec.Enums.MavCmd
  alias MavCodec.Messages, as: M
  alias Msp.Mission
  alias Msp.Test.{Line, Simulated}
  alias SimVehicle.Msp.{Firmware, Waypoints}

  @second 1_000_000
  @msl 0
  @home 3
  @none 2
  @local_enu 4

  defp item(name, params \\ {}, more \\ []) do
    [p1, p2, p3, p4] =
      params |> Tuple.to_list() |> Kernel.++([0, 0, 0, 0]) |> Enum.take(4) |> Enum.map(&(&1 / 1))

    command = MavCmd.value(:"MAV_CMD_#{name}")

    struct!(
      %M.MissionItemInt{
        command: command,
        frame: @none,
        param1: p1,
        param2: p2,
        param3: p3,
        param4: p4,
        autocontinue: 1
      },
      more
    )
  end

  defp place(name, n, params \\ {}, more \\ []),
    do: item(name, params, [frame: @home, x: 473_977_420 + n * 1000, y: 85_455_940, z: 20.0 + n] ++ more)

  defp numbered(items),
    do:
      for(
        {item, seq} <- Enum.with_index(items),
        do: %{item | seq: seq, current: if(seq == 0, do: 1, else: 0)}
      )

  defp survey do
    numbered([
      place(:NAV_WAYPOINT, 0),
      item(:DO_CHANGE_SPEED, {1, 7.5}),
      place(:NAV_WAYPOINT, 1, {}, frame: @msl),
      item(:USER_1, {0, 1, 0, 1}),
      place(:NAV_LOITER_TIME, 2, {12}),
      item(:CONDITION_YAW, {270}),
      item(:DO_CHANGE_SPEED, {1, -2}),
      place(:NAV_WAYPOINT, 3),
      item(:DO_SET_ROI_NONE),
      place(:DO_SET_ROI_LOCATION, 4),
      item(:DO_JUMP, {1, 3}),
      place(:NAV_WAYPOINT, 0, {}, frame: @local_enu, x: 0, y: 0),
      place(:NAV_LAND, 6, {0, 0, 12}),
      item(:NAV_RETURN_TO_LAUNCH)
    ])
  end

  describe "items and waypoints" do
    test "a mission with everything that iNav has, there and back" do
      assert {:ok, waypoints} = Mission.waypoints(survey())
      assert Enum.map(waypoints, & &1.action) == [1, 1, 3, 7, 1, 7, 5, 6, 1, 8, 4]

      assert [%{p1: 0, p3: 0}, %{p1: 750, p3: 0b10101}, %{p1: 12, p2: 750}, %{p1: 270}, %{p1: 0} | _] =
               waypoints

      # The jump goes to the speed of the second waypoint, so to that.
      assert %{action: 6, p1: 2, p2: 3} = Enum.at(waypoints, 7)
      assert %{flag: 0x48, lat: 0, lon: 0} = Enum.at(waypoints, 8)
      assert %{action: 8, p2: 12, altitude: 2600} = Enum.at(waypoints, 9)
      assert %{action: 4, p1: 1, flag: 0xA5} = List.last(waypoints)
      assert {:ok, items} = Mission.items(waypoints)
      assert items == survey()
      assert for(n <- 1..3, do: Mission.seq(waypoints, n)) == [0, 2, 4]
    end

    test "what iNav would do otherwise is refused with the item and the reason" do
      refused = fn items ->
        {:error, {kind, why}} = Mission.waypoints(numbered(items))
        {kind, why}
      end

      wp = place(:NAV_WAYPOINT, 0)
      three = for n <- 0..2, do: place(:NAV_WAYPOINT, n)
      assert {:unsupported, "item 1: iNav takes off by hand" <> _} = refused.([item(:NAV_TAKEOFF), wp])
      assert {:unsupported, "item 2: iNav has nothing for DO_SET_SERVO"} = refused.([wp, item(:DO_SET_SERVO)])

      assert {:unsupported, "item 1: iNav has nothing for command 65000"} =
               refused.([%{wp | command: 65_000}])

      assert {:frame, "item 1: " <> _} = refused.([%{wp | frame: 10}])
      assert {:invalid, "item 1: it has no place"} = refused.([%{wp | x: 0, y: 0}])

      for z <- [:nan, {:nan, 1}, :infinity],
          do: assert({:invalid, "item 1: it has no height"} = refused.([%{wp | z: z}]))

      assert {:invalid, "item 1: it has no place on Earth"} = refused.([%{wp | x: 0x7FFFFFFF}])
      assert {:invalid, "item 2: no waypoint follows" <> _} = refused.([wp, item(:DO_CHANGE_SPEED, {1, 5})])

      assert {:invalid, "item 2: a speed is in m/s" <> _} =
               refused.([wp, item(:DO_CHANGE_SPEED, {1, -1}), wp])

      for speed <- [0, 0.004],
          do:
            assert(
              {:invalid, "item 1: a speed is in m/s" <> _} =
                refused.([item(:DO_CHANGE_SPEED, {1, speed}), wp])
            )

      assert {:invalid, "item 1: the speed is set" <> _} = refused.([item(:DO_CHANGE_SPEED, {1, -2}), wp])

      assert {:invalid, "item 3: a change of speed comes" <> _} =
               refused.([wp, item(:DO_CHANGE_SPEED, {1, 5}), item(:CONDITION_YAW, {5}), wp])

      assert {:invalid, "item 1: user actions come" <> _} = refused.([item(:USER_1, {1}), wp])
      assert {:invalid, "item 1: a heading" <> _} = refused.([item(:CONDITION_YAW, {10, 0, 0, 1}), wp])
      assert {:unsupported, "item 1: iNav does not wait" <> _} = refused.([%{wp | autocontinue: 0}, wp])

      assert {:invalid, "waypoint 4 jumps to a waypoint beside it" <> _} =
               refused.(three ++ [item(:DO_JUMP, {2, 1})])

      assert {:invalid, "waypoint 4 jumps to what is not" <> _} = refused.(three ++ [item(:DO_JUMP, {9, 1})])

      assert {:invalid, "waypoint 4 jumps past the change" <> _} =
               refused.([item(:DO_CHANGE_SPEED, {1, 5}) | three] ++ [item(:DO_JUMP, {1, 1})])

      assert {:invalid, "it has 121 waypoints" <> _} = refused.(List.duplicate(wp, 121))
      assert {:invalid, "the last waypoint" <> _} = refused.([wp, %{wp | frame: @local_enu, x: 0, y: 0}])
      assert {:invalid, "item 1: a value is too large" <> _} = refused.([%{wp | z: 1.0e30}])
      # What is unset is 0, and a time to hold becomes the item that iNav has for it.
      assert {:ok, [%{action: 1}]} = Mission.waypoints([%{wp | param1: :nan, param4: :nan}])
      assert {:ok, [%{action: 3, p1: 5}]} = Mission.waypoints([%{wp | param1: 5.0}])
    end

    test "what MAVLink cannot say of waypoints" do
      {:ok, [first | _] = waypoints} = Mission.waypoints(survey())
      assert {:error, "several missions" <> _} = Mission.items([%{first | flag: 0xA5} | tl(waypoints)])
      assert {:error, "waypoint 1 has the action 2" <> _} = Mission.items([%{first | action: 2}])
      assert {:error, "waypoint 1 is at home" <> _} = Mission.items([%{first | flag: 0x48, p3: 1}])
      assert {:ok, []} = Mission.items([])
    end

    test "any waypoints: the same after a way through items, and any items end in waypoints or an error" do
      property =
        :proper.forall(:proper_types.non_empty(:proper_types.list(waypoint())), fn list ->
          waypoints = number(list)

          with {:ok, items} <- Mission.items(waypoints), {:ok, again} <- Mission.waypoints(items) do
            again == waypoints
          else
            # A jump that no vehicle would be armed with, or too many.
            {:error, {:invalid, why}} -> why =~ "jump" or why =~ "room"
            {:error, why} -> why =~ "jumps to waypoint"
          end
        end)

      assert :proper.quickcheck(property, [:quiet, numtests: 500]) == true, inspect(:proper.counterexample())

      any =
        :proper.forall(:proper_types.list(any_item()), fn items ->
          case Mission.waypoints(items) do
            {:ok, waypoints} -> match?({:ok, _}, Mission.items(waypoints))
            {:error, {kind, why}} -> is_atom(kind) and is_binary(why)
          end
        end)

      assert :proper.quickcheck(any, [:quiet, numtests: 1000]) == true, inspect(:proper.counterexample())
    end
  end

  defp waypoint do
    :proper_types.oneof([
      {1, :proper_types.range(1, 900), 0, :proper_types.range(0, 31)},
      {3, :proper_types.range(0, 99), :proper_types.oneof([0, 300, 301]), :proper_types.range(0, 31)},
      {8, :proper_types.oneof([0, 300]), :proper_types.range(-5, 300), :proper_types.range(0, 31)},
      {5, 0, 0, :proper_types.range(0, 1)},
      {7, :proper_types.range(-1, 359), 0, 0},
      {6, :proper_types.range(1, 12), :proper_types.range(-1, 9), 0},
      {4, :proper_types.range(0, 1), 0, 0}
    ])
  end

  defp number(list) do
    count = length(list)

    for {{action, p1, p2, p3}, number} <- Enum.with_index(list, 1) do
      place =
        if action in [1, 3, 5, 8],
          do: %{lat: 473_977_420 + number, lon: -85_000_000, altitude: 100 * number - 500}

      flag = if number == count, do: 0xA5, else: 0

      Map.merge(
        %{number: number, action: action, lat: 0, lon: 0, altitude: 0, p1: p1, p2: p2, p3: p3, flag: flag},
        place || %{}
      )
    end
  end

  defp any_item do
    commands =
      for name <-
            ~w(NAV_WAYPOINT NAV_LOITER_TIME NAV_LAND NAV_RETURN_TO_LAUNCH DO_JUMP DO_SET_ROI DO_SET_ROI_LOCATION
      DO_SET_ROI_NONE CONDITION_YAW DO_CHANGE_SPEED USER_1),
          do: MavCmd.value(:"MAV_CMD_#{name}")

    value = :proper_types.oneof([0.0, 1.0, 3.0, -1.0, :nan, :inf, 1.0e30, :proper_types.float()])

    :proper_types.bind(
      {:proper_types.oneof([:proper_types.range(0, 65_535) | commands]), :proper_types.range(0, 12), value,
       value, value},
      fn {command, frame, a, b, z} ->
        %M.MissionItemInt{
          command: command,
          frame: frame,
          param1: a,
          param2: b,
          param4: a,
          z: z,
          x: 1,
          y: 2,
          autocontinue: 1
        }
      end,
      false
    )
  end

  # --- the session ---

  defp up(firmware \\ :inav, drop \\ fn _request, _us -> false end) do
    {answer, change, state} = Simulated.controller(firmware)

    line =
      Line.open(fn bytes, us ->
        answered = answer.(bytes, us)
        if answered == "" or drop.(bytes, us), do: nil, else: answered
      end)

    {Line.run(line, 6 * @second), change, state}
  end

  defp send_mavlink(line, message, system \\ 237),
    do:
      Line.handle(
        line,
        {:mavlink,
         MavCodec.encode(%{message | target_system: 42, target_component: 1}, system: system, component: 191)}
      )

  # A client that answers each request, and repeats nothing.
  defp upload(line, items, seconds \\ 20) do
    line = send_mavlink(line, %M.MissionCount{count: length(items)})
    serve(line, items, length(requests(line)) - 1, seconds * 20)
  end

  defp serve(line, items, from, turns) do
    Enum.reduce(1..turns, {line, from}, fn _turn, {line, answered} ->
      line = Line.run(line, 50_000)
      all = requests(line)

      line =
        for seq <- Enum.drop(all, answered), reduce: line do
          line -> send_mavlink(line, Enum.at(items, seq))
        end

      {line, length(all)}
    end)
    |> elem(0)
  end

  defp requests(line), do: for({_at, request} <- Line.told(line, M.MissionRequestInt), do: request.seq)
  defp acks(line), do: for({_at, ack} <- Line.told(line, M.MissionAck), do: ack.type)
  defp texts(line), do: for({_at, text} <- Line.told(line, M.Statustext), do: text.text)
  defp notes(line), do: Enum.join(texts(line))

  defp download(line) do
    line = line |> send_mavlink(%M.MissionRequestList{}) |> Line.run(5 * @second)
    count = List.last(for {_at, count} <- Line.told(line, M.MissionCount), do: count.count)
    line = Enum.reduce(0..(count - 1)//1, line, &send_mavlink(&2, %M.MissionRequestInt{seq: &1}))
    {line, Enum.take(for({_at, item} <- Line.told(line, M.MissionItemInt), do: item), -count)}
  end

  test "a mission is written, read back, told as not stored, and read by any client as it was written (W3, W8)" do
    {line, _change, state} = up()
    line = upload(line, survey())
    assert acks(line) == [0]
    assert notes(line) =~ "Mission of 11 waypoints not stored"
    assert %{mission: %Waypoints{list: list}} = state.()
    assert <<_, _, 1, 11>> = Waypoints.info(%Waypoints{list: list})
    {line, items} = download(line)
    assert Enum.map(items, &%{&1 | target_system: 0, target_component: 0}) == survey()
    # Stored on request, so that it is there after a restart.
    line = line |> send_mavlink(%M.CommandLong{command: 245, param2: 1.0}) |> Line.run(@second)
    assert [%{result: 0}] = for({_at, ack} <- Line.told(line, M.CommandAck), do: ack)
    assert length(state.().mission.stored) == 11
    assert {_line, [_ | _]} = download(line)
  end

  test "the item that is flown has the number of its item, not that of its waypoint" do
    {line, change, _state} = up()
    line = upload(line, survey())
    status = <<3, 5, 1, 3, 0, 0, 0>>
    change.(&put_in(&1.blocks[121], status))
    line = Line.run(line, 3 * @second)
    assert {_at, %{seq: 4, total: 14, mission_state: 3}} = List.last(Line.told(line, M.MissionCurrent))
  end

  test "answers that are lost are asked for again; a waypoint that was lost is written again" do
    {:ok, dropped} = Agent.start_link(fn -> %{} end)

    # Each request of the mission fails the first time.
    drop = fn bytes, _us ->
      mission? = match?(<<"$M<", _, id, _::binary>> when id in [20, 118, 209], bytes)
      mission? and Agent.get_and_update(dropped, &{not is_map_key(&1, bytes), Map.put(&1, bytes, true)})
    end

    {line, _change, state} = up(:inav, drop)
    line = upload(line, survey(), 60)
    assert acks(line) == [0]
    assert length(state.().mission.list) == 11
    # The client is asked to wait meanwhile.
    assert Enum.count(requests(line), &(&1 == 13)) > 2
  end

  test "what is not as it was written is said: the firmware acknowledges what it ignores" do
    ignored = fn
      <<"$M<", 21, 209, 3, _::binary>>, _answer -> <<"$M>", 0, 209, 209>>
      _other, answer -> answer.()
    end

    # A bit of the latitude.
    altered = fn bytes, answer ->
      case {bytes, answer.()} do
        {<<"$M<", 1, 118, 2, _::binary>>, <<"$M>", head::binary-size(4), lat, rest::binary-size(18), sum>>} ->
          <<"$M>", head::binary, Bitwise.bxor(lat, 1), rest::binary, Bitwise.bxor(sum, 1)>>

        {_other, answer} ->
          answer
      end
    end

    for {change, why} <- [
          {ignored, "2 of 11 waypoints were taken"},
          {altered, "waypoint 2 is not as it was written"}
        ] do
      {answer, _change, _state} = Simulated.controller(:inav)

      spoilt = fn bytes, us ->
        with "" <- change.(bytes, fn -> answer.(bytes, us) end), do: nil
      end

      line = spoilt |> Line.open() |> Line.run(6 * @second) |> upload(survey())
      assert [1] = acks(line)
      assert notes(line) =~ "Mission not written: " <> why
    end
  end

  test "refused: while it is armed, too many, a second client meanwhile, an item of another kind; each with its reason" do
    {line, change, _state} = up()
    line = send_mavlink(line, %M.MissionCount{count: 361})
    assert acks(line) == [4]
    line = line |> send_mavlink(%M.MissionCount{count: 2}) |> send_mavlink(%M.MissionCount{count: 2}, 240)
    assert acks(line) == [4, 14]
    line = upload(line, numbered([item(:NAV_TAKEOFF), place(:NAV_WAYPOINT, 1)]), 2)
    assert List.last(acks(line)) == 3
    assert notes(line) =~ "item 1: iNav takes off by hand"
    line = send_mavlink(line, %M.MissionClearAll{})
    assert List.last(acks(line)) == 3
    line = send_mavlink(line, %M.MissionCount{count: 2, mission_type: 1})
    assert List.last(acks(line)) == 3
    change.(&Firmware.sticks(&1, [1500, 1500, 1000, 1500, 1900, 1000, 1000, 1000]))
    line = Line.run(line, 2 * @second)
    line = send_mavlink(line, %M.MissionCount{count: 2})
    assert List.last(acks(line)) == 14
  end

  test "a client that falls silent ends its upload, and another one may begin; so does one that cancels (W6)" do
    {line, _change, _state} = up()
    line = line |> send_mavlink(%M.MissionCount{count: 2}) |> Line.run(7 * @second)
    assert acks(line) == [15]
    # It was asked again meanwhile.
    assert length(requests(line)) > 4

    line =
      line
      |> send_mavlink(%M.MissionCount{count: 2})
      |> send_mavlink(%M.MissionAck{type: 15})
      |> Line.run(7 * @second)

    assert acks(line) == [15]
    assert acks(upload(line, survey())) == [15, 0]
  end

  test "Betaflight has none" do
    {line, _change, _state} = up(:betaflight)

    line =
      line
      |> send_mavlink(%M.MissionRequestList{})
      |> send_mavlink(%M.MissionCount{count: 2})
      |> Line.run(@second)

    assert acks(line) == [3, 3]
  end
end
