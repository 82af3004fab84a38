defmodule Aerie.Bridge.Server.OsProcess do
  @moduledoc """
  A program that lives no longer than this VM.

  A port that is closed only closes pipes, and a VM that is killed cannot even do that properly for a program that does
  not read its input, as nats-server does not. So a shell stands in between: it starts the program and waits for it,
  and a second shell reads our pipe, whose end (or a line on it) means that the program has to go: first asked (TERM),
  after three seconds made (KILL). That holds for `kill -9` of the VM too; and since the second shell is not the
  first, for `kill -9` of the first one along with the VM.
  """

  alias Aerie.Bridge.FolderLock

  # Jobs in the background of a shell have no input, hence the copy of our pipe as descriptor 3. The shell's own words
  # ("Killed") are nobody's business.
  @script """
  exec 3<&0 2>/dev/null
  "$@" </dev/null 2>&1 3<&- &
  program=$!
  (
    read -r line <&3
    kill -TERM $program 2>/dev/null
    for _ in 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15; do
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
  `{port, {:exit_status, status}}` at its end.
  """
  @spec start(Path.t(), [String.t()]) :: port()
  def start(program, args) do
    Port.open({:spawn_executable, "/bin/sh"}, [
      :binary,
      :exit_status,
      :hide,
      line: 4096,
      args: ["-c", @script, "aerie-nats", program | args]
    ])
  end

  @doc "Asks the program to end; `{port, {:exit_status, status}}` tells when it has."
  @spec stop(port()) :: :ok
  def stop(port) do
    Port.command(port, "stop\n")
    :ok
  rescue
    # The port is closed already: so is the pipe.
    ArgumentError -> :ok
  end

  @doc """
  Ends what an earlier life left behind: the process in `pid_file`, if `mark` (the name of its configuration file) is
  among its arguments, so that a stranger who has got the number since is left alone. Gives whether there was one.
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

  # Its result is nothing to go by: what counts is whether the process is gone.
  defp signal(name, pid) do
    _ = System.cmd("/bin/sh", ["-c", "kill -#{name} $1", "kill", pid], stderr_to_stdout: true)
    :ok
  end

  # Not our child, so there is no message to wait for.
  defp gone?(_pid, 0), do: false

  defp gone?(pid, tries) do
    FolderLock.start_time(pid) == "" or
      receive do
      after
        100 -> gone?(pid, tries - 1)
      end
  end
end
