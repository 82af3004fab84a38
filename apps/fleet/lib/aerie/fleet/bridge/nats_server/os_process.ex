defmodule Aerie.Fleet.Bridge.NatsServer.OsProcess do
  @moduledoc """
  A program that lives no longer than this VM.

  Closing a port only closes pipes, which nats-server does not notice because it does not read its input. So a shell starts
  the program and waits for it, and a second shell reads our pipe. A line on the pipe, or its end, makes the second shell end
  the program: with TERM, after three seconds with KILL. That also works after `kill -9` of the VM, and of the first shell.
  """

  alias Aerie.Base.Files.FolderLock

  # Background jobs of a shell have no input, hence the copy of our pipe as descriptor 3. The shell's own messages
  # ("Killed") are suppressed.
  @script """
  exec 3<&0 2>/dev/null
  tries=$1
  shift
  "$@" </dev/null 2>&1 3<&- &
  program=$!
  (
    read -r line <&3
    kill -TERM $program 2>/dev/null
    while [ "$tries" -gt 0 ]; do
      tries=$((tries - 1))
      kill -0 $program 2>/dev/null || exit 0
      sleep 0.2
    done
    kill -KILL $program 2>/dev/null
  ) >/dev/null 2>&1 &
  reader=$!
  exec 3<&-
  wait $program
  status=$?
  kill $reader 2>/dev/null
  exit $status
  """

  @doc """
  Starts `program` with `args`. The caller gets `{port, {:data, {:eol | :noeol, line}}}` for its output and
  `{port, {:exit_status, status}}` at its end. `tries`: fifths of a second from TERM to KILL;
  `env`: variables besides this VM's.
  """
  @spec start(Path.t(), [String.t()], tries :: pos_integer(), env :: [{charlist(), charlist()}]) :: port()
  def start(program, args, tries \\ 15, env \\ []) do
    Port.open({:spawn_executable, "/bin/sh"}, [
      :binary,
      :exit_status,
      :hide,
      line: 4096,
      env: env,
      args: ["-c", @script, "aerie-nats", "#{tries}", program | args]
    ])
  end

  @doc "Asks the program to end; `{port, {:exit_status, status}}` comes when it has."
  @spec stop(port()) :: :ok
  def stop(port) do
    Port.command(port, "stop\n")
    :ok
  rescue
    # The port, and with it the pipe, is already closed.
    ArgumentError -> :ok
  end

  @doc """
  Ends the process of `pid_file` that an earlier run left behind, if `mark` (the name of its configuration file) is among its
  arguments; another process may have got the pid since. Returns whether there was one.
  """
  @spec end_leftover(Path.t(), String.t()) :: boolean()
  def end_leftover(pid_file, mark) do
    with {:ok, text} <- File.read(pid_file),
         pid = String.trim(text),
         true <- pid =~ ~r/\A[1-9]\d*\z/,
         {:ok, arguments} <- File.read("/proc/#{pid}/cmdline"),
         true <- mark in String.split(arguments, <<0>>) do
      signal("TERM", pid)
      unless gone?(pid, 30), do: signal("KILL", pid)
      _ = gone?(pid, 20)
      true
    else
      _ -> false
    end
  end

  # The result does not matter: what counts is whether the process is gone.
  defp signal(name, pid) do
    _ = System.cmd("/bin/sh", ["-c", "kill -#{name} $1", "kill", pid], stderr_to_stdout: true)
    :ok
  end

  # It is not our child, so no message comes.
  defp gone?(_pid, 0), do: false

  defp gone?(pid, tries) do
    FolderLock.start_time(pid) == "" or
      receive do
      after
        100 -> gone?(pid, tries - 1)
      end
  end
end
