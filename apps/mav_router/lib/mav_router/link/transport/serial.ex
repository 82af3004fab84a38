defmodule MavRouter.Link.Transport.Serial do
  @max_waiting 8_192
  @max_messages 256

  @moduledoc """
  A serial port, by `Circuits.UART` in active mode: what is received comes straight to the link's process.

  If the port or its baud rate has to be found first, `MavRouter.Link.Serial.Detection` does that while opening; the port
  then stays open, and what was received meanwhile is read first.

  The port belongs to a process of its own (`MavRouter.Link.Serial.UartProcess`), which also writes: at 57,600 baud a frame takes
  milliseconds, in which the link goes on reading. At most #{@max_waiting} bytes wait to be written; more is refused.

  When more than #{@max_messages} messages wait in the link's mailbox, nothing is read from the port until they are handled; the bytes
  of a faster sender wait in the kernel.
  """
  @behaviour MavRouter.Link.Transport

  alias MavRouter.Link.Transport.Serial.ConnectionString
  alias MavRouter.Link.Serial.Detection
  alias MavRouter.Link.Serial.Finding
  alias Aerie.Base.Net.SerialPorts
  alias MavCodec.Sniff
  alias MavRouter.Link.Serial.UartProcess

  @batch 64
  @sniff_ms 1_500

  @enforce_keys [:holder, :uart, :device]
  defstruct [:holder, :uart, :device, :finding, :baud, waiting: 0, head: "", paused: false, sniffed: nil]

  @impl MavRouter.Link.Transport
  def traits, do: %{kind: :serial, framing: :stream, sniffed: true}

  @impl MavRouter.Link.Transport
  defdelegate forms(), to: ConnectionString

  @impl MavRouter.Link.Transport
  defdelegate parse(prefix, rest), to: ConnectionString

  @impl MavRouter.Link.Transport
  defdelegate option(prefix, name, value), to: ConnectionString

  @impl MavRouter.Link.Transport
  def place(%{detect: :port}), do: "any serial port"
  def place(%{device: device}), do: device

  @impl MavRouter.Link.Transport
  def explain(reason, spec) when reason in [:eacces, :eperm],
    do: "no permission for #{place(spec)} (is the user in the group dialout?)"

  def explain({:timeout, {GenServer, :call, [_holder, {:open, _device, _baud}, _ms]}}, spec),
    do: "opening #{place(spec)} takes too long"

  def explain(_reason, _spec), do: nil

  @impl MavRouter.Link.Transport
  def open(%{detect: nil} = spec) do
    {:ok, holder} = UartProcess.start_link()

    case UartProcess.open(holder, spec.device, spec.baud) do
      {:ok, uart} ->
        {:ok, %__MODULE__{holder: holder, uart: uart, device: spec.device, baud: spec.baud}}

      {:error, reason} ->
        UartProcess.stop(holder)
        {:error, posix(reason)}
    end
  end

  def open(spec) do
    options = [
      ports: ports(spec),
      bauds: spec.bauds || if(msp?(spec), do: nil, else: spec.options[:serial_bauds]),
      ask: msp?(spec),
      hint: spec.options[:hint]
    ]

    with {:ok, holder, finding, bytes} <- Detection.run(options) |> explain_taken(options[:ports]) do
      {:ok,
       %__MODULE__{
         holder: holder,
         uart: UartProcess.uart(holder),
         device: finding.path,
         baud: finding.baud,
         finding: finding,
         head: bytes
       }}
    end
  end

  defp msp?(%{inner: inner}), do: inner != nil

  # There are ports, but other links have them.
  defp explain_taken({:error, {:undetected, []}}, %{taken: [_ | _]} = ports) do
    {:error,
     {:undetected,
      for(%{path: path} <- SerialPorts.list(%{ports | taken: []}), do: Finding.of_another_link(path))}}
  end

  defp explain_taken(result, _ports), do: result

  defp ports(%{detect: :port, options: options} = spec) do
    ports = if spec.ports == [], do: options[:serial_ports] || [], else: spec.ports
    Map.merge(%{ports: ports, only: spec.only, taken: options[:taken] || []}, dev(options))
  end

  defp ports(%{device: device, options: options}) do
    Map.merge(%{ports: [device], only: true}, dev(options))
  end

  defp dev(%{serial_dev: dev}), do: %{dev: dev}
  defp dev(_options), do: %{}

  @impl MavRouter.Link.Transport
  def watch(spec), do: spec |> ports() |> SerialPorts.fingerprint()

  @impl MavRouter.Link.Transport
  def give(conn, link), do: UartProcess.give(conn.holder, link)

  @impl MavRouter.Link.Transport
  def activate(conn) do
    # The opener is about to end; from now on the port ends with the link's process.
    Process.link(conn.holder)
    if conn.head != "", do: send(self(), {:serial_head, conn.holder})
    UartProcess.go(conn.holder)
    {:ok, conn, info(conn)}
  end

  defp info(%{finding: nil} = conn), do: %{local: conn.device, baud: conn.baud}

  defp info(conn) do
    %{
      local: conn.device,
      baud: conn.baud,
      peer: "#{conn.device} at #{conn.baud} baud",
      finding: conn.finding
    }
  end

  @impl MavRouter.Link.Transport
  def handle(%{uart: uart} = conn, {:circuits_uart, uart, bytes}) when is_binary(bytes) do
    conn |> hold_back() |> received([bytes | drain(uart, @batch)])
  end

  def handle(%{uart: uart} = conn, {:circuits_uart, uart, {:error, reason}}),
    do: {[{:closed, gone(conn, reason)}], conn}

  def handle(%{uart: uart} = conn, {:circuits_uart, uart, _partial}), do: {[], conn}

  def handle(%{holder: holder} = conn, {:serial_head, holder}), do: received(%{conn | head: ""}, [conn.head])

  def handle(%{holder: holder} = conn, {:serial_caught_up, holder}) do
    UartProcess.go(holder)
    {[], %{conn | paused: false}}
  end

  def handle(%{holder: holder} = conn, {:serial_sniffed, holder}) do
    sniffed = conn.sniffed |> Enum.reverse() |> IO.iodata_to_binary() |> Sniff.classify()
    {[{:sniffed, conn.device, conn.baud, sniffed}], %{conn | sniffed: nil}}
  end

  def handle(%{holder: holder} = conn, {:serial_written, holder, bytes, result}) do
    event = if result == :ok, do: {:ok, bytes}, else: result
    {[{:written, event}], %{conn | waiting: conn.waiting - bytes}}
  end

  def handle(%{holder: holder} = conn, {:EXIT, holder, {:shutdown, reason}}) do
    {[{:closed, gone(conn, reason)}], conn}
  end

  def handle(%{holder: holder} = conn, {:EXIT, holder, reason}), do: {[{:closed, reason}], conn}
  def handle(_conn, _message), do: :unknown

  defp received(conn, reads) do
    {[{:read, Enum.map(reads, &{:remote, &1})}], collect(conn, reads)}
  end

  defp drain(_uart, 0), do: []

  defp drain(uart, room) do
    receive do
      {:circuits_uart, ^uart, bytes} when is_binary(bytes) -> [bytes | drain(uart, room - 1)]
    after
      0 -> []
    end
  end

  defp hold_back(%{paused: true} = conn), do: conn

  defp hold_back(conn) do
    {:message_queue_len, waiting} = Process.info(self(), :message_queue_len)

    if waiting > @max_messages do
      UartProcess.pause(conn.holder)
      # It comes behind everything that waits now.
      send(self(), {:serial_caught_up, conn.holder})
      %{conn | paused: true}
    else
      conn
    end
  end

  @impl MavRouter.Link.Transport
  def sniff(%{sniffed: nil} = conn) do
    Process.send_after(self(), {:serial_sniffed, conn.holder}, @sniff_ms)
    %{conn | sniffed: []}
  end

  def sniff(conn), do: conn

  defp collect(%{sniffed: nil} = conn, _reads), do: conn

  defp collect(%{sniffed: sniffed} = conn, reads) do
    if IO.iodata_length(sniffed) < Sniff.max_bytes(),
      do: %{conn | sniffed: Enum.reverse(reads) ++ sniffed},
      else: conn
  end

  @impl MavRouter.Link.Transport
  def write(%{waiting: waiting} = conn, _peer, _bytes) when waiting > @max_waiting, do: {:busy, conn}

  def write(conn, _peer, bytes) do
    bytes = IO.iodata_to_binary(bytes)
    UartProcess.write(conn.holder, bytes)
    {:ok, %{conn | waiting: conn.waiting + byte_size(bytes)}}
  end

  @impl MavRouter.Link.Transport
  def close(conn) do
    Process.unlink(conn.holder)
    if conn.waiting > 0, do: UartProcess.flush(conn.holder)
    UartProcess.stop(conn.holder)
  end

  # The name in the spec may be no port's. `:ebadf` is the same fault, a moment later.
  # Which one it is depends on the driver, and on what was being done.
  defp gone(conn, reason) when reason in [:eio, :ebadf, :enodev, :enxio], do: "#{conn.device} was unplugged"
  defp gone(_conn, reason), do: posix(reason)

  # Reasons that mean something particular for a serial port.
  defp posix(:eagain), do: :ebusy
  defp posix(:enotty), do: "it is not a serial port"
  defp posix(:einval), do: "the port does not support this baud rate"
  defp posix(:epipe), do: "the program that serves the port ended"

  defp posix(:port_program_missing),
    do: "serial ports need a C compiler when the gateway is built: install gcc, then run bin/setup"

  defp posix(reason), do: reason
end
