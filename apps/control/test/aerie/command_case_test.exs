defmodule Aerie.CommandCaseTest do
  use Aerie.CommandCase, async: true

  alias Aerie.Control.CommandExecutor

  @moduletag :tmp_dir

  test "a submitted command is noticed, whether somebody says who holds the vehicle or not", %{tmp_dir: dir} do
    gateway = start_commands(dir)
    {:ok, command} = Command.new(vehicle: "VID-007", type: "hold")

    for options <- [[], [still?: fn -> true end]] do
      refute_submitted()
      Task.async(fn -> CommandExecutor.submit(gateway, {"main", 7}, command, options) end)
      eventually(fn -> Process.info(self(), :message_queue_len) == {:message_queue_len, 1} end)
      assert_raise ExUnit.AssertionError, &refute_submitted/0
    end
  end
end
