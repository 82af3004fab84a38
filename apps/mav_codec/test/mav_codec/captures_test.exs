defmodule MavCodec.CapturesTest do
  @moduledoc "Streams of real autopilot firmware, counted as in test/fixtures/captures/README.md."
  use ExUnit.Case, async: true

  alias MavCodec.{Frame, Messages, Parser}
  alias MavCodec.Test.Captures

  # Reads of changing size, as a socket gives them.
  defp parse(data, sizes \\ [1448, 21, 4096, 1, 300]) do
    {chunks, _} = cut(data, Stream.cycle(sizes))

    {frames, parser} = Enum.flat_map_reduce(chunks, Parser.new(), &Parser.push(&2, &1))
    {[], parser} = Parser.flush(parser)
    {frames, Parser.stats(parser)}
  end

  defp cut(data, sizes) do
    Enum.reduce_while(sizes, {[], data}, fn size, {chunks, data} ->
      case data do
        <<chunk::binary-size(^size), rest::binary>> -> {:cont, {[chunk | chunks], rest}}
        last -> {:halt, {Enum.reverse([last | chunks]), ""}}
      end
    end)
  end

  defp count(frames, module), do: Enum.count(frames, &(&1.id == module.id()))

  test "ArduPilot: boot text before the first frame, then a flight without a bad byte" do
    {frames, stats} = "arducopter_flight.bin" |> Captures.read() |> parse()

    assert %{frames: 21_526, resync_bytes: 160, crc_errors: 0, unknown_ids: 0, signed: 0, bytes: 773_522} =
             stats

    assert %{{1, 1} => %{received: 21_526, lost: 0, late: 0, restarts: 0}} = stats.sources
    assert Enum.all?(frames, &(&1.version == 2))
    assert count(frames, Messages.Attitude) == 3130
    assert count(frames, Messages.ParamValue) == 1446
    assert count(frames, Messages.Heartbeat) == 164
    assert count(frames, Messages.EscTelemetry1To4) == 612
    assert Enum.all?(frames, &match?({:ok, _}, MavCodec.decode(&1)))
  end

  test "the result does not depend on how the bytes are cut" do
    data = "arducopter_flight.bin" |> Captures.read() |> binary_part(0, 30_000)
    assert parse(data, [30_000]) == parse(data, [1])
    assert parse(data, [30_000]) == parse(data, [7, 100, 13])
  end

  test "ArduPilot with MAVLink 1" do
    {frames, stats} = "arducopter_mavlink1.bin" |> Captures.read() |> parse()
    assert %{frames: 9928, resync_bytes: 160, crc_errors: 0, unknown_ids: 0} = stats
    assert %{{1, 1} => %{received: 9928, lost: 0}} = stats.sources
    assert Enum.all?(frames, &(&1.version == 1))
    assert count(frames, Messages.ParamValue) == 1436
    assert Enum.all?(frames, &match?({:ok, _}, MavCodec.decode(&1)))
  end

  test "ArduPilot signing, and forwarded heartbeats whose numbers have gaps by nature" do
    {frames, stats} = "arducopter_signed.bin" |> Captures.read() |> parse()
    assert %{frames: 11_039, resync_bytes: 160, crc_errors: 0, signed: 6604, lost: 0} = stats

    assert %{{1, 1} => %{received: 10_998, lost: 0}, {254, 190} => %{received: 41, ratio: nil}} =
             stats.sources

    assert Enum.count(frames, &Frame.signed?/1) == 6604
    assert Enum.all?(frames, &match?({:ok, _}, MavCodec.decode(&1)))
  end

  test "Rover" do
    {_, stats} = "ardurover_drive.bin" |> Captures.read() |> parse()
    assert %{frames: 9556, resync_bytes: 159, crc_errors: 0, unknown_ids: 0} = stats
    assert %{{3, 1} => %{received: 9556, lost: 0}} = stats.sources
  end

  test "what the ground station sent" do
    {frames, stats} = "arducopter_signed_tx.bin" |> Captures.read() |> parse()
    assert %{frames: 100, resync_bytes: 0, crc_errors: 0} = stats
    assert count(frames, Messages.SetupSigning) == 1
    assert count(frames, Messages.Heartbeat) == 93
  end

  test "PX4 1.17: numbers out of order, 27 times, and none lost" do
    {frames, parser} =
      "px4_flight_start.tlog"
      |> Captures.records()
      |> Enum.flat_map_reduce(Parser.new(), fn {at, datagram}, parser ->
        Parser.push_datagram(parser, datagram, at)
      end)

    stats = Parser.stats(parser)
    assert %{frames: 2000, resync_bytes: 0, crc_errors: 0, unknown_ids: 0, lost: 0} = stats
    assert %{{1, 1} => %{received: 2000, lost: 0, missing: 0, restarts: 0, late: late}} = stats.sources
    assert late in 8..27
    steps = Enum.zip_with(frames, tl(frames), &rem(&2.seq - &1.seq + 256, 256))
    assert Enum.count(steps, &(&1 != 1)) == 27
    assert Enum.all?(frames, &match?({:ok, _}, MavCodec.decode(&1)))
  end
end
