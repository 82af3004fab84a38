defmodule Aerie.Link.Transport.Serial.Holder do
  @moduledoc """
  Holds one open serial port for a link and writes to it, one write after the other.

  It is linked to the link's process and to the port's: when one of the three ends, so do the others.
  """
  use GenServer

  @write_ms 2_000
  @open_ms 20_000

  @doc "Starts one without a port, linked to the calling process until `give/2`."
  @spec start_link() :: GenServer.on_start()
  def start_link, do: GenServer.start_link(__MODULE__, nil)

  @doc "Opens the port; gives the process whose messages will come."
  @spec open(pid, String.t(), keyword) :: {:ok, pid} | {:error, term}
  def open(holder, device, options), do: GenServer.call(holder, {:open, device, options}, @open_ms)

  @doc "From now on what is received goes to `link`."
  @spec give(pid, pid) :: :ok
  def give(holder, link), do: GenServer.call(holder, {:give, link})

  @doc "Writes later; the link gets `{:serial_written, holder, bytes, :ok | {:error, reason}}`."
  @spec write(pid, binary) :: :ok
  def write(holder, bytes), do: GenServer.cast(holder, {:write, bytes})

  @doc "Ends it, and closes the port."
  @spec stop(pid) :: :ok
  def stop(holder) do
    Process.unlink(holder)
    Process.exit(holder, :shutdown)
    :ok
  end

  @impl GenServer
  def init(nil), do: {:ok, %{uart: nil, link: nil}}

  @impl GenServer
  def handle_call({:open, device, options}, _from, state) do
    Process.set_label({:serial, device})
    {:ok, uart} = Circuits.UART.start_link()

    case Circuits.UART.open(uart, device, options) do
      :ok -> {:reply, {:ok, uart}, %{state | uart: uart}}
      {:error, reason} -> {:reply, {:error, reason}, state}
    end
  end

  def handle_call({:give, link}, _from, state) do
    Process.link(link)
    :ok = Circuits.UART.controlling_process(state.uart, link)
    {:reply, :ok, %{state | link: link}}
  end

  @impl GenServer
  def handle_cast({:write, bytes}, state) do
    result = Circuits.UART.write(state.uart, bytes, @write_ms)
    send(state.link, {:serial_written, self(), byte_size(bytes), result})
    {:noreply, state}
  end

  # What was received before the link took over: the parser begins in the middle anyway.
  @impl GenServer
  def handle_info({:circuits_uart, _uart, _received}, state), do: {:noreply, state}
end
