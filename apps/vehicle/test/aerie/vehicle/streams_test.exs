defmodule Aerie.Vehicle.StreamsTest do
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.Streams
  alias MavCodec.Messages.{CommandLong, RequestDataStream}

  @second 1_000_000
  @all [245, 33, 30, 74, 1, 24, 147, 42, 65, 148, 242]

  # Expires once a second; the messages as {second, message}. `heard` says which ids come in a second.
  defp run(seconds, heard, streams \\ Streams.new()) do
    Enum.flat_map_reduce(seconds, streams, fn second, streams ->
      streams = Enum.reduce(heard.(second), streams, &Streams.heard(&2, &1, second * @second))
      {streams, messages} = Streams.expire(streams, second * @second, {1, 1})
      {Enum.map(messages, &{second, &1}), streams}
    end)
  end

  test "M3: who sends everything is asked for nothing" do
    assert {[], _} = run(0..100, fn _ -> @all end)
  end

  test "nothing before the vehicle was heard" do
    assert {[], _} = run(0..100, fn _ -> [] end)
  end

  test "M1: only what is missing, by SET_MESSAGE_INTERVAL, after a moment's grace" do
    {sent, _} = run(0..4, fn _ -> @all -- [245, 148] end)

    assert [
             {2,
              %CommandLong{
                command: 511,
                param1: 245.0,
                param2: 500_000.0,
                target_system: 1,
                target_component: 1
              }},
             {2, %CommandLong{command: 512, param1: 148.0}}
           ] = sent
  end

  test "who obeys no command gets one REQUEST_DATA_STREAM, and then is left alone" do
    {sent, _} = run(0..600, fn _ -> [0] end)

    assert [{15, %RequestDataStream{req_stream_id: 0, start_stop: 1}}] =
             Enum.filter(sent, &match?({_, %RequestDataStream{}}, &1))

    assert sent |> Enum.map(&elem(&1, 0)) |> Enum.uniq() == [2, 5, 15]
  end

  test "a message that never comes is asked for three times in all" do
    {sent, _} = run(0..600, fn _ -> @all -- [65] end)
    assert Enum.map(sent, &elem(&1, 0)) == [2, 5, 15]
  end

  test "M3: what stopped is asked for again, after ten seconds and not for ever" do
    {sent, _} = run(0..600, fn second -> if second < 100, do: @all, else: @all -- [33] end)
    assert [{first, %CommandLong{command: 511, param1: 33.0}} | _] = sent
    assert first in 109..125
    assert length(sent) <= 4
  end

  test "R6: after a reboot it begins anew" do
    {_, streams} = run(0..100, fn _ -> @all end)
    {sent, _} = run(101..110, fn _ -> [0] end, Streams.rebooted(streams, 101 * @second))
    assert [{103, %CommandLong{}} | _] = sent
  end
end
