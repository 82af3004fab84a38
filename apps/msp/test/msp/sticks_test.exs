defmodule Msp.SticksTest do
  @moduledoc "Arming and steering over MSP, against the simulated firmware: with whom in charge, and what becomes of it when nobody steers."
  use ExUnit.Case, async: true

  alias MavCodec.Messages, as: M
  alias MavCodec.Msp.Parser
  alias Msp.Test.{Line, Simulated}
  alias SimVehicle.Msp.Firmware

  @second 1_000_000
  @arm 400
  @set_mode 176
  @accepted 0
  @temporarily 1
  @denied 2
  @failed 4
  @in_progress 5
  @client 237

  defp up(firmware, options, version \\ nil) do
    {answer, change, state} = Simulated.controller(firmware, options)

    if version,
      do:
        change.(
          &%{&1 | version: version, blocks: Map.put(&1.blocks, 1, <<0, elem(version, 0), elem(version, 1)>>)}
        )

    line = Line.open(fn bytes, us -> with("" <- answer.(bytes, us), do: nil) end)
    # Betaflight's grace time after a start.
    {Line.run(line, 7 * @second), change, state}
  end

  defp send_mavlink(line, message, system \\ @client),
    do: Line.handle(line, {:mavlink, MavCodec.encode(message, system: system, component: 191)})

  defp command(line, number, params, system \\ @client) do
    fields = for {value, n} <- Enum.with_index(params, 1), do: {:"param#{n}", value / 1}

    line
    |> send_mavlink(
      struct!(%M.CommandLong{target_system: 42, target_component: 1, command: number}, fields),
      system
    )
    |> Line.run(100_000)
  end

  defp sticks(line, throttle, system \\ @client),
    do: send_mavlink(line, %M.ManualControl{target: 42, z: throttle, x: 0, y: 0, r: 0}, system)

  # Armed and steered, some metres up.
  defp flying(firmware) do
    {line, change, state} = up(firmware, rx_msp: true)
    line = line |> command(@arm, [1, 0]) |> Line.run(4 * @second) |> steer(2, 900)
    assert state.().armed and state.().flight.alt > 3
    {line, change, state}
  end

  # A new session at the same vehicle.
  defp reopened(line, change) do
    change.(&%{&1 | ports: Map.new(&1.ports, fn {id, _port} -> {id, %SimVehicle.Msp.Port{}} end)})
    Line.open(line.answer, now: line.now) |> Line.run(3 * @second)
  end

  # A client that steers, ten times a second.
  defp steer(line, seconds, throttle),
    do:
      Enum.reduce(1..(seconds * 10), line, fn _turn, line -> line |> sticks(throttle) |> Line.run(100_000) end)

  defp acks(line, number),
    do: for({_at, %{command: ^number} = ack} <- Line.told(line, M.CommandAck), do: ack.result)

  # Chunks of one text come one after the other.
  defp notes(line), do: Enum.join(for({_at, text} <- Line.told(line, M.Statustext), do: text.text))

  # What was sent to the receiver: times and channels.
  defp raw(line) do
    for {at, bytes} <- Enum.reverse(line.written),
        {[%{id: 200, payload: payload}], _parser} <- [Parser.push(Parser.new(), bytes)],
        do: {at, for(<<us::16-little <- payload>>, do: us)}
  end

  for firmware <- [:betaflight, :inav] do
    test "#{firmware}: safe channels first, then armed, steered, in its mode, disarmed, and the channels end" do
      {line, _change, state} = up(unquote(firmware), rx_msp: true)
      line = line |> command(@arm, [1, 0]) |> Line.run(@second)
      refute state.().armed
      line = Line.run(line, 3 * @second)
      assert state.().armed
      assert acks(line, @arm) == [@in_progress, @accepted]
      line = steer(line, 2, 800)
      assert state.().flight.alt > 1
      assert %{boxes: boxes} = state.()
      assert 1 in boxes, "it was to be level"
      # Disarming in the air is not done, unless it is forced.
      line = line |> sticks(800) |> command(@arm, [0, 0])
      assert List.last(acks(line, @arm)) == @denied
      assert notes(line) =~ "Not done: it is in the air"
      line = line |> steer(4, 0) |> command(@arm, [0, 0]) |> steer(1, 0)
      refute state.().armed
      assert List.last(acks(line, @arm)) == @accepted
      line = Line.run(line, 4 * @second)
      {at, [_, _, throttle | _]} = List.last(raw(line))
      assert line.now - at > @second and throttle == 1000

      gaps =
        raw(line)
        |> Enum.map(&elem(&1, 0))
        |> Enum.chunk_every(2, 1, :discard)
        |> Enum.map(fn [a, b] -> b - a end)

      assert Enum.max(gaps) <= 50_000
    end

    test "#{firmware}: nobody steers: on the ground it is disarmed, in the air its own failsafe acts" do
      {line, _change, state} = up(unquote(firmware), rx_msp: true)
      line = line |> command(@arm, [1, 0]) |> Line.run(5 * @second)
      assert state.().armed
      line = Line.run(line, 10 * @second)
      refute state.().armed
      assert notes(line) =~ "Nobody steers it: disarmed"
      line = line |> Line.run(3 * @second) |> command(@arm, [1, 0]) |> Line.run(4 * @second)
      assert state.().armed
      line = steer(line, 2, 900)
      line = Line.run(line, 2 * @second)
      assert notes(line) =~ "Nobody steers it: channels stopped"
      {last, _channels} = List.last(raw(line))
      assert line.now - last > 900_000
      line = Line.run(line, 2 * @second)
      assert 27 in state.().boxes or not state.().armed
      # The failsafe is the vehicle's, and it is told.
      assert notes(line) =~ "ailsafe"
    end

    test "#{firmware}: without an altimeter it is in the air, as far as is known: nobody but the pilot disarms it" do
      {line, change, state} = up(unquote(firmware), rx_msp: true, blind: true)
      line = line |> command(@arm, [1, 0]) |> Line.run(4 * @second) |> steer(2, 900) |> steer(1, 0)
      assert state.().armed
      change.(&%{&1 | flight: %{&1.flight | alt: 30.0}})
      line = command(line, @arm, [0, 0])
      assert List.last(acks(line, @arm)) == @denied
      assert notes(line) =~ "it is in the air, as far as is known: it does not say how high it is"
      # A second of silence with idle throttle.
      line = Line.run(line, 1_200_000)
      assert state.().armed
      assert notes(line) =~ "Nobody steers it: channels stopped"
      refute notes(line) =~ "Nobody steers it: disarmed"
      assert Enum.all?(Enum.take(raw(line), -20), fn {_at, channels} -> Enum.at(channels, 4) > 1700 end)
      line = line |> command(@arm, [0, 21_196]) |> Line.run(@second)
      assert List.last(acks(line, @arm)) == @accepted
      refute state.().armed
    end

    test "#{firmware}: sticks that come back have the vehicle again before its failsafe acts" do
      {line, _change, state} = flying(unquote(firmware))
      line = Line.run(line, 1_200_000)
      assert state.().armed
      assert notes(line) =~ "Nobody steers it: channels stopped"
      height = state.().flight.alt
      line = steer(line, 3, 800)
      assert notes(line) =~ "Sticks are back"
      assert state.().armed and state.().flight.alt > height
      # The new ones hold for a second again, and whoever they are from.
      line = Line.run(line, 1_200_000)
      line = line |> sticks(800, 240) |> Line.run(200_000)
      assert {_at, [_, _, 1800 | _]} = List.last(raw(line))
      line = line |> sticks(300) |> Line.run(200_000)
      assert {_at, [_, _, 1800 | _]} = List.last(raw(line))
    end

    test "#{firmware}: while nobody steers it is disarmed by force in the air, and without on the ground, by anybody" do
      for {down, force, result} <- [{0, 21_196, @accepted}, {0, 0, @denied}, {100.0, 0, @accepted}] do
        {line, change, state} = flying(unquote(firmware))
        line = Line.run(line, 1_100_000)
        low = &%{&1.receiver | msp: List.replace_at(&1.receiver.msp, 2, 1000)}

        change.(
          &%{
            &1
            | flight: %{&1.flight | alt: max(&1.flight.alt - down, 0.0)},
              receiver: low.(&1),
              rc_at: &1.now
          }
        )

        line = Line.run(line, 600_000)
        line = command(line, @arm, [0, force], 240)
        assert state.().armed or result == @accepted
        line = if result == @denied, do: line, else: Line.run(line, @second)
        assert List.last(acks(line, @arm)) == result
        assert state.().armed == (result == @denied)
        refute notes(line) =~ "transmitter"
      end
    end

    test "#{firmware}: a session that finds the vehicle armed and nobody steering has it by sticks, and disarms it" do
      for end_by <- [:sticks, :force] do
        {line, change, state} = flying(unquote(firmware))
        # Another life of the gateway; the failsafe does not end it, but it comes down.
        change.(&%{&1 | rc_at: &1.now + 5 * @second})
        line = reopened(line, change)
        change.(&%{&1 | rc_at: &1.now - 300_000})
        line = Line.run(line, 300_000)
        assert state.().armed

        if end_by == :sticks do
          line = steer(line, 2, 800)
          assert {_at, [_, _, 1800 | _]} = List.last(raw(line))
          assert state.().armed
        else
          line = line |> command(@arm, [0, 21_196], 240) |> Line.run(2 * @second)
          assert List.last(acks(line, @arm)) == @accepted
          refute state.().armed
        end
      end
    end

    test "#{firmware}: what keeps it from being armed is said, and its switch stays off" do
      {line, change, state} = up(unquote(firmware), rx_msp: true)
      change.(&%{&1 | calibrating_until: &1.now + 60 * @second})
      line = line |> command(@arm, [1, 0]) |> Line.run(10 * @second)
      assert acks(line, @arm) == [@in_progress, @failed]
      assert notes(line) =~ "CALIBRATING"
      refute state.().armed
      assert Enum.all?(raw(line), fn {_at, channels} -> Enum.at(channels, 4) < 1700 end)
    end

    test "#{firmware}: a transmitter in charge stays in charge" do
      {line, change, state} = up(unquote(firmware), [])

      line =
        line |> command(@arm, [1, 0]) |> command(@set_mode, [1, 1]) |> sticks(900) |> Line.run(2 * @second)

      assert [@in_progress, @denied] = acks(line, @arm)
      assert @denied in acks(line, @set_mode)
      assert notes(line) =~ "a transmitter is in charge"
      assert raw(line) == []
      refute state.().armed
      # There is nothing to do.
      line = command(line, @arm, [0, 0])
      assert List.last(acks(line, @arm)) == @accepted
      change.(&Firmware.sticks(&1, [1500, 1500, 1000, 1500, 1900, 1000, 1000, 1000, 1000]))
      line = Line.run(line, 2 * @second)
      assert state.().armed
      line = line |> command(@arm, [0, 0]) |> Line.run(@second)
      assert List.last(acks(line, @arm)) == @denied
      assert state.().armed and raw(line) == []
    end

    test "#{firmware}: another program that sends channels stays in charge, and so does a client that steers" do
      {line, change, _state} = up(unquote(firmware), rx_msp: true)
      fed = fn line -> change.(&%{&1 | rc_at: &1.now}) && Line.run(line, 100_000) end
      line = Enum.reduce(1..10, line, fn _n, line -> fed.(line) end)
      line = Enum.reduce(1..10, command(line, @arm, [1, 0]), fn _n, line -> fed.(line) end)
      assert notes(line) =~ "another program sends its channels"
      line = line |> Line.run(3 * @second) |> command(@arm, [1, 0]) |> Line.run(4 * @second)
      assert List.last(acks(line, @arm)) == @accepted
      line = line |> command(@set_mode, [1, 0], 240) |> sticks(1000, 240) |> Line.run(100_000)
      assert notes(line) =~ "another client steers it"
      assert {_at, [_, _, 1000 | _]} = List.last(raw(line))
      # Anybody whom the policy lets may disarm it.
      line = line |> command(@arm, [0, 0], 240) |> Line.run(@second)
      assert List.last(acks(line, @arm)) == @accepted
    end

    test "#{firmware}: its own channels, which just ended, are not another program's" do
      {line, _change, state} = up(unquote(firmware), rx_msp: true)
      line = line |> command(@arm, [1, 0]) |> Line.run(4 * @second) |> command(@arm, [0, 0])
      line = Enum.find(Stream.iterate(line, &Line.run(&1, 20_000)), &(&1.session.sticks.receiver == nil))
      refute state.().armed
      line = line |> command(@arm, [1, 0]) |> Line.run(4 * @second)
      assert List.last(acks(line, @arm)) == @accepted
      refute notes(line) =~ "another program"
    end

    test "#{firmware}: a mode by its switch alone, one without a range not at all" do
      {line, _change, state} = up(unquote(firmware), rx_msp: true)
      line = line |> command(@set_mode, [1, 1]) |> Line.run(@second)
      assert 1 in state.().boxes
      line = line |> command(@set_mode, [1, 0]) |> Line.run(@second)
      refute 1 in state.().boxes
      line = line |> command(@set_mode, [1, 2]) |> Line.run(@second)
      assert List.last(acks(line, @set_mode)) == @denied
      assert notes(line) =~ "its switches cannot select HORIZON"
      # A failsafe is not a mode that one chooses.
      line = command(line, @set_mode, [1, 27])
      assert List.last(acks(line, @set_mode)) == 3
    end
  end

  test "in Betaflight's first seconds nobody is blamed for channels that it does not miss: try again" do
    {line, change, state} = up(:betaflight, rx_msp: true)
    change.(&%{&1 | started: &1.now})
    line = line |> Line.run(@second) |> command(@arm, [1, 0]) |> Line.run(@second)
    assert acks(line, @arm) == [@in_progress, @temporarily]
    assert notes(line) =~ "it was just switched on"
    refute notes(line) =~ "another program"
    assert raw(line) == []
    # As soon as it is over, although the flag of a receiver that is missed may come later.
    line = line |> Line.run(3_300_000) |> command(@arm, [1, 0]) |> Line.run(4 * @second)
    assert List.last(acks(line, @arm)) == @accepted
    assert state.().armed
  end

  test "iNav: the pilot hands the channels over, and has them back when they stop" do
    {line, change, state} = up(:inav, mask: 0xFFFF)
    high = [1500, 1500, 1000, 1500, 1000, 1000, 1000, 1900]
    change.(&Firmware.sticks(&1, high))
    line = line |> Line.run(@second) |> command(@arm, [1, 0]) |> Line.run(5 * @second)
    assert state.().armed
    assert notes(line) =~ "the pilot handed them over"
    line = line |> command(@set_mode, [1, 10]) |> Line.run(@second)
    assert 10 in state.().boxes
    line = Line.run(line, 12 * @second)
    refute state.().armed
    refute 10 in state.().boxes
    assert {last, _} = List.last(raw(line))
    assert line.now - last > @second
  end

  test "iNav: channels that the mask keeps are seen, and it is not armed by others' channels" do
    {line, change, state} = up(:inav, mask: 0b1111)
    change.(&Firmware.sticks(&1, [1500, 1500, 1000, 1500, 1000, 1000, 1000, 1900]))
    line = line |> Line.run(@second) |> command(@arm, [1, 0]) |> Line.run(10 * @second)
    # The arm channel is the pilot's: it does not arrive, so nothing arms.
    refute state.().armed
    assert List.last(acks(line, @arm)) == @failed
  end

  test "Betaflight before 2026.6 keeps overridden channels for ever, so it is refused" do
    {line, change, _state} = up(:betaflight, mask: 0xFFFF)
    change.(&%{&1 | blocks: Map.update!(&1.blocks, 119, fn ids -> ids <> <<50>> end)})
    line = Line.run(line, 11 * @second)
    change.(&put_in(&1.blocks[34], <<50, 3, 32, 48>> <> binary_part(&1.blocks[34], 4, 76)))
    change.(&Firmware.sticks(&1, [1500, 1500, 1000, 1500, 1000, 1000, 1000, 1900]))
    line = line |> Line.run(@second) |> command(@arm, [1, 0]) |> Line.run(@second)
    assert notes(line) =~ "keeps the last channels"
    assert raw(line) == []
  end

  test "channels by number: the arm channel is not touched, others are given back" do
    {line, _change, state} = up(:inav, rx_msp: true)
    line = line |> command(@set_mode, [1, 0]) |> Line.run(@second)

    override = %M.RcChannelsOverride{
      target_system: 42,
      target_component: 1,
      chan1_raw: 1600,
      chan5_raw: 2000,
      chan7_raw: 1250
    }

    line = line |> send_mavlink(override) |> Line.run(200_000)
    assert [1600, 1500, 1000, 1500, arm, _, 1250 | _] = state.().channels
    assert arm < 1700
    give_back = %M.RcChannelsOverride{target_system: 42, target_component: 1, chan1_raw: 0, chan7_raw: 0}
    line = line |> send_mavlink(give_back) |> Line.run(200_000)
    assert [1500, 1500 | _] = state.().channels
    refute state.().armed
    assert line.failed == nil
  end

  describe "a motor test" do
    @motor_test 209

    test "one motor turns for its time, and stands still afterwards, acknowledged as the vehicle did" do
      {line, _change, state} = up(:betaflight, [])
      line = command(line, @motor_test, [2, 0, 15, 1])
      assert acks(line, @motor_test) == [@accepted]
      assert [1000, 1150, 1000, 1000 | _] = motors(state)
      line = Line.run(line, 1_500_000)
      assert Enum.max(motors(state)) == 1000

      assert acks(line |> command(@motor_test, [1, 0, 100, 0.5]) |> Line.run(@second), @motor_test) == [
               @accepted,
               @accepted
             ]
    end

    test "refused: a motor that is not there, too long, beyond 100 %, while it is armed, with motors that turn both ways" do
      {line, change, state} = up(:betaflight, [])
      line = command(line, @motor_test, [5, 0, 10, 1])
      line = command(line, @motor_test, [1, 0, 10, 4])
      line = command(line, @motor_test, [1, 0, 101, 1])
      line = command(line, @motor_test, [1, 1, 10, 1])
      assert acks(line, @motor_test) == [@denied, @denied, @denied, @denied]
      assert notes(line) =~ "it has no motor 5"
      change.(&%{&1 | blocks: Map.update!(&1.blocks, 36, fn <<f::32-little>> -> <<f + 4096::32-little>> end)})
      line = command(line, @motor_test, [1, 0, 10, 1])
      assert notes(line) =~ "its motors turn both ways"
      change.(&Firmware.sticks(&1, [1500, 1500, 1000, 1500, 1900, 1000, 1000, 1000]))
      line = line |> Line.run(@second) |> command(@motor_test, [1, 0, 10, 1])
      assert notes(line) =~ "Motor test: it is armed"
      assert length(acks(line, @motor_test)) == 6 and @accepted not in acks(line, @motor_test)
      assert Enum.max(motors(state)) == 1000
    end

    test "stopped when the line is closed, and when a vehicle is found whose motors somebody left on" do
      {line, change, state} = up(:betaflight, [])
      line = command(line, @motor_test, [1, 0, 20, 3])
      assert Enum.max(motors(state)) == 1200
      line = Line.handle(line, :closing)
      change.(fn fc -> fc |> Firmware.step(50_000) |> elem(0) end)
      assert Enum.max(motors(state)) == 1000
      assert [{_at, last} | _] = line.written
      assert <<"$M<", 16, 214, _::binary>> = last
      # Another session, as after kill -9 of the gateway.
      for firmware <- [:betaflight, :inav], us <- [1001, 1045, 1400] do
        {answer, change, state} = Simulated.controller(firmware)
        change.(&%{&1 | blocks: Map.put(&1.blocks, 104, <<us::16-little, 1000::16-little, 0::96>>)})
        line = Line.open(fn bytes, us -> with("" <- answer.(bytes, us), do: nil) end) |> Line.run(4 * @second)
        assert Enum.max(motors(state)) == 1000
        assert notes(line) =~ "somebody left them on"
      end
    end

    test "the value that stops iNav's motors is its min_command" do
      {answer, change, state} = Simulated.controller(:inav)
      {:ok, misc} = MavCodec.Msp.Messages.fetch(:inav, "MSP2_INAV_MISC")
      block = state.().blocks[misc.id]
      {:ok, values} = MavCodec.Msp.Payload.decode(misc.reply, block, {9, 0})
      {:ok, block} = MavCodec.Msp.Payload.encode(misc.reply, %{values | min_command: 1050}, {9, 0})
      still = :binary.copy(<<1050::16-little>>, 4) <> <<0::64>>
      change.(&%{&1 | blocks: Map.merge(&1.blocks, %{misc.id => block, 104 => still})})
      line = Line.open(fn bytes, us -> with("" <- answer.(bytes, us), do: nil) end) |> Line.run(7 * @second)
      refute notes(line) =~ "left them on"
      line = command(line, @motor_test, [2, 0, 10, 1])
      assert [1050, 1100, 1050, 1050 | _] = motors(state)
      _line = Line.run(line, 2 * @second)
      assert [1050, 1050, 1050, 1050 | _] = motors(state)
    end

    test "motors that were set before it was armed are stopped once it is disarmed" do
      {line, change, state} = up(:betaflight, [])
      line = command(line, @motor_test, [1, 0, 4, 0.5])
      change.(&%{Firmware.sticks(&1, [1500, 1500, 1000, 1500, 1900]) | armed: true})
      line = Line.run(line, 3 * @second)
      assert state.().armed and Enum.max(motors(state)) == 1040
      change.(&Firmware.sticks(&1, [1500, 1500, 1000, 1500, 1000]))
      _line = Line.run(line, 2 * @second)
      assert not state.().armed and Enum.max(motors(state)) == 1000
    end

    test "a stop that is lost is repeated until the motors stand still" do
      {answer, _change, state} = Simulated.controller(:betaflight)
      {:ok, lost} = Agent.start_link(fn -> 0 end)

      line =
        Line.open(fn bytes, us ->
          stop? = match?(<<"$M<", 16, 214, 1000::16-little, _::binary>>, bytes)

          if stop? and Agent.get_and_update(lost, &{&1 < 4, &1 + 1}),
            do: nil,
            else: with("" <- answer.(bytes, us), do: nil)
        end)

      line = line |> Line.run(7 * @second) |> command(@motor_test, [1, 0, 20, 0.5]) |> Line.run(600_000)
      assert Enum.max(motors(state)) == 1200
      _line = Line.run(line, 2 * @second)
      assert Enum.max(motors(state)) == 1000
    end
  end

  defp motors(state), do: for(<<us::16-little <- state.().blocks[104]>>, do: us)

  # --- any clients, at any time

  defp wish do
    :proper_types.frequency([
      {3, {:arm, client()}},
      {2, {:disarm, client()}},
      {2, {:mode, :proper_types.oneof([0, 1, 2, 10, 27, 46]), client()}},
      {6, {:sticks, :proper_types.range(0, 1000), client()}},
      {3, {:override, :proper_types.range(1, 8), :proper_types.range(900, 2100), client()}},
      {1, :lost},
      {5, {:wait, :proper_types.range(1, 30)}},
      {1, {:wait, :proper_types.range(30, 140)}}
    ])
  end

  defp client, do: :proper_types.oneof([237, 240])

  defp wish(line, {:arm, client}, _change), do: command(line, @arm, [1, 0], client)
  defp wish(line, {:disarm, client}, _change), do: command(line, @arm, [0, 0], client)
  defp wish(line, {:mode, mode, client}, _change), do: command(line, @set_mode, [1, mode], client)
  defp wish(line, {:sticks, throttle, client}, _change), do: sticks(line, throttle, client)
  defp wish(line, {:wait, tenths}, _change), do: Line.run(line, tenths * 100_000)
  # Something else disarms it.
  defp wish(line, :lost, change), do: change.(&%{&1 | armed: false}) && line

  defp wish(line, {:override, n, us, client}, _change) do
    message = struct!(%M.RcChannelsOverride{target_system: 42, target_component: 1}, [{:"chan#{n}_raw", us}])
    send_mavlink(line, message, client)
  end

  test "whatever clients do: a motor runs only for one that is there, and the arm switch is on only for one that armed it" do
    property =
      :proper.forall({:proper_types.oneof([:betaflight, :inav]), :proper_types.list(wish())}, fn {firmware,
                                                                                                  wishes} ->
        {line, change, _state} = up(firmware, rx_msp: true)

        {line, log} =
          Enum.reduce(wishes, {line, []}, fn wish, {line, log} ->
            {wish(line, wish, change), [{line.now, wish} | log]}
          end)

        line = Line.run(line, 30 * @second)
        steered = for {at, wish} <- log, elem_or(wish) in [:sticks, :override], do: at
        armed = for {at, wish} <- log, elem_or(wish) == :arm, do: at
        any = for {at, wish} <- log, wish != :lost, elem_or(wish) != :wait, do: at
        frames = raw(line)

        idle? =
          Enum.all?(frames, fn {at, [_, _, throttle | _]} ->
            throttle == 1000 or Enum.any?(steered, &((at - &1) in 0..1_040_000))
          end)

        switched? =
          Enum.all?(frames, fn {at, channels} ->
            Enum.at(channels, 4) < 1700 or
              (Enum.any?(armed, &(&1 <= at)) and Enum.any?(any, &((at - &1) in 0..18_200_000)))
          end)

        # In the end nothing is sent any more.
        over? = frames == [] or line.now - elem(List.last(frames), 0) > @second
        idle? and switched? and over? and line.failed == nil
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 80, max_size: 25]) == true,
           inspect(:proper.counterexample())
  end

  defp elem_or(wish) when is_tuple(wish), do: elem(wish, 0)
  defp elem_or(wish), do: wish
end
