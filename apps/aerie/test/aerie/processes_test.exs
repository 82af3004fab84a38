defmodule Aerie.ProcessesTest do
  use ExUnit.Case, async: true

  import Aerie.Patience, only: [eventually: 1]

  alias Aerie.Base.Names
  alias Aerie.Processes
  alias Aerie.Shell.Text

  @moduletag :capture_log

  test "the tree of a gateway, with the restart of a process that died", context do
    gateway = context.test
    child = %{id: :worker, start: {Agent, :start_link, [fn -> nil end]}}
    options = [strategy: :one_for_one, max_restarts: 1_000, name: Names.via(gateway, :gateway)]
    start_supervised!(%{id: :gateway, start: {Supervisor, :start_link, [[child], options]}})
    assert [{%{path: [:gateway]}, nil}, {%{path: [:gateway, :worker]}, nil}] = Processes.tree(gateway)

    start_supervised!({Processes, gateway: gateway})

    # A death before the first look is not counted.
    eventually(fn ->
      [_top, {worker, _before}] = Processes.tree(gateway)
      ref = Process.monitor(worker.pid)
      Process.exit(worker.pid, :kill)
      assert_receive {:DOWN, ^ref, :process, _pid, :killed}
      [_top, {_worker, restarts}] = tree = Processes.tree(gateway)
      text = tree |> Text.tree() |> IO.iodata_to_binary()
      restarts != nil and restarts.reason == "killed" and text =~ ~r/ :worker +#PID.* the last: killed/
    end)
  end

  test "of a gateway that is not running there is none", context do
    assert context.test |> Processes.tree() |> Text.tree() == "no tree: the gateway is starting\n"
  end

  test "the busiest processes, with what they are called" do
    work = fn work, n -> work.(work, n + 1) end
    pid = spawn_link(fn -> Process.set_label(:hard_worker) && work.(work, 0) end)
    rows = eventually(fn -> Enum.find(Processes.busiest(50), &(&1.pid == pid)) && Processes.busiest(50) end)
    assert length(rows) <= 20 and rows == Enum.sort_by(rows, & &1.reductions, :desc)
    assert IO.iodata_to_binary(Text.top(rows)) =~ ":hard_worker"
    Process.unlink(pid)
    Process.exit(pid, :kill)
  end
end
