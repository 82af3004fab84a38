defmodule Aerie.CLI.RemoteTest do
  use ExUnit.Case, async: true

  alias Aerie.Patience
  alias Aerie.CLI.Subcommand.Running.Remote

  test "without a terminal it says what to use" do
    assert Remote.terminal(true) == :ok

    for stdin <- [false, :ebadf],
        do: assert({:error, "aerie remote needs a terminal" <> _} = Remote.terminal(stdin))
  end

  @tag :tmp_dir
  test "the end of its input ends the shell, and not the node that it runs on", %{tmp_dir: dir} do
    {:ok, _apps} = Application.ensure_all_started(:iex)
    file = Path.join(dir, "shell.exs")
    File.write!(file, "")
    {:ok, input} = StringIO.open("1 + 41\n")
    test = self()

    terminal = spawn_link(fn -> terminal(input) end)

    spawn_link(fn ->
      Process.group_leader(self(), terminal)
      send(test, {:shell, Remote.shell(file)})
    end)

    assert_receive {:shell, shell}, Patience.ms()
    monitor = Process.monitor(shell)
    assert_receive {:DOWN, ^monitor, :process, ^shell, _reason}, Patience.ms()
    assert {_left, printed} = StringIO.contents(input)
    assert printed =~ "42"
    assert Remote.leave(node()) == :ok
  end

  # A device with the options of a terminal, which a StringIO does not have.
  defp terminal(input) do
    receive do
      {:io_request, from, ref, {:setopts, _options}} -> send(from, {:io_reply, ref, :ok})
      request -> send(input, request)
    end

    terminal(input)
  end
end
