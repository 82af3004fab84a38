defmodule Msp.ExchangeTest do
  use ExUnit.Case, async: true

  alias MavCodec.Msp.Frame
  alias Msp.Exchange

  doctest Msp.Firmware.Arming
  doctest Msp.Identity
  doctest Msp.Modes

  defp reply(id, payload \\ "", direction \\ :reply),
    do: Frame.encode(%Frame{id: id, direction: direction, payload: payload})

  defp asked(id, payload \\ "") do
    {_bytes, exchange} = Exchange.send(Exchange.new(), :task, :mine, %Frame{id: id, payload: payload}, 0)
    exchange
  end

  test "one request at a time, and ten milliseconds between two" do
    exchange = asked(108)
    frame = %Frame{id: 109}
    assert Exchange.ready(exchange, :task, frame, 5_000) == :busy
    {[{:reply, :mine, %Frame{payload: "abc"}}], exchange} = Exchange.push(exchange, reply(108, "abc"), 5_000)
    assert Exchange.ready(exchange, :task, frame, 5_000) == {:at, 10_000}
    assert Exchange.ready(exchange, :task, frame, 10_000) == :now
  end

  test "a refusal is one, another id is not ours" do
    assert {[{:refused, :mine}], _} = Exchange.push(asked(108), reply(108, "", :error), 5)
    {[{:unasked, %Frame{id: 182}}], exchange} = Exchange.push(asked(108), reply(182, <<0>>), 5)
    assert %{task: %{tag: :mine}} = exchange.asked
    # Not even a request with the same id, as an echo is.
    assert {[{:unasked, %Frame{direction: :request}}], %{asked: %{task: %{tag: :mine}}}} =
             Exchange.push(asked(108), reply(108, "", :request), 5)
  end

  test "the time that replies take decides how long one is waited for" do
    assert Exchange.timeout_us(Exchange.new()) == 1_000_000

    exchange =
      Enum.reduce(1..40, Exchange.new(), fn n, exchange ->
        {_bytes, exchange} = Exchange.send(exchange, :task, n, %Frame{id: 108}, n * 1_000_000)
        {[_reply], exchange} = Exchange.push(exchange, reply(108), n * 1_000_000 + 100_000)
        exchange
      end)

    assert Exchange.timeout_us(exchange) == 400_000
    assert :wait = Exchange.expire(exchange, 90_000_000)
  end

  test "after its time a request is over, and its late reply is discarded" do
    assert :wait = Exchange.expire(asked(118, <<1>>), 999_999)
    {:timeout, :mine, [], exchange} = Exchange.expire(asked(118, <<1>>), 1_000_000)
    # The same message with other arguments waits until the late reply cannot come any more.
    assert {:at, 4_000_000} = Exchange.ready(exchange, :task, %Frame{id: 118, payload: <<2>>}, 1_100_000)
    assert :now = Exchange.ready(exchange, :task, %Frame{id: 118, payload: <<1>>}, 1_100_000)
    assert :now = Exchange.ready(exchange, :task, %Frame{id: 109}, 1_100_000)
    {_bytes, exchange} = Exchange.send(exchange, :task, :next, %Frame{id: 109}, 1_100_000)

    {[{:late, :mine, %Frame{payload: "late"}, 0}], exchange} =
      Exchange.push(exchange, reply(118, "late"), 1_200_000)

    assert %{late: 1, timeouts: 1} = Exchange.counters(exchange)
    # It has come: nothing has to be waited for.
    assert {[{:reply, :next, _}], exchange} = Exchange.push(exchange, reply(109), 1_300_000)
    assert :now = Exchange.ready(exchange, :task, %Frame{id: 118, payload: <<2>>}, 1_400_000)
  end

  test "while the reply of one lane is overdue the other goes on, but never with the same message" do
    exchange = learned(30_000)
    {_bytes, exchange} = Exchange.send(exchange, :task, :read, %Frame{id: 112}, 90_000_000, 5_000_000)
    assert {:at, 90_060_000} = Exchange.ready(exchange, :state, %Frame{id: 108}, 90_010_000)
    assert :busy = Exchange.ready(exchange, :task, %Frame{id: 108}, 90_100_000)
    assert :busy = Exchange.ready(exchange, :state, %Frame{id: 112}, 90_100_000)
    assert :now = Exchange.ready(exchange, :state, %Frame{id: 108}, 90_100_000)
    {_bytes, exchange} = Exchange.send(exchange, :state, :poll, %Frame{id: 108}, 90_100_000, 100_000)
    assert Exchange.deadline(exchange) == 90_220_000
    # Each has its own.
    {[{:reply, :poll, _}, {:reply, :read, _}], _exchange} =
      Exchange.push(exchange, IO.iodata_to_binary([reply(108), reply(112)]), 90_130_000)
  end

  test "replies that come late teach how long they take" do
    for usual <- [nil, 20_000] do
      exchange = if usual, do: learned(usual), else: Exchange.new()
      {_bytes, exchange} = Exchange.send(exchange, :state, :a, %Frame{id: 108}, 90_000_000)
      {:timeout, :a, [], exchange} = Exchange.expire(exchange, 91_000_000)
      {_bytes, exchange} = Exchange.send(exchange, :state, :b, %Frame{id: 109}, 91_000_000)
      {[{:late, :a, _, 90_000_000}], exchange} = Exchange.push(exchange, reply(108), 91_300_000)
      assert Exchange.timeout_us(exchange) == 2_600_000
    end

    # Of one that was asked again: the first one's reply, as that of the second cannot come so late.
    {_bytes, exchange} = Exchange.send(Exchange.new(), :state, :a, %Frame{id: 108}, 0)
    {:timeout, :a, [], exchange} = Exchange.expire(exchange, 1_000_000)
    {_bytes, exchange} = Exchange.send(exchange, :state, :b, %Frame{id: 108}, 1_000_000)
    {[{:reply, :b, _}], exchange} = Exchange.push(exchange, reply(108), 1_300_000)
    assert Exchange.timeout_us(exchange) == 2_600_000

    # One that was lost, and asked again, does not.
    exchange = learned(20_000)
    {_bytes, exchange} = Exchange.send(exchange, :state, :a, %Frame{id: 108}, 90_000_000)
    {:timeout, :a, [], exchange} = Exchange.expire(exchange, 90_250_000)
    {_bytes, exchange} = Exchange.send(exchange, :state, :b, %Frame{id: 108}, 90_250_000)
    {[{:reply, :b, _}], exchange} = Exchange.push(exchange, reply(108), 90_270_000)
    assert Exchange.timeout_us(exchange) == 80_000
  end

  defp learned(us) do
    Enum.reduce(1..40, Exchange.new(), fn n, exchange ->
      {_bytes, exchange} = Exchange.send(exchange, :task, n, %Frame{id: 108}, n * 1_000_000)
      {[_reply], exchange} = Exchange.push(exchange, reply(108), n * 1_000_000 + us)
      exchange
    end)
  end

  test "half a reply does not hide the next one" do
    {[], exchange} = Exchange.push(asked(108), "$M>" <> <<200, 108, 1, 2>>, 1)
    assert MavCodec.Msp.Parser.pending(exchange.parser) != ""
    {:timeout, :mine, [], exchange} = Exchange.expire(exchange, 1_000_000)
    {_bytes, exchange} = Exchange.send(exchange, :task, :next, %Frame{id: 109}, 1_000_000)

    assert {[{:reply, :next, %Frame{payload: "ok"}}], _} =
             Exchange.push(exchange, reply(109, "ok"), 1_010_000)
  end

  test "whatever comes, it answers each request at most once, and never with another's reply" do
    step =
      :proper_types.oneof([
        {:send, :proper_types.oneof([:state, :task]), :proper_types.range(1, 3), :proper_types.range(0, 2)},
        {:reply, :proper_types.range(1, 3)},
        {:bytes, :proper_types.binary()},
        {:wait, :proper_types.range(1, 2_000_000)}
      ])

    property =
      :proper.forall(:proper_types.list(step), fn steps ->
        {_exchange, _now, sent, answered} = Enum.reduce(steps, {Exchange.new(), 0, %{}, []}, &step/2)
        tags = for {tag, _id} <- answered, do: tag
        tags == Enum.uniq(tags) and Enum.all?(answered, fn {tag, id} -> sent[tag] == id end)
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 500]) == true
  end

  defp step({:send, lane, id, argument}, {exchange, now, sent, answered}) do
    frame = %Frame{id: id, payload: <<argument>>}

    if Exchange.ready(exchange, lane, frame, now) == :now do
      tag = map_size(sent)
      {_bytes, exchange} = Exchange.send(exchange, lane, tag, frame, now)
      {exchange, now, Map.put(sent, tag, id), answered}
    else
      {exchange, now, sent, answered}
    end
  end

  defp step({:reply, id}, state), do: step({:bytes, reply(id)}, state)

  defp step({:bytes, bytes}, {exchange, now, sent, answered}) do
    {answers, exchange} = Exchange.push(exchange, bytes, now)
    {exchange, now, sent, answered ++ for({:reply, tag, frame} <- answers, do: {tag, frame.id})}
  end

  defp step({:wait, us}, {exchange, now, sent, answered}) do
    case Exchange.expire(exchange, now + us) do
      :wait -> {exchange, now + us, sent, answered}
      {:timeout, _tag, _answers, exchange} -> {exchange, now + us, sent, answered}
    end
  end
end
