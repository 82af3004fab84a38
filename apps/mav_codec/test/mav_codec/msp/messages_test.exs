defmodule MavCodec.Msp.MessagesTest do
  use ExUnit.Case, async: true

  import MavCodec.Test.Msp, only: [bytes: 0, values: 2]

  alias MavCodec.Msp
  alias MavCodec.Test.MspTranscript
  alias MavCodec.Msp.{Definition, Field, Frame, Message, Messages, Parser, Payload}

  doctest MavCodec.Msp
  doctest MavCodec.Msp.Field
  doctest MavCodec.Msp.Messages
  doctest MavCodec.Msp.Payload

  @versions %{
    betaflight: [{1, 40}, {1, 42}, {1, 46}, {1, 48}, {1, 49}, nil],
    inav: [{7, 0}, {8, 0}, {9, 0}, nil]
  }
  @real %{betaflight: {1, 46}, inav: {9, 0}}

  defp holds(property, tests),
    do: assert(:proper.quickcheck(property, [:quiet, {:numtests, tests}]) == true)

  defp message(firmware, name), do: Messages.fetch(firmware, name) |> elem(1)

  for firmware <- [:betaflight, :inav] do
    describe "#{firmware}" do
      @firmware firmware

      test "each reply that the real firmware gave is read to its last byte, and written as the same bytes" do
        {frames, messages} =
          for {_asked, _answered, _request, reply} <- MspTranscript.read(@firmware),
              reply != nil,
              reduce: {0, MapSet.new()} do
            {frames, messages} ->
              {[frame], _parser} = Parser.push(Parser.new(), reply)
              {frames + check(@firmware, frame), MapSet.put(messages, frame.id)}
          end

        assert {frames, MapSet.size(messages)} == %{betaflight: {813, 97}, inav: {1576, 147}}[@firmware]
      end

      test "values of each message, for each version, are read as they were written" do
        for message <- Messages.all(@firmware),
            layout <- [message.request, message.reply],
            version <- @versions[@firmware] do
          holds(
            :proper.forall(values(layout, version), fn values ->
              {:ok, payload} = Payload.encode(layout, values, version)
              {:ok, read} = Payload.decode(layout, payload, version)
              Map.drop(read, counts(layout)) == values
            end),
            5
          )
        end
      end

      test "any payload of each message is refused or written back as it was, tail included" do
        for message <- Messages.all(@firmware), layout <- [message.request, message.reply] do
          holds(
            :proper.forall(bytes(), fn bytes ->
              case Payload.decode(layout, bytes, nil) do
                {:ok, values} ->
                  Payload.encode(layout, values, nil) == {:ok, bytes}

                {:error, why} ->
                  why =~ "it ends inside"
              end
            end),
            20
          )
        end
      end

      test "names and ids are unique, and every write says how long it may be" do
        messages = Messages.all(@firmware)
        assert messages == Enum.sort_by(messages, & &1.id)

        for %{kind: :write, never: nil} = message <- messages, message.request != [] do
          assert message.sizes != [] or message.min > 0 or message.each != nil or message.name == "SET_NAME",
                 message.name

          for size <- message.sizes, message.sizes != [0, 1] do
            # A field begins or the payload ends there.
            assert {:ok, _values} = Payload.decode(message.request, :binary.copy(<<1>>, size), nil)
          end
        end
      end
    end
  end

  # The counts of lists, which are made of them.
  defp counts(layout) do
    Enum.flat_map(layout, fn
      {:list, _key, count, _inner} when is_atom(count) and count != :rest -> [count]
      {:optional, inner} -> counts(inner)
      _other -> []
    end)
  end

  # A reply to the request that MULTIPLE_MSP combines has each message's reply inside.
  defp check(_firmware, %Frame{direction: :error}), do: 0

  defp check(firmware, %Frame{id: id, payload: payload} = frame) do
    case Messages.fetch(firmware, id) do
      {:ok, %{reply: [_ | _]} = message} ->
        assert {:ok, values} = Msp.decode(frame, {firmware, @real[firmware]})
        refute is_map_key(values, :tail), "#{message.name} has bytes of unknown meaning"
        assert Payload.encode(message.reply, values, @real[firmware]) == {:ok, payload}
        1

      _acknowledged ->
        assert payload == ""
        1
    end
  end

  test "the tables have what the seed asks for: 34 decoders and 21 encoders" do
    readable = Enum.count(Messages.all(:betaflight), &(&1.reply != []))

    writable =
      Enum.count(Messages.all(:betaflight), &(&1.kind == :write and &1.request != [] and &1.never == nil))

    assert readable >= 34 and writable >= 21
  end

  describe "versions" do
    test "the payload of a version has only the fields that this version has" do
      status = message(:betaflight, "STATUS_EX").reply
      old = <<1::16-little, 0::16, 0::16, 1::32-little, 0, 5::16-little, 3, 0, 0, 26, 4::32-little>>
      assert {:ok, %{mode_flags: 1, arming_disable_flags: 4} = values} = Payload.decode(status, old, {1, 40})
      refute is_map_key(values, :config_state)
      assert {:ok, %{config_state: 1, tail: <<9, 9>>}} = Payload.decode(status, old <> <<1, 9, 9>>, {1, 42})
    end

    test "SENSOR_ALIGNMENT, the only reply that lost bytes" do
      layout = message(:betaflight, "SENSOR_ALIGNMENT").reply
      assert {:ok, %{gyro1: 6, gyro2: 7}} = Payload.decode(layout, <<1, 2, 3, 4, 5, 6, 7>>, {1, 46})

      assert {:ok, %{mag_roll: 10, mag_yaw: -1} = values} =
               Payload.decode(layout, <<1, 2, 3, 4, 5, 10::16-little, 0::16, -1::16>>, {1, 47})

      refute is_map_key(values, :gyro1)
    end

    test "a message that came or went" do
      assert Message.in?(message(:betaflight, "MSP2_CLI_SETTING"), {1, 48})
      refute Message.in?(message(:betaflight, "MSP2_CLI_SETTING"), {1, 47})
      assert Message.in?(message(:betaflight, "SET_CF_SERIAL_CONFIG"), {1, 48})
      refute Message.in?(message(:betaflight, "SET_CF_SERIAL_CONFIG"), {1, 49})
    end
  end

  test "scales give the number that is written, without a tail of digits" do
    fields = message(:betaflight, "RAW_GPS").reply
    value = fn key, raw -> Field.value(Enum.find(fields, &(&1.key == key)), raw) end
    assert value.(:lat, 473_977_420) == 47.397742
    assert value.(:course, 1234) == 123.4
    assert value.(:satellites, 12) == 12
    # Pitch is positive with the nose down, in both firmwares.
    assert Field.value(Enum.at(message(:inav, "ATTITUDE").reply, 1), -123) == -12.3
  end

  describe "a table with an error" do
    test "is refused with the number of the line" do
      errors = %{
        "@ A 1 read\nr x:u9" => "line 2",
        "@ A 1 read\nr :u8" => "line 2: :u8 is not a field",
        "@ A 1 read\n@ B 1 read" => "line 2: it is there twice",
        "@ A 1 poke" => "line 1",
        "@ A 1 write bold" => "line 1",
        "hello" => "line 1"
      }

      for {text, why} <- errors do
        assert Exception.message(catch_error(Definition.parse!(text))) =~ why
      end
    end
  end
end
