defmodule Aerie.OtherVM do
  @moduledoc "Parts of a gateway in a VM of their own, which a test kills."

  @doc "`kill -9`; waits until the process has ended."
  @spec kill9(String.t()) :: :ok
  def kill9(pid) do
    {_, 0} = System.cmd("sh", ["-c", "kill -KILL #{pid}"])
    # A busy machine takes its time, and until then the process owns its folders.
    Aerie.Patience.eventually(fn -> Aerie.Base.Files.FolderLock.start_time(pid) == "" end)
    :ok
  end

  @doc """
  Runs a script in a VM of its own. Waits for the line `mark <> pid`, and returns the port and the VM's pid. `before`
  are words of a command that starts it in turn.
  """
  @spec other_vm(String.t(), String.t(), [String.t()]) :: {port(), String.t()}
  def other_vm(script, mark, before \\ []) do
    paths =
      for path <- :code.get_path(),
          path = to_string(path),
          String.starts_with?(path, Mix.Project.build_path()),
          do: ["-pa", path]

    [program | words] = before ++ ["elixir"] ++ List.flatten(paths) ++ ["-e", script]
    options = [:binary, :stderr_to_stdout, line: 1000, args: words]
    port = Port.open({:spawn_executable, System.find_executable(program)}, options)
    {:os_pid, os_pid} = Port.info(port, :os_pid)
    ExUnit.Callbacks.on_exit(fn -> end_vm("#{os_pid}", script) end)
    {port, marked_pid(port, mark)}
  end

  # Kills what a failed test left running, unless another program has its process id by now.
  defp end_vm(os_pid, script) do
    with {:ok, words} <- File.read("/proc/#{os_pid}/cmdline"),
         true <- String.contains?(words, script),
         do: System.cmd("kill", ["-KILL", os_pid])
  end

  defp marked_pid(port, mark) do
    receive do
      {^port, {:data, {:eol, line}}} ->
        if String.starts_with?(line, mark),
          do: String.replace_prefix(line, mark, ""),
          else: marked_pid(port, mark)
    after
      Aerie.Patience.ms() -> ExUnit.Assertions.flunk("the other VM did not say #{mark}")
    end
  end
end
