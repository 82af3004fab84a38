defmodule Aerie.Link.Transport.Serial do
  @moduledoc """
  A serial port, over `Circuits.UART` in active mode: what is received comes straight to the link's process.

  Where the port or its baud rate is to be found first, `Aerie.Link.Serial.Detection` does that while opening; the port
  then stays open, and what it said meanwhile is read first.

  The port belongs to a process of its own (`Aerie.Link.Serial.Holder`), which also writes: at 57,600 baud a
  frame takes milliseconds, during which the link goes on reading. At most #{8_192} bytes wait for it; more is refused.

  A sender that is faster than this link waits in the kernel: when more than #{256} messages wait in the link's mailbox,
  nothing more is read of the port until they are dealt with.
  """
  @behaviour Aerie.Link.Transport

  alias Aerie.Link.Serial.Detection
  alias Aerie.Link.Serial.Finding
  alias Aerie.Link.Serial.Ports
  alias Aerie.Link.Serial.Sniff
  alias Aerie.Link.Spec
  alias Aerie.Link.Serial.Holder

  @max_waiting 8_192
  @max_messages 256
  @batch 64
  @sniff_ms 1_500

  @enforce_keys [:holder, :uart, :device]
  defstruct [:holder, :uart, :device, :finding, :baud, waiting: 0, head: "", paused: false, sniffed: nil]

  @impl Aerie.Link.Transport
  def framing, do: :stream

  @impl Aerie.Link.Transport
  def open(%Spec{detect: nil} = spec) do
    {:ok, holder} = Holder.start_link()

    case Holder.open(holder, spec.device, spec.baud) do
      {:ok, uart} ->
        {:ok, %__MODULE__{holder: holder, uart: uart, device: spec.device, baud: spec.baud}}

      {:error, reason} ->
        Holder.stop(holder)
        {:error, words(reason)}
    end
  end

  def open(%Spec{} = spec) do
    options = [
      ports: ports(spec),
      bauds: spec.bauds || spec.options[:serial_bauds],
      hint: spec.options[:hint]
    ]

    with {:ok, holder, finding, bytes} <- Detection.run(options) |> others(options[:ports]) do
      {:ok,
       %__MODULE__{
         holder: holder,
         uart: Holder.uart(holder),
         device: finding.path,
         baud: finding.baud,
         finding: finding,
         head: bytes
       }}
    end
  end

  # There are ports, but other links have them.
  defp others({:error, {:undetected, []}}, %{taken: [_ | _]} = ports) do
    {:error,
     {:undetected, for(%{path: path} <- Ports.list(%{ports | taken: []}), do: Finding.of_another_link(path))}}
  end

  defp others(result, _ports), do: result

  defp ports(%Spec{detect: :port, options: options} = spec) do
    ports = if spec.ports == [], do: options[:serial_ports] || [], else: spec.ports
    Map.merge(%{ports: ports, only: spec.only, taken: options[:taken] || []}, dev(options))
  end

  defp ports(%Spec{device: device, options: options}) do
    Map.merge(%{ports: [device], only: true}, dev(options))
  end

  defp dev(%{serial_dev: dev}), do: %{dev: dev}
  defp dev(_options), do: %{}

  @impl Aerie.Link.Transport
  def watch(%Spec{} = spec), do: spec |> ports() |> Ports.fingerprint()

  @impl Aerie.Link.Transport
  def give(conn, link), do: Holder.give(conn.holder, link)

  @impl Aerie.Link.Transport
  def activate(conn) do
    # The opener is about to end; from here on the port lives and dies with the link's process.
    Process.link(conn.holder)
    if conn.head != "", do: send(self(), {:serial_head, conn.holder})
    Holder.go(conn.holder)
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

  @impl Aerie.Link.Transport
  def handle(%{uart: uart} = conn, {:circuits_uart, uart, bytes}) when is_binary(bytes) do
    conn |> hold_back() |> received([bytes | drain(uart, @batch)])
  end

  def handle(%{uart: uart} = conn, {:circuits_uart, uart, {:error, reason}}),
    do: {[{:closed, gone(conn, reason)}], conn}

  def handle(%{uart: uart} = conn, {:circuits_uart, uart, _partial}), do: {[], conn}

  def handle(%{holder: holder} = conn, {:serial_head, holder}), do: received(%{conn | head: ""}, [conn.head])

  def handle(%{holder: holder} = conn, {:serial_caught_up, holder}) do
    Holder.go(holder)
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
      Holder.pause(conn.holder)
      # Behind all that waits now.
      send(self(), {:serial_caught_up, conn.holder})
      %{conn | paused: true}
    else
      conn
    end
  end

  @impl Aerie.Link.Transport
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

  @impl Aerie.Link.Transport
  def write(%{waiting: waiting} = conn, _peer, _bytes) when waiting > @max_waiting, do: {:busy, conn}

  def write(conn, _peer, bytes) do
    bytes = IO.iodata_to_binary(bytes)
    Holder.write(conn.holder, bytes)
    {:ok, %{conn | waiting: conn.waiting + byte_size(bytes)}}
  end

  @impl Aerie.Link.Transport
  def close(conn) do
    Process.unlink(conn.holder)
    Holder.stop(conn.holder)
  end

  # The link's own name may be that of no port. `:ebadf` is the same, seen a moment later.
  defp gone(conn, reason) when reason in [:eio, :ebadf], do: "#{conn.device} was unplugged"
  defp gone(_conn, reason), do: words(reason)

  # What means something particular for a serial port.
  defp words(:eagain), do: :ebusy
  defp words(:enotty), do: "that file is no serial port"
  defp words(:einval), do: "the port does not do this baud rate"
  defp words(:epipe), do: "the program that serves the port ended"

  defp words(:port_program_missing),
    do: "serial ports need a C compiler at set-up: install gcc, then run bin/setup"

  defp words(reason), do: reason
end
