defmodule MavCodec.EnumsTest do
  use ExUnit.Case, async: true

  alias MavCodec.Definition.{Catalog, Shard}

  alias MavCodec.Enums.{
    GpsFixType,
    MavBool,
    MavCmd,
    MavModeFlag,
    MavState,
    MavSysStatusSensor,
    MavType,
    Param
  }

  test "names, values and labels; what is not known is nil" do
    assert MavState.value(:MAV_STATE_ACTIVE) == 4
    assert MavState.name(4) == :MAV_STATE_ACTIVE
    assert MavState.label(4) == "ACTIVE"
    assert {MavState.value(:MAV_TYPE_GCS), MavState.name(99), MavState.label(99)} == {nil, nil, nil}
    assert GpsFixType.label(3) == "3D_FIX"
    assert MavCmd.label(400) == "COMPONENT_ARM_DISARM"
    assert hd(MavState.all()) == {:MAV_STATE_UNINIT, 0}
  end

  test "where sources name one value differently, both names count and upstream's is shown" do
    assert MavType.value(:MAV_TYPE_VTOL_TAILSITTER_QUADROTOR) == 20
    assert MavType.value(:MAV_TYPE_VTOL_QUADROTOR) == 20
    assert MavType.name(20) == :MAV_TYPE_VTOL_TAILSITTER_QUADROTOR
  end

  test "bitmasks keep the bits that have no name" do
    assert MavModeFlag.flags(0x51) ==
             {[
                :MAV_MODE_FLAG_CUSTOM_MODE_ENABLED,
                :MAV_MODE_FLAG_STABILIZE_ENABLED,
                :MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
              ], 0}

    assert MavSysStatusSensor.flags(0x1_0000_0001) == {[:MAV_SYS_STATUS_SENSOR_3D_GYRO], 0x1_0000_0000}
    assert MavBool.flags(2) == {[], 2}
  end

  test "the parameters of commands" do
    assert [%Param{index: 1, label: "Arm", enum: "MAV_BOOL"}, %Param{index: 2, label: "Force", max: 21_196.0}] =
             MavCmd.params(400)

    assert MavCmd.params(-1) == []
  end

  test "whether a command has a position" do
    assert MavCmd.location?(MavCmd.value(:MAV_CMD_NAV_WAYPOINT)) == true
    assert MavCmd.location?(MavCmd.value(:MAV_CMD_DO_DIGICAM_CONTROL)) == false
    assert MavCmd.location?(MavCmd.value(:MAV_CMD_INJECT_FAILURE)) == nil
    assert MavCmd.location?(-1) == nil
    refute function_exported?(MavSysStatusSensor, :location?, 1)
  end

  test "every enum of every source: value, name and label agree" do
    catalog = Catalog.load!(Shard.definitions())
    assert length(catalog.enums) > 250

    for {module, enum} <- catalog.enums do
      assert length(module.all()) == length(enum.entries)
      assert function_exported?(module, :flags, 1) == enum.bitmask

      if enum.bitmask do
        bits = Enum.reduce(module.all(), 0, fn {_name, value}, bits -> Bitwise.bor(bits, value) end)
        assert {names, 0x10000000000000000} = module.flags(bits + 0x10000000000000000)
        assert names == for({name, value} <- module.all(), value != 0, do: name)
      end

      for {name, value} <- module.all() do
        assert module.value(name) == value
        assert module.value(module.name(value)) == value
        label = module.label(value)
        assert label != "" and String.ends_with?(Atom.to_string(module.name(value)), label)
      end
    end
  end
end
