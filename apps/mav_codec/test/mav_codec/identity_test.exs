defmodule MavCodec.IdentityTest do
  @moduledoc "What is encoded is what is parsed and decoded: any message, any values, both versions."
  use ExUnit.Case, async: true

  import Bitwise

  alias MavCodec.{Message, Parser, Signing}
  alias MavCodec.Frame.Encoder
  alias MavCodec.Dialects.All
  alias MavCodec.Message.Value

  defp let(type, fun), do: :proper_types.bind(type, fun, false)

  defp message do
    ids = All.ids()

    let(:proper_types.oneof(ids), fn id ->
      module = All.module_for(id)
      {^id, _crc, base, extensions} = All.layout(module)
      fields = base ++ extensions

      fields
      |> Enum.map(fn {_key, type, length} -> value(type, length) end)
      |> List.to_tuple()
      |> let(fn values ->
        struct!(module, Enum.zip(Enum.map(fields, &elem(&1, 0)), Tuple.to_list(values)))
      end)
    end)
  end

  defp value(:char, length) when is_integer(length),
    do:
      :proper_types.resize(length, :proper_types.list(:proper_types.range(1, 255))) |> let(&text(&1, length))

  defp value(:uint8, length) when is_integer(length), do: :proper_types.binary(length)
  defp value(type, length) when is_integer(length), do: :proper_types.vector(length, value(type, nil))
  defp value(:float, nil), do: let(integer(32), &Value.float32/1)
  defp value(:double, nil), do: let(integer(64), &Value.float64/1)
  defp value(:char, nil), do: value(:char, 1)

  defp value(type, nil) do
    case Atom.to_string(type) do
      "uint" <> size -> integer(String.to_integer(size))
      "int" <> size -> size |> String.to_integer() |> integer() |> let(&signed(&1, String.to_integer(size)))
    end
  end

  # Often zero, so that truncation has something to cut.
  defp integer(bits) do
    max = (1 <<< bits) - 1
    :proper_types.oneof([0, 0, max, :proper_types.range(0, max)])
  end

  defp signed(value, bits), do: if(value >>> (bits - 1) == 0, do: value, else: value - (1 <<< bits))
  defp text(chars, length), do: chars |> Enum.take(length) |> :binary.list_to_bin()

  defp base(%module{} = message) do
    for %{extension: true, key: key} <- module.fields(), reduce: message do
      message -> Map.replace!(message, key, Map.fetch!(struct(module), key))
    end
  end

  test "one message, version 2, version 1, signed" do
    property =
      :proper.forall({message(), :proper_types.range(1, 255), :proper_types.range(0, 255)}, fn {message,
                                                                                                system, seq} ->
        options = [system: system, component: 7, seq: seq]
        parser = Parser.new()
        {[frame], _} = Parser.push(parser, MavCodec.encode(message, options))
        {bytes, _} = Signing.encode(Signing.new(<<1::256>>), message, options)
        {[signed], _} = Parser.push(parser, bytes)

        MavCodec.decode(frame) == {:ok, message} and MavCodec.decode(signed) == {:ok, message} and
          {frame.system, frame.component, frame.seq} == {system, 7, seq} and
          match?({:signed, _}, Signing.check(Signing.new(<<1::256>>), signed)) and
          (frame.id > 255 or v1(message, options) == {:ok, base(message)})
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 1000]) == true, inspect(:proper.counterexample())
  end

  defp v1(message, options) do
    {[%{version: 1} = frame], _} =
      Parser.push(Parser.new(), MavCodec.encode(message, [{:version, 1} | options]))

    MavCodec.decode(frame)
  end

  test "many messages as one stream, in order, with sequence numbers" do
    property =
      :proper.forall(:proper_types.list(message()), fn messages ->
        {frames, _} = Enum.map_reduce(messages, Encoder.new(system: 1, component: 2), &Encoder.encode(&2, &1))
        {parsed, parser} = Parser.push(Parser.new(), IO.iodata_to_binary(frames))
        stats = Parser.stats(parser)

        Enum.map(parsed, &elem(MavCodec.decode(&1), 1)) == messages and
          Enum.map(parsed, & &1.seq) == Enum.map(Enum.with_index(messages), &(elem(&1, 1) &&& 255)) and
          stats.lost == 0 and stats.resync_bytes == 0
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 100]) == true, inspect(:proper.counterexample())
  end

  test "R7: numbers count per source and wrap" do
    heartbeat = %MavCodec.Messages.Heartbeat{}

    {_, encoder} =
      Enum.map_reduce(1..256, Encoder.new(system: 1, seq: 99), fn _, encoder ->
        Encoder.encode(encoder, heartbeat)
      end)

    {<<0xFD, _::24, seq, _::binary>>, encoder} = Encoder.encode(encoder, heartbeat)
    assert seq == 0
    {<<0xFD, _::24, seq, _::binary>>, encoder} = Encoder.encode(encoder, heartbeat, component: 190)
    assert seq == 0

    {<<0xFE, _len, seq, 1, 1, 0, _::binary>>, encoder} =
      Encoder.encode(encoder, heartbeat, version: 1)

    assert seq == 1
    {<<0xFD, _::24, seq, _::binary>>, _} = Encoder.encode(encoder, heartbeat)
    assert seq == 2
  end

  test "errors name the field, what was expected and what was given" do
    heartbeat = %MavCodec.Messages.Heartbeat{}

    for {options, text} <- [
          {[system: 0], ~r/system to be a system id from 1 to 255, got: 0/},
          {[system: 256], ~r/from 1 to 255, got: 256/},
          {[system: 1, component: 256], ~r/component to be .* got: 256/},
          {[system: 1, version: 3], ~r/version to be 1 or 2, got: 3/}
        ] do
      assert_raise MavCodec.Message.EncodeError, text, fn -> MavCodec.encode(heartbeat, options) end
    end

    assert_raise KeyError, ~r/:system/, fn -> MavCodec.encode(heartbeat, []) end

    assert_raise MavCodec.Message.EncodeError, ~r/type/, fn ->
      MavCodec.encode(%{heartbeat | type: 256}, system: 1)
    end

    assert_raise MavCodec.Message.EncodeError, ~r/payload/, fn ->
      MavCodec.Frame.Raw.frame(0, <<0::size(256)-unit(8), 1>>, 50, system: 1)
    end
  end

  test "F7: the first byte is never cut" do
    assert <<0xFD, 1, _::binary>> = MavCodec.encode(%MavCodec.Messages.RawRpm{}, system: 1)
    assert Message.trim(<<0, 0, 0>>) == <<0>>
    assert Message.trim(<<1, 0>>) == <<1>>
  end
end
