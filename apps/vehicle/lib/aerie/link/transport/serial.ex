defmodule Aerie.Link.Transport.Serial do
  @moduledoc """
  A serial port, over `Circuits.UART` in active mode: what is received comes straight to the link's process.

  The port belongs to a process of its own (`Aerie.Link.Transport.Serial.Holder`), which also writes: at 57,600 baud a
  frame takes milliseconds, during which the link goes on reading. At most #{8_192} bytes wait for it; more is refused.
  """
  @behaviour Aerie.Link.Transport

  alias Aerie.Link.Transport.Serial.Holder

  @max_waiting 8_192

  @enforce_keys [:holder, :uart, :device]
  defstruct [:holder, :uart, :device, waiting: 0]

  @impl Aerie.Link.Transport
  def framing, do: :stream

  @impl Aerie.Link.Transport
  def open(spec) do
    {:ok, holder} = Holder.start_link()

    case Holder.open(holder, spec.device, speed: spec.baud, active: true, id: :pid) do
      {:ok, uart} ->
        {:ok, %__MODULE__{holder: holder, uart: uart, device: spec.device}}

      {:error, reason} ->
        Holder.stop(holder)
        {:error, words(reason)}
    end
  end

  @impl Aerie.Link.Transport
  def give(conn, link), do: Holder.give(conn.holder, link)

  @impl Aerie.Link.Transport
  def activate(conn) do
    # The opener is about to end; from here on the port lives and dies with the link's process.
    Process.link(conn.holder)
    {:ok, conn, %{local: conn.device}}
  end

  @impl Aerie.Link.Transport
  def handle(%{uart: uart} = conn, {:circuits_uart, uart, bytes}) when is_binary(bytes) do
    {[{:read, [{:remote, bytes} | drain(uart, 64)]}], conn}
  end

  def handle(%{uart: uart} = conn, {:circuits_uart, uart, {:error, reason}}),
    do: {[{:closed, words(reason)}], conn}

  def handle(%{uart: uart} = conn, {:circuits_uart, uart, _partial}), do: {[], conn}

  def handle(%{holder: holder} = conn, {:serial_written, holder, bytes, result}) do
    event = if result == :ok, do: {:ok, bytes}, else: result
    {[{:written, event}], %{conn | waiting: conn.waiting - bytes}}
  end

  def handle(%{holder: holder} = conn, {:EXIT, holder, reason}), do: {[{:closed, reason}], conn}
  def handle(_conn, _message), do: :unknown

  defp drain(_uart, 0), do: []

  defp drain(uart, room) do
    receive do
      {:circuits_uart, ^uart, bytes} when is_binary(bytes) -> [{:remote, bytes} | drain(uart, room - 1)]
    after
      0 -> []
    end
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

  # What means something particular for a serial port.
  defp words(:eagain), do: :ebusy
  defp words(:enotty), do: "that file is no serial port"
  defp words(:einval), do: "the port does not do this baud rate"
  defp words(:epipe), do: "the program that serves the port ended"

  defp words(:port_program_missing),
    do: "serial ports need a C compiler at set-up: install gcc, then run bin/setup"

  defp words(reason), do: reason
end
