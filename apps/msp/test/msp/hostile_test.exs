defmodule Msp.HostileTest do
  @moduledoc "Whatever a line and its clients do: a session never raises, writes one checked request at a time, and goes on polling."
  use ExUnit.Case, async: true

  alias MavCodec.Messages, as: M
  alias MavCodec.Msp.{Frame, Guard, Messages, Parser, Payload}
  alias Msp.Session
  alias Msp.Test.{Controller, Line}

  @second 1_000_000

  test "any bytes, damaged replies, any MAVLink, at any time" do
    property =
      :proper.forall({:proper_types.oneof([:betaflight, :inav]), :proper_types.list(event())}, fn {firmware,
                                                                                                   events} ->
        {session, _} = Session.handle(Session.new(42), :opened, 0)
        start = %{session: session, now: 0, asked: nil, firmware: firmware, ok: true}
        Enum.reduce(List.duplicate(:answer, 12) ++ events, start, &step/2).ok
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 400]) == true, inspect(:proper.counterexample())
  end

  defp event do
    :proper_types.frequency([
      {6, :answer},
      {2, {:cut, :proper_types.range(0, 40)}},
      {2, {:any, :proper_types.binary()}},
      {1, {:bytes, :proper_types.binary()}},
      {1, :silence},
      {2,
       {:mavlink, :proper_types.oneof([list(), read(), set(), command(), mission(), :proper_types.binary()])}}
    ])
  end

  defp list, do: encoded(%M.ParamRequestList{target_system: 42})
  defp read, do: encoded(%M.ParamRequestRead{target_system: 42, param_id: "p_roll", param_index: -1})
  defp set, do: encoded(%M.ParamSet{target_system: 42, param_id: "small_angle", param_value: 77.0})
  defp command, do: encoded(%M.CommandLong{target_system: 42, command: 246, param1: 1.0})
  # Uploads that are begun, go on and are asked for in any order.
  defp mission do
    :proper_types.oneof(
      Enum.map(
        [
          %M.MissionCount{target_system: 42, count: 2},
          %M.MissionRequestList{target_system: 42},
          %M.MissionRequestInt{target_system: 42, seq: 1},
          %M.MissionItemInt{target_system: 42, seq: 0, command: 16, frame: 3, x: 1, y: 2, autocontinue: 1},
          %M.MissionItemInt{target_system: 42, seq: 1, command: 20, frame: 2, autocontinue: 1},
          %M.MissionAck{target_system: 42, type: 15},
          %M.MissionClearAll{target_system: 42}
        ],
        &encoded/1
      )
    )
  end

  defp encoded(message), do: MavCodec.encode(message, system: 255, component: 190)

  defp step({:mavlink, bytes}, state), do: handle(state, {:mavlink, bytes})
  defp step({:bytes, bytes}, state), do: handle(state, {:bytes, bytes})
  defp step(:silence, state), do: %{state | now: state.now + 2 * @second, asked: nil} |> handle(:tick)
  defp step(_answer, %{asked: nil} = state), do: %{state | now: state.now + 300_000} |> handle(:tick)
  defp step(:answer, state), do: reply(state, usual(state))
  defp step({:cut, bytes}, state), do: reply(state, binary_slice(usual(state), 0, bytes))
  defp step({:any, payload}, state), do: reply(state, payload)

  defp reply(%{asked: request} = state, payload) do
    bytes = Frame.encode(%{request | direction: :reply, payload: binary_slice(payload, 0, 500)})
    handle(%{state | now: state.now + 5_000, asked: nil}, {:bytes, bytes})
  end

  # What lets it come up, and zeros for the rest.
  defp usual(%{asked: %{id: id}, firmware: firmware}) do
    case {id, firmware} do
      {1, :betaflight} -> <<0, 1, 46>>
      {1, :inav} -> <<0, 2, 5>>
      {2, :betaflight} -> "BTFL"
      {2, :inav} -> "INAV"
      {3, :betaflight} -> <<4, 5, 5>>
      {3, :inav} -> <<9, 0, 0>>
      _other -> :binary.copy(<<0>>, 60)
    end
  end

  defp handle(state, event) do
    {session, actions} = Session.handle(state.session, event, state.now)
    written = for {:write, bytes} <- actions, do: bytes
    state = %{state | session: session}

    case written do
      [] ->
        state

      [bytes] ->
        {[frame], %{buffer: ""}} = Parser.push(Parser.new(), bytes)

        target =
          if session.identity,
            do: {session.identity.firmware, session.identity.version},
            else: {:betaflight, nil}

        %{
          state
          | asked: frame,
            ok: state.ok and match?({:ok, _}, Guard.check(frame, target)) and session.output.frames == []
        }

      _several ->
        %{state | ok: false}
    end
  end

  test "each reply cut at each length, of each message that is polled" do
    for firmware <- [:betaflight, :inav], {name, _poll} <- Msp.Polls.new(firmware, 0).polls, size <- 0..60 do
      {:ok, message} = Messages.fetch(firmware, name)
      version = %{betaflight: {1, 46}, inav: {9, 0}}[firmware]

      with {:ok, values} <- Payload.decode(message.reply, :binary.copy(<<1>>, size), version) do
        assert is_map(Msp.Readings.read(firmware, name, values, [0, 1]))
      end
    end
  end

  test "clients that ask without end do not silence the vehicle" do
    line =
      Controller.betaflight(%{"PID" => fn _us -> %{p_roll: 1} end}) |> Line.open() |> Line.run(3 * @second)

    line =
      Enum.reduce(1..4_000, line, fn n, line ->
        read = %M.ParamRequestRead{
          target_system: 42,
          param_id: "p_#{Enum.at(~w(roll pitch yaw), rem(n, 3))}",
          param_index: -1
        }

        line |> Line.handle({:mavlink, encoded(read)}) |> Line.run(5_000)
      end)

    beats = for {at, _} <- Line.told(line, M.Heartbeat), do: at
    assert length(beats) > 20
    assert beats |> Enum.chunk_every(2, 1, :discard) |> Enum.all?(fn [a, b] -> b - a < 1.5 * @second end)
    assert length(line.session.tasks.list) <= 16
  end

  test "text of a flight controller is shown as far as it can be" do
    line =
      Controller.betaflight(%{
        "NAME" => %{name: <<0xFF, 0, "böse", 27, "[2J">>},
        "FC_VARIANT" => %{variant: <<1, 2, 0xFE, ?X>>}
      })
      |> Line.open()
      |> Line.run(5 * @second)

    assert line.failed =~ ~s(calls itself "X")
    assert String.printable?(line.failed)
  end
end
