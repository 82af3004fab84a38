defmodule Aerie.Vehicle.Services.ParamsTest do
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.Services.Params
  alias MavCodec.Messages.ParamValue

  defp read(autopilot, fields),
    do: Params.read(struct!(%ParamValue{param_id: "P", param_index: 3}, fields), autopilot)

  defp float(bits) do
    {:ok, message} = MavCodec.Dialects.All.decode(22, <<bits::little-32, 0::32, "P", 0::120, 6>>)
    message.param_value
  end

  test "P2: ArduPilot sends an integer as a number" do
    assert read(:ardupilot, param_value: 1500.0, param_type: 6) == {:ok, {"P", 1500, 3}}
    assert read(:ardupilot, param_value: 0.5, param_type: 9) == {:ok, {"P", 0.5, 3}}
  end

  test "P2: PX4 sends the bytes of an integer, negative and NaN-like ones too" do
    assert read(:px4, param_value: float(60_001), param_type: 6) == {:ok, {"P", 60_001, 3}}
    assert read(:px4, param_value: float(0xFFFFFFFF), param_type: 6) == {:ok, {"P", -1, 3}}
    assert read(:px4, param_value: float(0x7F800000), param_type: 6) == {:ok, {"P", 0x7F800000, 3}}
    assert read(:px4, param_value: float(0xFF800000), param_type: 5) == {:ok, {"P", 0xFF800000, 3}}
    assert read(:px4, param_value: float(0xFE), param_type: 1) == {:ok, {"P", 254, 3}}
    assert read(:px4, param_value: float(0xFE), param_type: 2) == {:ok, {"P", -2, 3}}
    assert read(:px4, param_value: float(0x8000), param_type: 4) == {:ok, {"P", -32_768, 3}}
    assert read(:px4, param_value: float(0x8000), param_type: 3) == {:ok, {"P", 32_768, 3}}
    assert read(:px4, param_value: 2.5, param_type: 9) == {:ok, {"P", 2.5, 3}}
  end

  test "a value outside the list has no index" do
    assert {:ok, {"P", 1.0, nil}} = read(:ardupilot, param_value: 1.0, param_type: 9, param_index: 0xFFFF)
  end

  test "PX4's hash, memory garbage in the name, counters and values that are not numbers are ignored" do
    assert read(:px4, param_id: "_HASH_CHECK", param_type: 5) == :ignore
    assert read(:px4, param_id: <<"NO_S(", 0xFE>>, param_type: 6) == :ignore
    assert read(:px4, param_id: "", param_type: 6) == :ignore
    assert read(:ardupilot, param_id: "STAT_RUNTIME", param_value: 1.0, param_type: 6) == :ignore
    assert read(:ardupilot, param_value: :nan, param_type: 9) == :ignore
  end
end
