defmodule MavCodec.MessageIdTest do
  use ExUnit.Case, async: true

  import MavCodec.MessageId

  test "an id by the name of its message, in patterns too" do
    assert id(Attitude) == 30
    assert match?(id(Heartbeat), 0)
    assert match?(n when n in [id(GlobalPositionInt), id(Attitude)], 33)
  end

  test "an unknown name does not compile" do
    assert_raise UndefinedFunctionError, fn ->
      Code.eval_string("import MavCodec.MessageId; id(NoSuchMessage)")
    end
  end
end
