defmodule Circuits.UART do
  @moduledoc """
  Serial ports: open, configure, read and write them.

  A process started with `start_link/1` serves one port at a time. `open/3` opens it, and can be called again whenever the
  port comes and goes. Every call returns within its documented time, whatever the port does, and the process survives all
  faults of the port and of the port program.

  ## Active and passive mode

  In active mode (the default) the process that called `open/3`, or the one named with `controlling_process/2`, gets

      {:circuits_uart, id, data}
      {:circuits_uart, id, {:error, reason}}

  where `id` is the path given to `open/3`, or the pid of the serving process with `id: :pid`. `data` are the received bytes
  in arbitrary pieces. An error message means that the port is now closed, because the line was hung up or the device
  unplugged; open it again when it is back. In active mode nothing slows a sender down, so the receiving process has to keep
  up.

  In passive mode `read/2` fetches data. Other data stays in the kernel, so flow control works. The next `read/2` or
  `write/3` returns a hang-up.

  ## Errors

  Errors are POSIX names as atoms. Those that mean something particular here:

    * `:enoent`, `:eacces` - there is no such port; this user must not open it
    * `:eagain` - from `open/3`: another process has the port open and holds its lock; from `write/3` and `drain/1`: the
      time was not enough for all bytes
    * `:ebusy` - another process has the port open in the kernel's exclusive mode
    * `:enotty` - the file is not a serial port
    * `:einval` - an unknown option or an invalid value, a speed that the device does not support (more than five percent
      off), `read/2` in active mode
    * `:ebadf` - no port is open
    * `:eio` - the line was hung up: a cable pulled, a PTY's other side closed
    * `:ecanceled` - another process reopened the port during the call
    * `:epipe` - the port program ended; the next `open/3` starts another one
    * `:etimedout` - the port program did not answer and was given up; the next `open/3` starts another one
    * `:port_program_missing` - it was not built, because there was no C compiler
  """

  alias Circuits.UART.Server

  # Limits of the port program for requests that have no time-out of their own. A caller waits longer than the limit, so that
  # the serving process always ends the wait with an answer.
  @slack 20_000
  @open_limit 10_000
  @drain_limit 10_000
  @default_limit 5_000

  @typedoc """
    * `:active` (boolean, `true`) - see "Active and passive mode"
    * `:speed` (1 to 2³²-1, `9600`) - bits per second; any rate that the device supports, not only the usual ones
    * `:id` (`:name` or `:pid`, `:name`) - the id in the messages of active mode

  The line has eight data bits, one stop bit, no parity and no flow control.
  """
  @type uart_option :: {:active, boolean()} | {:speed, pos_integer()} | {:id, :name | :pid}

  @typedoc "See \"Errors\" above."
  @type reason :: atom()

  @doc false
  def child_spec(opts) do
    %{id: __MODULE__, start: {__MODULE__, :start_link, [opts]}}
  end

  @doc "Starts a process that can serve a port. `opts` are those of `GenServer.start_link/3`, such as `:name`."
  @spec start_link(GenServer.options()) :: GenServer.on_start()
  def start_link(opts \\ []), do: GenServer.start_link(Server, [], opts)

  @doc "Stops the serving process and closes its port. Unsent bytes are dropped (see `drain/1`)."
  @spec stop(GenServer.server()) :: :ok
  def stop(pid), do: GenServer.stop(pid)

  @doc "The serving processes of this node and their ports, for debugging."
  @spec find_pids() :: [{pid(), String.t() | :closed}]
  def find_pids do
    for pid <- Process.list(),
        Server.serves?(pid),
        {name, _options} <- safe_configuration(pid),
        do: {pid, name}
  end

  # It may have ended meanwhile.
  defp safe_configuration(pid) do
    [configuration(pid)]
  catch
    :exit, _reason -> []
  end

  @doc """
  Opens the port at a path ("/dev/ttyUSB0") for this process alone.

  An open port is closed first. A speed that is not given stays as the last `open/3` or `configure/2` left it; `:active` and
  `:id` get their defaults. Bytes that the kernel received before are dropped.
  """
  @spec open(GenServer.server(), Path.t(), [uart_option()]) :: :ok | {:error, reason()}
  def open(pid, path, opts \\ []) when is_binary(path) do
    GenServer.call(pid, {:open, path, opts}, @open_limit + @slack)
  end

  @doc "Changes options: all of them or, if one is not possible, none."
  @spec configure(GenServer.server(), [uart_option()]) :: :ok | {:error, reason()}
  def configure(pid, opts), do: GenServer.call(pid, {:configure, opts}, @default_limit + @slack)

  @doc "The path of the open port and the options in force."
  @spec configuration(GenServer.server()) :: {Path.t() | :closed, [uart_option()]}
  def configuration(pid), do: GenServer.call(pid, :configuration)

  @doc """
  Writes, and returns when the kernel has accepted all bytes (`drain/1` waits until they are sent).

  `{:error, :eagain}` after `timeout` milliseconds means that the kernel may have accepted a part of the bytes. Raises in the
  caller if `data` is not iodata.
  """
  @spec write(GenServer.server(), iodata(), non_neg_integer()) :: :ok | {:error, reason()}
  def write(pid, data, timeout \\ 5_000) when is_integer(timeout) and timeout >= 0 do
    GenServer.call(pid, {:write, IO.iodata_to_binary(data), timeout}, timeout + @slack)
  end

  @doc "Returns data as soon as there is some, in passive mode; `{:ok, \"\"}` after `timeout` milliseconds."
  @spec read(GenServer.server(), non_neg_integer()) :: {:ok, binary()} | {:error, reason()}
  def read(pid, timeout \\ 5_000) when is_integer(timeout) and timeout >= 0 do
    GenServer.call(pid, {:read, timeout}, timeout + @slack)
  end

  @doc "Waits until all written bytes are sent, at most ten seconds."
  @spec drain(GenServer.server()) :: :ok | {:error, reason()}
  def drain(pid), do: GenServer.call(pid, {:drain, @drain_limit}, @drain_limit + @slack)

  @doc "Drops received bytes that were not read."
  @spec flush(GenServer.server(), :receive) :: :ok | {:error, reason()}
  def flush(pid, :receive), do: GenServer.call(pid, {:flush, @default_limit}, @default_limit + @slack)

  @doc "Sends the messages of active mode to `controlling_process` from now on."
  @spec controlling_process(GenServer.server(), pid()) :: :ok
  def controlling_process(pid, controlling_process) when is_pid(controlling_process) do
    GenServer.call(pid, {:controlling_process, controlling_process})
  end
end
