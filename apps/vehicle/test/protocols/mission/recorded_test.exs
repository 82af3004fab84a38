defmodule Protocols.Mission.RecordedTest do
  @moduledoc "Transfers against what real firmware said to a ground station that sent the same plan."
  use ExUnit.Case, async: true

  alias Protocols.Mission.{Item, Transfer}
  alias Aerie.Vehicle.Firmware
  alias MavCodec.Messages, as: M

  @fixtures Path.expand("../../../../vehicle/test/fixtures", __DIR__)
  @station {255, 190}
  @vehicle {1, 1}

  # `{from, message}` in order.
  defp recorded(name) do
    path = Path.join(@fixtures, name <> "_missions.tlog.gz")

    {records, decoder} =
      MavCodec.Tlog.Decoder.push(MavCodec.Tlog.Decoder.new(), :zlib.gunzip(File.read!(path)))

    for %MavCodec.Frame{} = frame <- records ++ MavCodec.Tlog.Decoder.finish(decoder) do
      {:ok, message} = MavCodec.decode(frame)
      {{frame.system, frame.component}, message}
    end
  end

  # The messages from the n-th MISSION_COUNT (or MISSION_CLEAR_ALL) of the station to its next one.
  defp exchange(name, n) do
    recorded(name)
    |> Enum.chunk_while(
      [],
      fn {from, message} = heard, chunk ->
        if from == @station and message.__struct__ in [M.MissionCount, M.MissionClearAll],
          do: {:cont, Enum.reverse(chunk), [heard]},
          else: {:cont, [heard | chunk]}
      end,
      &{:cont, Enum.reverse(&1), []}
    )
    |> Enum.at(n)
  end

  defp items(exchange) do
    for({@station, %M.MissionItemInt{} = m} <- exchange, uniq: true, do: {m.seq, Item.read(m)})
    |> Enum.map(&elem(&1, 1))
  end

  # The transfer sends the same plan; it hears what the vehicle said then. What it sent, and what it came to.
  defp replay(exchange, protocol, type) do
    {:ok, transfer} =
      Transfer.new({:upload, items(exchange)}, type,
        protocol: protocol,
        kind: "copter",
        target: @vehicle,
        us: @station,
        until: 60_000_000
      )

    {transfer, actions} = Transfer.handle(transfer, {:start, 0})

    for({@vehicle, message} <- exchange, do: message)
    |> Enum.with_index(1)
    |> Enum.reduce({transfer, actions}, fn {message, n}, {transfer, all} ->
      {transfer, actions} = Transfer.handle(transfer, {:message, message, @vehicle, n * 1000})
      {transfer, all ++ actions}
    end)
  end

  defp sent(actions), do: for({:send, message} <- actions, do: message)

  defp result(actions),
    do: Enum.find_value(actions, fn action -> match?({:result, _}, action) && elem(action, 1) end)

  defp words(%module{} = message) do
    fields = [:seq, :count, :mission_type, :type, :command, :frame, :param1, :param2, :param4, :x, :y, :z]
    {module, Map.take(message, fields)}
  end

  for {name, protocol} <- [
        {"arducopter_flight", Firmware.Ardupilot.Adapter},
        {"px4_flight", Firmware.Px4.Adapter}
      ],
      {type, what} <- [{0, "mission"}, {1, "fence"}, {2, "rally points"}] do
    test "#{name}: the #{what}, word for word, and read back" do
      exchange = exchange(unquote(name), unquote(type) + 1)
      {transfer, actions} = replay(exchange, unquote(protocol), unquote(type))

      # pymavlink ended the last download without MISSION_ACK where the recording was cut.
      ours = Enum.map(sent(actions), &words/1)
      theirs = for {@station, message} <- exchange, do: words(message)
      assert List.starts_with?(ours, Enum.take(theirs, length(ours)))

      case result(actions) do
        # A fence that nobody rejects is valid after a while.
        nil ->
          {_transfer, actions} = Transfer.handle(transfer, {:tick, Transfer.wake_at(transfer)})
          assert %{on_board: :new, status: status} = result(actions)
          assert status in [:completed, :accepted]

        result ->
          assert %{status: :completed, on_board: :new} = result
      end
    end
  end

  test "px4_flight: the mission's id is that of the acknowledgement, and MISSION_CURRENT shows that it can be flown" do
    exchange = exchange("px4_flight", 1)
    {transfer, actions} = replay(exchange, Firmware.Px4.Adapter, 0)
    assert result(actions) == nil

    [id] = for {@vehicle, %M.MissionAck{opaque_id: id}} <- exchange, do: id
    current = for {@vehicle, %M.MissionCurrent{mission_id: ^id} = m} <- recorded("px4_flight"), do: m
    {_transfer, actions} = hear(transfer, hd(current))
    assert %{status: :completed, opaque_id: ^id} = result(actions)
  end

  test "px4_refusals: a command and a frame that it does not support" do
    for {n, reason} <- [{1, {:doubt, 3}}, {2, {:doubt, 2}}] do
      {transfer, actions} = replay(exchange("px4_refusals", n), Firmware.Px4.Adapter, 0)
      # All items were sent: what is on board is to be read.
      assert %{phase: :settling, cause: ^reason} = transfer
      assert %M.MissionAck{type: 15} = List.last(sent(actions))
    end
  end

  test "px4_refusals: accepted, and rejected by an EVENT three milliseconds later" do
    exchange = exchange("px4_refusals", 4)
    assert Enum.any?(exchange, &match?({@vehicle, %M.Event{id: 22_271_714}}, &1))
    {transfer, actions} = replay(exchange, Firmware.Px4.Adapter, 0)
    assert result(actions) == nil

    # It stores it nevertheless.
    items = items(exchange)
    {transfer, _} = hear(transfer, %M.MissionCount{count: length(items), opaque_id: transfer.opaque_id})

    {_transfer, actions} =
      items
      |> Enum.with_index()
      |> Enum.reduce({transfer, []}, fn {item, seq}, {t, _} ->
        hear(t, Item.message(item, seq, 0, @station))
      end)

    assert %{status: :rejected, on_board: :new, reason: reason} = result(actions)
    assert reason == "PX4 rejected it after the upload: it needs a take-off"
  end

  defp hear(transfer, message), do: Transfer.handle(transfer, {:message, message, @vehicle, 500_000})
end
