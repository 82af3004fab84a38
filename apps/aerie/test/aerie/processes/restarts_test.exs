defmodule Aerie.Processes.RestartsTest do
  use ExUnit.Case, async: true

  alias Aerie.Processes.Restarts

  defp process, do: spawn(fn -> receive(do: (:never -> :ok)) end)

  defp die(restarts, pid, reason, at) do
    Process.exit(pid, reason)
    assert_receive {:DOWN, ref, :process, ^pid, reason}
    Restarts.down(restarts, ref, reason, at)
  end

  test "a place that is taken again was restarted, with the reason of its end" do
    [first, second] = [process(), process()]
    restarts = Restarts.new() |> Restarts.seen([{[:a], first}], 1)
    assert Restarts.of(restarts, [:a]) == nil
    restarts = restarts |> die(first, :oops, 5) |> Restarts.seen([{[:a], second}], 9)
    assert %{count: 1, at: 5, reason: reason} = Restarts.of(restarts, [:a])
    assert reason =~ "oops"
    restarts = restarts |> die(second, :kill, 20) |> Restarts.seen([{[:a], process()}], 30)
    assert %{count: 2, at: 20, reason: "killed"} = Restarts.of(restarts, [:a])
  end

  test "a place that is empty was ended, and is forgotten" do
    pid = process()

    restarts =
      Restarts.new() |> Restarts.seen([{[:a], pid}], 1) |> die(pid, :shutdown, 5) |> Restarts.seen([], 9)

    assert Restarts.seen(restarts, [{[:a], process()}], 20) |> Restarts.of([:a]) == nil
  end

  test "one that is replaced before its end was told also counts, once" do
    [first, second] = [process(), process()]
    restarts = Restarts.new() |> Restarts.seen([{[:a], first}], 1) |> Restarts.seen([{[:a], second}], 9)
    assert %{count: 1, at: 9} = Restarts.of(restarts, [:a])
    # Its end is not reported any more.
    assert Process.info(self(), :monitors) == {:monitors, [process: second]}
  end

  test "an end that it did not wait for changes nothing" do
    assert Restarts.down(Restarts.new(), make_ref(), :oops, 1) == Restarts.new()
  end
end
