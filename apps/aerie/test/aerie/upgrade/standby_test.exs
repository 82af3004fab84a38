defmodule Aerie.Upgrade.StandbyTest do
  use ExUnit.Case, async: true

  import Aerie.Patience, only: [eventually: 2]

  alias Aerie.Upgrade
  alias Aerie.Upgrade.Standby

  @moduletag :tmp_dir

  # A process in whose place the gateway starts.
  setup do
    port = Port.open({:spawn_executable, System.find_executable("sleep")}, args: ["1000"])
    {:os_pid, pid} = Port.info(port, :os_pid)
    on_exit(fn -> System.cmd("kill", ["-9", "#{pid}"], stderr_to_stdout: true) end)
    %{pid: "#{pid}"}
  end

  defp environment(folder, pid), do: Map.new(Standby.environment(folder, pid))

  defp kill(pid), do: {_output, 0} = System.cmd("kill", ["-9", pid])

  # It has looked, and looks again after a pause.
  defp waits(%Task{pid: pid}) do
    pausing = [status: :waiting, current_function: {Standby, :await, 2}]
    eventually(fn -> Process.info(pid, [:status, :current_function]) == pausing end, "it waits")
  end

  test "it waits until it is called, although the former one has ended", %{tmp_dir: folder, pid: pid} do
    test = self()

    prepare = fn ours? ->
      send(test, {:prepares, ours?.(:tcp, 1)})
      kill(pid)
      eventually(fn -> not File.exists?("/proc/#{pid}") end, "it has ended")
      :ok
    end

    waiting = Task.async(fn -> Standby.wait(environment(folder, pid), prepare) end)
    assert_receive {:prepares, false}, Aerie.Patience.ms()
    waits(waiting)
    assert File.exists?(Path.join(folder, "ready"))
    File.write!(Path.join(folder, "go"), "")
    assert Task.await(waiting, Aerie.Patience.ms()) == :ok
    refute File.exists?(folder)
  end

  test "it waits until the former one has ended, although it is called", %{tmp_dir: folder, pid: pid} do
    call = fn _ours? -> File.write!(Path.join(folder, "go"), "") end
    waiting = Task.async(fn -> Standby.wait(environment(folder, pid), call) end)
    waits(waiting)
    kill(pid)
    assert Task.await(waiting, Aerie.Patience.ms()) == :ok
    refute File.exists?(folder)
  end

  test "what keeps it from starting reaches the one that runs", %{tmp_dir: folder, pid: pid} do
    assert {:error, ["no"]} = Standby.wait(environment(folder, pid), fn _ours? -> {:error, ["no"]} end)
    assert File.read!(Path.join(folder, "failed")) == "no"
    assert {:error, [text]} = Standby.wait(environment(folder, "x"), fn _ours? -> :ok end)
    assert text =~ "expected a process id"
  end

  test "without a gateway to replace it does not wait" do
    assert Standby.wait(%{}, fn _ours? -> flunk("called") end) == :ok
  end

  test "a gateway from a checkout starts none, one that has ended is not left to, and one that waits is ended",
       %{
         tmp_dir: folder,
         pid: pid
       } do
    assert {:error, text} = Upgrade.begin("/bin/true", folder)
    assert text =~ "checkout"
    standby = %{pid: pid, folder: folder}
    assert :ok = Upgrade.cancel(standby)
    eventually(fn -> not File.exists?("/proc/#{pid}") end, "it has ended")
    assert {:error, text} = Upgrade.leave(standby)
    assert text =~ "has ended"
    refute File.exists?(folder)
  end

  # A program of another version, as far as the running gateway sees it.
  defp program(folder, script) do
    file = Path.join(folder, "aerie")
    File.write!(file, "#!/bin/sh\n" <> script)
    File.chmod!(file, 0o755)
    file
  end

  test "the program of another version is started beside this one, one at a time, and goes on by itself", %{
    tmp_dir: folder
  } do
    ready = program(folder, "echo $$ >\"$AERIE_STANDBY/ready\"; exec sleep 1000\n")
    assert {:ok, %{pid: pid} = standby} = Upgrade.beside(ready, folder)
    # It has a session of its own, and no input.
    assert {text, 0} = System.cmd("ps", ["-o", "sid=,args=", "-p", pid])
    assert String.split(text) == [pid, "sleep", "1000"]
    assert {:error, "another upgrade is under way"} = Upgrade.beside(ready, folder)
    :ok = Upgrade.cancel(standby)
    # What one left that was killed is in nobody's way.
    File.mkdir_p!(standby.folder)
    File.write!(Path.join(standby.folder, "process"), pid)
    eventually(fn -> not File.exists?("/proc/#{pid}") end, "it has ended")
    assert {:ok, standby} = Upgrade.beside(ready, folder)
    :ok = Upgrade.cancel(standby)
  end

  test "one that cannot start says why, one that ends is not waited for", %{tmp_dir: folder} do
    failing = program(folder, "printf 'error: no' >\"$AERIE_STANDBY/failed\"; exit 2\n")
    assert {:error, "error: no"} = Upgrade.beside(failing, folder)
    assert {:error, text} = Upgrade.beside(program(folder, "exit 1\n"), folder)
    assert text =~ "ended at once"
    assert Path.wildcard(Path.join(folder, "upgrade-*")) == []
    assert {:error, text} = Upgrade.beside(failing, Path.join(folder, "nowhere"))
    assert text =~ "no such file"
  end
end
