defmodule Circuits.UART do
  @moduledoc """
  Serial ports: list, open, configure, read and write them.

  A process started with `start_link/1` serves one port at a time. `open/3` opens it, and can be called again whenever the
  port comes and goes. Every call returns within its documented time, whatever the port does, and the process survives all
  faults of the port and of the port program.

  ## Active and passive mode

  In active mode (the default) the process that called `open/3`, or the one named with `controlling_process/2`, gets

      {:circuits_uart, id, data}
      {:circuits_uart, id, {:partial, data}}
      {:circuits_uart, id, {:error, reason}}

  where `id` is the name given to `open/3`, or the pid of the serving process with `id: :pid`. `data` are the received bytes
  in arbitrary pieces, or whole messages with a `Circuits.UART.Framing`. An error message means that the port is now closed,
  because the line was hung up or the device unplugged; open it again when it is back. In active mode nothing slows a sender
  down, so the receiving process has to keep up.

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
    * `:ecanceled` - another process closed or reopened the port during the call
    * `:epipe` - the port program ended; the next `open/3` starts another one
    * `:etimedout` - the port program did not answer and was given up; the next `open/3` starts another one
    * `:port_program_missing` - it was not built, because there was no C compiler
  """

  alias Circuits.UART.{Enumerator, Server}

  # Limits of the port program for requests that have no time-out of their own. A caller waits longer than the limit, so that
  # the serving process always ends the wait with an answer.
  @slack 20_000
  @open_limit 10_000
  @drain_limit 10_000
  @default_limit 5_000

  @typedoc """
    * `:active` (boolean, `true`) - see "Active and passive mode"
    * `:speed` (1 to 2³²-1, `9600`) - bits per second; any rate that the device supports, not only the usual ones
    * `:data_bits` (5 to 8, `8`), `:stop_bits` (1 or 2, `1`)
    * `:parity` (`:none`) - `:space` and `:mark` send a bit that is always 0 or 1, `:ignore` sends even parity and
      checks none; with the others a byte with wrong parity is received as 0
    * `:flow_control` (`:none`) - `:hardware` is RTS/CTS, `:software` is XON/XOFF, for text only
    * `:framing` (module or `{module, args}`, `Circuits.UART.Framing.None`)
    * `:rx_framing_timeout` (ms, `0`) - how long to wait for the rest of a frame after the last byte; 0 or less: for ever
    * `:id` (`:name` or `:pid`, `:name`) - the id in the messages of active mode
    * `:rs485_...` - RS-485 of the driver, unchanged unless given; the delays are milliseconds
  """
  @type uart_option ::
          {:active, boolean()}
          | {:speed, pos_integer()}
          | {:data_bits, 5..8}
          | {:stop_bits, 1..2}
          | {:parity, :none | :even | :odd | :space | :mark | :ignore}
          | {:flow_control, :none | :hardware | :software}
          | {:framing, module() | {module(), term()}}
          | {:rx_framing_timeout, integer()}
          | {:id, :name | :pid}
          | {:rs485_enabled, boolean()}
          | {:rs485_rts_on_send, boolean()}
          | {:rs485_rts_after_send, boolean()}
          | {:rs485_rx_during_tx, boolean()}
          | {:rs485_terminate_bus, boolean()}
          | {:rs485_delay_rts_before_send, non_neg_integer()}
          | {:rs485_delay_rts_after_send, non_neg_integer()}

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

  @doc """
  The serial ports of this machine, by name.

      %{"ttyACM0" => %{vendor_id: 0x1209, product_id: 0x5741, manufacturer: "ArduPilot", description: "Pixhawk1",
                       serial_number: "3E0024", by_id: ["/dev/serial/by-id/usb-ArduPilot_Pixhawk1_3E0024-if00"]}}

  Fields that the system does not know are left out. `:by_id` names stay the same if the device is plugged in elsewhere;
  `open/3` accepts them. Only reads files, opens no port.
  """
  @spec enumerate() :: %{String.t() => map()}
  def enumerate, do: Enumerator.enumerate()

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
  Opens port `name` for this process alone: a name in `/dev` ("ttyUSB0"), in `/dev/serial/by-id`, or a path.

  An open port is closed first. Line settings, framing and time-out that are not given stay as the last `open/3` or
  `configure/2` left them; `:active` and `:id` get their defaults. Bytes that the kernel received before are dropped.
  """
  @spec open(GenServer.server(), String.t(), [uart_option()]) :: :ok | {:error, reason()}
  def open(pid, name, opts \\ []) when is_binary(name) do
    GenServer.call(pid, {:open, name, opts}, @open_limit + @slack)
  end

  @doc """
  Closes the port. Unsent bytes get two seconds. Waiting callers get `{:error, :ecanceled}`.
  """
  @spec close(GenServer.server()) :: :ok | {:error, reason()}
  def close(pid), do: GenServer.call(pid, :close, @default_limit + @slack)

  @doc "Changes options: all of them or, if one is not possible, none."
  @spec configure(GenServer.server(), [uart_option()]) :: :ok | {:error, reason()}
  def configure(pid, opts), do: GenServer.call(pid, {:configure, opts}, @default_limit + @slack)

  @doc "The name of the open port and the options in force."
  @spec configuration(GenServer.server()) :: {String.t() | :closed, [uart_option()]}
  def configuration(pid), do: GenServer.call(pid, :configuration)

  @doc "Sends a break of `duration` milliseconds. It also ends if the caller dies before."
  @spec send_break(GenServer.server(), non_neg_integer()) :: :ok | {:error, reason()}
  def send_break(pid, duration \\ 250) when is_integer(duration) and duration >= 0 do
    GenServer.call(pid, {:send_break, duration}, duration + 2 * @default_limit + @slack)
  end

  @doc "Begins or ends a break."
  @spec set_break(GenServer.server(), boolean()) :: :ok | {:error, reason()}
  def set_break(pid, value) when is_boolean(value), do: set(pid, :break, value)

  @doc """
  Writes, and returns when the kernel has accepted all bytes (`drain/1` waits until they are sent).

  `{:error, :eagain}` after `timeout` milliseconds means that the kernel may have accepted a part of the bytes. Raises in the
  caller if `data` is not iodata. With framing, `data` is one message.
  """
  @spec write(GenServer.server(), iodata(), non_neg_integer()) :: :ok | {:error, reason()}
  def write(pid, data, timeout \\ 5_000) when is_integer(timeout) and timeout >= 0 do
    GenServer.call(pid, {:write, IO.iodata_to_binary(data), timeout}, timeout + @slack)
  end

  @doc """
  Returns data (with framing, a message) as soon as there is some, in passive mode; `{:ok, ""}` after `timeout` milliseconds.
  """
  @spec read(GenServer.server(), non_neg_integer()) ::
          {:ok, binary()} | {:ok, {:partial, binary()}} | {:ok, term()} | {:error, reason()}
  def read(pid, timeout \\ 5_000) when is_integer(timeout) and timeout >= 0 do
    GenServer.call(pid, {:read, timeout}, timeout + @slack)
  end

  @doc "Waits until all written bytes are sent, at most ten seconds."
  @spec drain(GenServer.server()) :: :ok | {:error, reason()}
  def drain(pid), do: GenServer.call(pid, {:drain, @drain_limit}, @drain_limit + @slack)

  @doc """
  Drops received bytes that were not read (parts of frames included), written bytes that were not sent, or both.

  Earlier writes that still wait are finished first.
  """
  @spec flush(GenServer.server(), :receive | :transmit | :both) :: :ok | {:error, reason()}
  def flush(pid, direction \\ :both) do
    GenServer.call(pid, {:flush, direction, @default_limit}, @default_limit + @slack)
  end

  @doc """
  The state of the modem lines: `:dtr`, `:rts` (ours), `:dsr`, `:cts`, `:cd`, `:rng` (theirs), `:st`, `:sr` (secondary).
  """
  @spec signals(GenServer.server()) :: {:ok, %{atom() => boolean()}} | {:error, reason()}
  def signals(pid), do: GenServer.call(pid, :signals, @default_limit + @slack)

  @doc "Sets or clears Data Terminal Ready."
  @spec set_dtr(GenServer.server(), boolean()) :: :ok | {:error, reason()}
  def set_dtr(pid, value) when is_boolean(value), do: set(pid, :dtr, value)

  @doc "Sets or clears Request To Send."
  @spec set_rts(GenServer.server(), boolean()) :: :ok | {:error, reason()}
  def set_rts(pid, value) when is_boolean(value), do: set(pid, :rts, value)

  @doc "Sends the messages of active mode to `controlling_process` from now on."
  @spec controlling_process(GenServer.server(), pid()) :: :ok
  def controlling_process(pid, controlling_process) when is_pid(controlling_process) do
    GenServer.call(pid, {:controlling_process, controlling_process})
  end

  defp set(pid, line, value), do: GenServer.call(pid, {:set, line, value}, @default_limit + @slack)
end
