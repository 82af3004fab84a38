defmodule Aerie.Control.Commands.RecentTest do
  @moduledoc "What those who look on see of the commands of all operators."
  use Aerie.CommandCase, async: true

  alias Aerie.Vehicle.Command.Result
  alias Aerie.Control.Commands.Recent
  alias Aerie.Base.PubSub

  @moduletag :tmp_dir

  test "a command from its beginning to its end, and the same again", %{tmp_dir: dir} do
    gateway = start_commands(dir)
    PubSub.subscribe(gateway, {:commands, "VID-007"})
    assert Commands.recent(gateway, "VID-007") == []

    task = command(gateway, "takeoff", id: "t1", params: %{altitude: 20}, via: "console")
    assert_receive {:fleet, {:commands, "VID-007"}, "t1"}

    assert [
             %{
               id: "t1",
               type: "takeoff",
               params: %{altitude: 20.0},
               source: "ops",
               via: "console",
               result: nil
             }
           ] =
             Commands.recent(gateway, "VID-007")

    assert_receive {:"$gen_call", from, {:submit, %{id: "t1"}, desk, _still?}}
    send(desk, {:command_progress, "t1", %{"progress" => 0.5, "text" => "climbing"}})
    assert_receive {:fleet, {:commands, "VID-007"}, "t1"}
    assert [%{progress: %{"progress" => 0.5}}] = Commands.recent(gateway, "VID-007")

    answer(from, "t1", :completed)
    Task.await(task, Aerie.Patience.ms())
    assert_receive {:fleet, {:commands, "VID-007"}, "t1"}
    assert [%{result: %{status: :completed}, at: at, done_at: done_at}] = Commands.recent(gateway, "VID-007")
    assert done_at >= at

    Task.await(command(gateway, "takeoff", id: "t1", params: %{altitude: 20}), Aerie.Patience.ms())
    assert_receive {:fleet, {:commands, "VID-007"}, "t1"}
    assert eventually(fn -> match?([%{result: %{}}], Commands.recent(gateway, "VID-007")) end)
    assert Commands.recent(gateway, "VID-008") == []
  end

  test "a command that is asked for again stands there once, under way", %{tmp_dir: dir} do
    gateway = start_commands(dir)
    {:ok, command} = Command.new(id: "h1", vehicle: "VID-007", type: "hold", source: "ops")
    Recent.begun(gateway, command, "rest")
    Recent.done(gateway, Result.new("h1", :completed))
    Recent.begun(gateway, command, "rest")
    assert [%{id: "h1", result: nil}] = Commands.recent(gateway, "VID-007")
    Recent.done(gateway, Result.new("h1", :completed))
    assert [%{id: "h1", result: %{status: :completed}}] = Commands.recent(gateway, "VID-007")
  end

  test "refusals are there with their reason; the latest stand first", %{tmp_dir: dir} do
    gateway = start_commands(dir, policy: [max_altitude: 100])
    Task.await(command(gateway, "takeoff", id: "high", params: %{altitude: 200}), Aerie.Patience.ms())
    land = command(gateway, "land", id: "land")
    from = executing(%{id: "land"})

    assert [%{id: "land", result: nil}, %{id: "high", result: %{status: :denied, reason: reason}}] =
             Commands.recent(gateway, "VID-007")

    assert reason =~ "100"
    answer(from, "land", :accepted)
    Task.await(land, Aerie.Patience.ms())
    assert [%{id: "land", result: %{status: :accepted}}] = Commands.recent(gateway, "VID-007", 1)
  end

  test "the server of commands dies: what was under way has an unknown end", %{tmp_dir: dir} do
    gateway = start_commands(dir)
    {:pending, "h1"} = Commands.submit(gateway, vehicle: "VID-007", type: "hold", id: "h1", wait_ms: 0)
    _from = executing(%{id: "h1"})
    Process.exit(Aerie.Base.Names.whereis(gateway, :command_server), :kill)

    assert eventually(fn -> match?([%{result: %{status: :unknown}}], Commands.recent(gateway, "VID-007")) end)
  end
end
