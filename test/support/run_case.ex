defmodule Aerie.RunCase do
  @moduledoc "Runs `bin/run` as a user does: as an operating system process, with its output and its end."

  use ExUnit.CaseTemplate

  import ExUnit.Assertions

  @root Path.expand("../..", __DIR__)
  # The first call of `bin/test --full` compiles with MIX_ENV=prod.
  @patience 600_000

  using do
    quote do
      import Aerie.RunCase
    end
  end

  @doc "Starts it. `before` is a command that starts it in turn (for example `unshare`), `root` another checkout."
  @spec open([String.t()], [String.t()], Path.t()) :: port
  def open(words, before \\ [], root \\ @root) do
    [program | words] = before ++ [Path.join(root, "bin/run") | words]

    port =
      Port.open({:spawn_executable, System.find_executable(program) || program}, [
        :binary,
        :exit_status,
        :stderr_to_stdout,
        args: words,
        env:
          for({name, value} <- environment(root), do: {to_charlist(name), value != nil && to_charlist(value)})
      ])

    {:os_pid, os_pid} = Port.info(port, :os_pid)
    ExUnit.Callbacks.on_exit(fn -> stop("#{os_pid}") end)
    port
  end

  @doc "The environment of a plain shell, without this test's Mix variables, for a checkout with its own toolchain."
  @spec environment(Path.t()) :: [{String.t(), String.t() | nil}]
  def environment(root \\ @root) do
    toolchain = Path.join(root, ".toolchain")

    [{"MIX_ENV", nil}, {"MIX_BUILD_PATH", nil}, {"AERIE_TERMINAL", nil}] ++
      if(File.dir?(toolchain) and System.get_env("AERIE_TOOLCHAIN") == nil,
        do: [{"AERIE_TOOLCHAIN", toolchain}],
        else: []
      )
  end

  # A failed test leaves the script running; SIGTERM makes it end its VM.
  defp stop(os_pid) do
    with {:ok, words} <- File.read("/proc/#{os_pid}/cmdline"),
         true <- words =~ "bin/run",
         do: System.cmd("kill", ["-TERM", os_pid])
  end

  @doc "Runs it to its end; returns its status and its output."
  @spec run([String.t()], Path.t()) :: {non_neg_integer, String.t()}
  def run(words, root \\ @root), do: words |> open([], root) |> collect("")

  @doc "Waits until its output, `text` so far, contains all of `parts`; returns the output."
  @spec await_output(port, String.t(), [String.t()]) :: String.t()
  def await_output(port, text, parts) do
    if Enum.all?(parts, &(text =~ &1)) do
      text
    else
      receive do
        {^port, {:data, data}} -> await_output(port, text <> data, parts)
        {^port, {:exit_status, status}} -> flunk("ended with #{status}:\n#{text}")
      after
        @patience -> flunk("never said #{inspect(parts)}; output:\n#{text}")
      end
    end
  end

  @doc "The deadline for its start, for `Aerie.SystemCase.eventually/3`; the first call of all compiles."
  @spec started_by() :: integer
  def started_by, do: System.monotonic_time(:millisecond) + @patience

  @doc "Waits for its end; returns its status."
  @spec await_exit(port, String.t()) :: non_neg_integer
  def await_exit(port, text \\ ""), do: port |> collect(text) |> elem(0)

  @doc "The same, with all its output."
  @spec collect(port, String.t()) :: {non_neg_integer, String.t()}
  def collect(port, text) do
    receive do
      {^port, {:data, data}} -> collect(port, text <> data)
      {^port, {:exit_status, status}} -> {status, text}
    after
      @patience -> flunk("no end; output:\n#{text}")
    end
  end

  @doc "The operating system process of its VM, found by its configuration file."
  @spec vm_pid(Path.t()) :: String.t()
  def vm_pid(config) do
    hd(vm_pids(config))
  end

  @doc "Kills its VM with SIGKILL."
  @spec kill_9(Path.t()) :: :ok
  def kill_9(config) do
    for pid <- vm_pids(config), do: System.cmd("kill", ["-KILL", pid])
    :ok
  end

  defp vm_pids(config) do
    {pids, 0} = System.cmd("pgrep", ["-f", "Application.*:aerie.*" <> Regex.escape(config)])
    String.split(pids)
  end

  @doc "An object from its `/api`, or nil while it does not answer."
  @spec api(:inet.port_number(), String.t()) :: map | nil
  def api(port, path) do
    with text when is_binary(text) <- get(port, path),
         {:ok, object} <- JSON.decode(text) do
      object
    else
      _not_yet -> nil
    end
  end

  @doc "The body of an answer by HTTP, or nil while it does not answer."
  @spec get(:inet.port_number(), String.t()) :: String.t() | nil
  def get(port, path) do
    with {:ok, socket} <- :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false], 1_000),
         :ok <- :gen_tcp.send(socket, "GET #{path} HTTP/1.0\r\nhost: 127.0.0.1:#{port}\r\n\r\n"),
         [_head, body] <- socket |> all("") |> String.split("\r\n\r\n", parts: 2) do
      body
    else
      _not_yet -> nil
    end
  end

  defp all(socket, got) do
    case :gen_tcp.recv(socket, 0, Aerie.Patience.ms()) do
      {:ok, bytes} -> all(socket, got <> bytes)
      {:error, _closed} -> got
    end
  end
end
