defmodule MavCodec.MessageTest do
  use ExUnit.Case, async: true

  alias MavCodec.{Dialects, Message}
  alias MavCodec.Message.{DecodeError, EncodeError}
  alias MavCodec.Messages.{Attitude, Heartbeat, MissionAck, ParamExtSet, ParamValue, Simstate164, SimState}

  defp encode_payload(message, version \\ 2, dialect \\ Dialects.All),
    do: Message.encode_payload(message, version, dialect)

  test "a message encodes to its wire order and decodes to itself" do
    heartbeat = %Heartbeat{type: 2, autopilot: 3, base_mode: 81, custom_mode: 4, system_status: 4}
    assert {:ok, 0, 50, <<4, 0, 0, 0, 2, 3, 81, 4, 3>> = payload} = encode_payload(heartbeat)
    assert MavCodec.decode(%{version: 2, id: 0, payload: payload}) == {:ok, heartbeat}
  end

  test "F7: version 2 cuts trailing zeros but never the first byte, and decoding fills them in" do
    assert {:ok, 30, 39, <<0>>} = encode_payload(%Attitude{})
    assert Attitude.decode(<<0>>) == %Attitude{}
    assert Attitude.decode(<<>>) == %Attitude{}
    assert {:ok, 30, 39, <<0::28-unit(8)>>} = encode_payload(%Attitude{}, 1)
  end

  test "a single char is a character" do
    payload = MavCodec.Messages.TestTypes.decode(<<>>)
    assert payload.c == ""
    message = %{payload | c: "A"}
    frame = MavCodec.encode(message, system: 1, dialect: MavCodec.Dialects.Test)

    {[frame], _} =
      MavCodec.Parser.push_datagram(MavCodec.Parser.new(dialects: [MavCodec.Dialects.Test]), frame)

    assert {:ok, %{c: "A"}} = MavCodec.decode(frame, MavCodec.Dialects.Test)

    for wrong <- ["AB", <<0>>, 65] do
      assert_raise MavCodec.Message.EncodeError, ~r/\bc\b/, fn ->
        MavCodec.encode(%{message | c: wrong}, system: 1, dialect: MavCodec.Dialects.Test)
      end
    end
  end

  test "F9: version 1 has no extensions, surplus bytes are ignored, the dialect decides the layout" do
    ack = %MissionAck{target_system: 1, type: 2, mission_type: 3, opaque_id: 4}
    assert {:ok, 47, 153, <<1, 0, 2>>} = encode_payload(ack, 1)
    assert {:ok, 47, 153, <<1, 0, 2, 3, 4>>} = encode_payload(ack, 2, Dialects.Upstream)
    assert {:ok, 47, 153, <<1, 0, 2, 3>>} = encode_payload(ack, 2, Dialects.Ardupilot)
    frame = %{version: 1, id: 47, payload: <<1, 0, 2, 9, 9>>}
    assert MavCodec.decode(frame) == {:ok, %MissionAck{target_system: 1, type: 2}}
    assert {:ok, %MissionAck{opaque_id: 0}} = Dialects.Ardupilot.decode(47, <<1, 0, 2, 3, 4, 0, 0, 0>>)
    assert MissionAck.decode(<<1, 0, 2, 3, 4, 0, 0, 0, 77, 77>>) == ack
  end

  test "NaN and the infinities survive, NaN payloads too" do
    message = %Attitude{
      roll: :nan,
      pitch: :infinity,
      yaw: :neg_infinity,
      rollspeed: {:nan, 0xFFC00001},
      yawspeed: 1.5
    }

    assert {:ok, 30, 39, payload} = encode_payload(message)
    assert Attitude.decode(payload) == message
  end

  test "F14: text ends at the first NUL" do
    assert {:ok, 22, 220, payload} = encode_payload(%ParamValue{param_id: "RTL_ALT", param_type: 9})
    assert ParamValue.decode(payload).param_id == "RTL_ALT"
    assert ParamValue.decode(<<0::64, "AB", 0, "garbage_after", 9>>).param_id == "AB"
    assert ParamValue.decode(<<0::64, "SIXTEEN_BYTES_ID", 9>>).param_id == "SIXTEEN_BYTES_ID"
  end

  test "P8: the value of an extended parameter is bytes, its NULs included" do
    number = <<0, 0, 128, 63, 0::124-unit(8)>>
    message = %ParamExtSet{target_system: 1, param_id: "CAM_EV", param_value: number, param_type: 9}
    assert {:ok, 323, 78, payload} = encode_payload(message)
    assert ParamExtSet.decode(payload) == message
    # Fewer bytes are filled with zeros, as of any other bytes.
    assert encode_payload(%{message | param_value: <<0, 0, 128, 63>>}) == {:ok, 323, 78, payload}
    assert %ParamExtSet{}.param_value == <<0::128-unit(8)>>
    assert %{type: :uint8, length: 128} = Enum.find(ParamExtSet.fields(), &(&1.key == :param_value))
    assert {:error, %EncodeError{}} = encode_payload(%{message | param_value: <<0::129-unit(8)>>})
  end

  test "a value out of range or of the wrong type is an error that says what was expected" do
    assert {:error,
            %EncodeError{message: Heartbeat, field: :type, got: 256, expected: "an integer from 0 to 255"} =
              error} =
             encode_payload(%Heartbeat{type: 256})

    assert Exception.message(error) ==
             "cannot encode MavCodec.Messages.Heartbeat: expected type to be an integer from 0 to 255, got: 256"

    assert {:error, %EncodeError{field: :roll}} = encode_payload(%Attitude{roll: 1.0e300})
    assert {:error, %EncodeError{field: :roll}} = encode_payload(%Attitude{roll: "1"})
    assert {:error, %EncodeError{field: :roll}} = encode_payload(%Attitude{roll: {:nan, 0}})

    assert {:error, %EncodeError{field: :param_id}} =
             encode_payload(%ParamValue{param_id: "SEVENTEEN_BYTES_X"})

    assert {:error, %EncodeError{field: nil}} = encode_payload(%Attitude{}, 2, Dialects.Minimal)
  end

  test "names that differ only in case get the id behind the later one" do
    assert {SimState.id(), SimState.name()} == {108, "SIM_STATE"}
    assert {Simstate164.id(), Simstate164.name()} == {164, "SIMSTATE"}
  end

  test "dialects: lookups by id and name, unknown ids" do
    assert Dialects.All.crc_extra(0) == 50
    assert Dialects.All.crc_extra(0xABCDEF) == nil
    assert Dialects.All.module_for(0) == Heartbeat
    assert Dialects.All.length(47) == {3, 8}
    assert Dialects.Ardupilot.length(47) == {3, 4}
    assert Dialects.All.message_id("HEARTBEAT") == 0
    assert Dialects.All.message_id("heartbeat") == nil
    assert Dialects.All.name(0) == "HEARTBEAT"
    assert Dialects.All.targets(76) == {30, 31}
    assert Dialects.All.targets(69) == {10, nil}
    assert Dialects.All.targets(0) == nil
    assert {:error, %DecodeError{id: 0xABCDEF}} = MavCodec.decode(%{version: 2, id: 0xABCDEF, payload: <<>>})
  end
end
