defmodule MavCodec.CommandTest do
  use ExUnit.Case, async: true

  import MavCodec.Command

  test "a number by the name of its command, in patterns too" do
    assert cmd(:COMPONENT_ARM_DISARM) == 400
    assert match?(cmd(:NAV_TAKEOFF), 22)
    assert match?(n when n in cmds(~w(NAV_LAND NAV_RETURN_TO_LAUNCH)a), 20)
  end

  test "an unknown name does not compile" do
    assert_raise KeyError, fn -> Code.eval_string("import MavCodec.Command; cmd(:NO_SUCH_COMMAND)") end
  end
end
