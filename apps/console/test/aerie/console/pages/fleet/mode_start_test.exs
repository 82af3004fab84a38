defmodule Aerie.Console.Pages.Fleet.ModeStartTest do
  @moduledoc "A mode of several vehicles and missions one after the other, in a browser."
  use Aerie.ConsoleCase, async: true

  import Aerie.ActCase

  @moduletag :tmp_dir
  @moduletag :capture_log
  @moduletag :chromium

  setup %{tmp_dir: dir} do
    console = Aerie.ActCase.start(dir)
    for n <- 1..3, do: fly(console, n)
    {:ok, console: console}
  end

  defp fly(console, n, groups \\ [], fields \\ %{}) do
    place = [position: %{lat: 47.0 + n / 1_000, lon: 8.0, alt_rel: 20.0}, mission: %{seq: 0, total: 4}]
    put(console, n, Keyword.merge(place, groups), fields)
  end

  # `changed` is done under the hand, and `slow` are the vehicles that carry out their command when they are told to.
  defp browse_through(console, task, changed, slow) do
    script = browser(console, "mode_start.mjs", [task])
    await_line(script, "holding")
    changed.()
    Port.command(script, "changed\n")
    await_line(script, "ended")
    assert operations(console) == []
    Port.command(script, "begin\n")
    await_line(script, "begun")
    assert [%{"state" => "running"}] = operations(console)
    kill_pages(console)
    Port.command(script, "killed\n")
    await_line(script, "back")
    send(slow, :go)
    Port.command(script, "done\n")
    await_line(script, "ok")
    assert [%{"state" => "done"}] = operations(console)
  end

  test "a mode: another firmware under the hand, a page killed in the middle", %{console: console} do
    for n <- 1..2, do: executor(console, n)
    slow = executor(console, 3, :slow)
    browse_through(console, "mode", fn -> fly(console, 3, [], %{autopilot: :px4}) end, slow)

    for {id, mode} <- [{"V1", "AUTO"}, {"V2", "AUTO"}, {"V3", "AUTO_MISSION"}],
        do: assert_received({:commanded, ^id, "set_mode", %{mode: ^mode}})
  end

  test "missions: one lands under the hand, a page killed in the middle", %{console: console} do
    executor(console, 1)
    slow = executor(console, 2, :slow)
    executor(console, 3)
    landed = [mode: %{armed: false, in_air: false}]
    browse_through(console, "start", fn -> fly(console, 3, landed) end, slow)
    for id <- ~w(V1 V2), do: assert_received({:commanded, ^id, "mission_start", _params})
    refute_received {:commanded, "V3", _type, _params}
  end
end
