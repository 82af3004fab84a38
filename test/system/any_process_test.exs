defmodule Aerie.System.AnyProcessTest do
  @moduledoc """
  A gateway in a VM of its own loses each of its processes once, one after the other: those of its tree and those around it (names,
  telemetry, listeners, devices, the log's handler). The VM goes on, and after each death the gateway becomes ready again.

  What may not die are the top processes of the VM's applications, whose end is the end of the VM by OTP's rules.
  """

  use Aerie.SystemCase, async: true

  alias Aerie.{RunCase, Victims}

  @moduletag :tmp_dir
  @moduletag timeout: 1_800_000

  # Among those that must have been killed.
  @expected ~w(Aerie.CLI.Supervisor Aerie.Base.Names.Cleaner Telemetry.HandlerTable store: pubsub: router: session: link: link_tree:
               logger_std_h_default aerie_stdout Listener.Watch)

  test "any process may die", %{tmp_dir: folder} do
    vm = start_vm(folder)
    kill_each(vm, MapSet.new())

    eventually(
      fn -> :peer.call(vm.peer, Process, :whereis, [:logger_std_h_default]) != nil end,
      "the log is back"
    )

    # What the log hears of links and vehicles.
    assert :peer.call(vm.peer, :telemetry, :list_handlers, [[:aerie]]) != []
  end

  defp kill_each(vm, done) do
    case {Enum.find(victims(vm), fn {name, _pid} -> name not in done end), missing(done)} do
      {nil, []} ->
        :ok

      # A successor is on its way: the gateway is called ready while a death still goes through its tree.
      {nil, missing} ->
        eventually(
          fn -> Enum.any?(victims(vm), fn {name, _pid} -> name not in done end) end,
          "one of #{inspect(missing)} is there"
        )

        kill_each(vm, done)

      {{name, pid}, _missing} ->
        at = :peer.call(vm.peer, System, :os_time, [:microsecond])
        true = :peer.call(vm.peer, Process, :exit, [pid, :kill])
        eventually(fn -> not :peer.call(vm.peer, Process, :alive?, [pid]) end, "#{name} has died")
        eventually(fn -> ready?(vm, at) end, "the gateway is ready after #{name} was killed")
        kill_each(vm, MapSet.put(done, name))
    end
  end

  defp ready?(vm, since) do
    port = :peer.call(vm.peer, Victims, :port, [])

    match?(%{"status" => "ready", "vehicles" => 1}, port && RunCase.api(port, "/readyz")) and
      :peer.call(vm.peer, Victims, :heard_at, []) > since
  end

  defp missing(done), do: Enum.reject(@expected, fn part -> Enum.any?(done, &(&1 =~ part)) end)

  defp victims(vm), do: :peer.call(vm.peer, Victims, :processes, [])

  defp start_vm(folder) do
    config = config_file(folder, clients: [])

    paths = for path <- :code.get_path(), path != ~c".", do: [~c"-pa", path]

    {:ok, peer, _node} =
      :peer.start_link(%{
        connection: {{127, 0, 0, 1}, 0},
        args: Enum.concat(paths) ++ [~c"-noinput"],
        env: [{~c"AERIE_CWD", to_charlist(folder)}]
      })

    words = ["--quiet", "--config", config, "--sim", "1"]
    :ok = :peer.call(peer, Application, :put_env, [:aerie, :start, words, [persistent: true]])
    {:ok, _apps} = :peer.call(peer, Application, :ensure_all_started, [:aerie, [type: :permanent]], 120_000)
    vm = %{peer: peer}
    eventually(fn -> ready?(vm, 0) end, "the gateway is ready")
    vm
  end
end
