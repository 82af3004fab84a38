defmodule MavRouter.Link.Serial.UartProcess do
  @moduledoc """
  Holds one open serial port and does everything that may block: opening, changing the rate, writing and, during a search,
  reading.

  It is linked to the process that started it, later to the link's process, and to the port's process: when one of them ends,
  all do.

  During a search it answers each request of the starting process with `{:serial, holder, event}`; the events are those of
  `MavRouter.Link.Serial.Probe`. After `give/2` and `go/1` received bytes go straight to the link's process, as messages of
  `Circuits.UART`.
  """
  use GenServer

  import Bitwise, only: [bsr: 2]

  alias Aerie.Base.Net.PortOwner
  alias Circuits.UART

  # Major numbers of the devices /dev/pts/* on Linux.
  @pty_majors 136..143
  @write_ms 2_000
  @open_ms 20_000
  @call_ms 30_000
  @flush_ms 500

  @doc "Starts a holder without a port, linked to the calling process."
  @spec start_link() :: GenServer.on_start()
  def start_link, do: GenServer.start_link(__MODULE__, self())

  @doc """
  Opens the port and waits for the result; nothing is read before `go/1`. Returns the process that will send the messages.

  A port that another program has open, with or without a lock, is refused with `{:in_use, who}`: two readers would take
  bytes from each other.
  """
  @spec open(pid, String.t(), pos_integer) :: {:ok, pid} | {:error, term}
  def open(holder, device, baud), do: GenServer.call(holder, {:open, device, baud}, @open_ms)

  @doc "Opens the port without waiting; the event is `:opened` or `{:open_failed, reason}`."
  @spec listen(pid, String.t(), pos_integer) :: :ok
  def listen(holder, device, baud), do: GenServer.cast(holder, {:listen, device, baud})

  @doc "Changes the rate and drops what came at the old one; the event is `:set` or `{:set_failed, reason}`."
  @spec set(pid, pos_integer) :: :ok
  def set(holder, baud), do: GenServer.cast(holder, {:set, baud})

  @doc """
  Reads once, for at most `ms`; the event is `{:read, bytes}`, empty if none came, or `{:read_failed, reason}`.
  """
  @spec read(pid, non_neg_integer) :: :ok
  def read(holder, ms), do: GenServer.cast(holder, {:read, ms})

  @doc "The process that will send messages after `go/1`."
  @spec uart(pid) :: pid
  def uart(holder), do: GenServer.call(holder, :uart, @call_ms)

  @doc "Makes `link` the owner."
  @spec give(pid, pid) :: :ok
  def give(holder, link), do: GenServer.call(holder, {:give, link}, @call_ms)

  @doc "Sends received bytes to the link from now on, beginning with those since the last `read/2`."
  @spec go(pid) :: :ok
  def go(holder), do: GenServer.cast(holder, {:active, true})

  @doc "Sends nothing to the link until `go/1`; received bytes stay in the kernel."
  @spec pause(pid) :: :ok
  def pause(holder), do: GenServer.cast(holder, {:active, false})

  @doc "Writes without waiting; the link gets `{:serial_written, holder, bytes, :ok | {:error, reason}}`."
  @spec write(pid, binary) :: :ok
  def write(holder, bytes), do: GenServer.cast(holder, {:write, bytes})

  @doc "Waits until what was to be written is on the line, but not long: the port may be gone."
  @spec flush(pid) :: :ok
  def flush(holder) do
    GenServer.call(holder, :flush, @flush_ms)
  catch
    :exit, _gone_or_busy -> :ok
  end

  @doc "Ends the holder, which closes the port."
  @spec stop(pid) :: :ok
  def stop(holder) do
    Process.unlink(holder)
    Process.exit(holder, :shutdown)
    :ok
  end

  @impl GenServer
  def init(owner), do: {:ok, %{uart: nil, owner: owner}}

  @impl GenServer
  def handle_call({:open, device, baud}, _from, state) do
    case open_port(device, baud) do
      {:ok, uart} -> {:reply, {:ok, uart}, %{state | uart: uart}}
      {:error, reason} -> {:reply, {:error, reason}, state}
    end
  end

  def handle_call(:uart, _from, state), do: {:reply, state.uart, state}

  # Behind the writes of before.
  def handle_call(:flush, _from, state) do
    _ = state.uart && UART.drain(state.uart)
    {:reply, :ok, state}
  end

  def handle_call({:give, link}, _from, state) do
    Process.link(link)
    :ok = UART.controlling_process(state.uart, link)
    {:reply, :ok, %{state | owner: link}}
  end

  @impl GenServer
  def handle_cast({:listen, device, baud}, state) do
    case open_port(device, baud) do
      {:ok, uart} -> {:noreply, notify(%{state | uart: uart}, :opened)}
      {:error, reason} -> {:noreply, notify(state, {:open_failed, reason})}
    end
  end

  def handle_cast({:set, baud}, state) do
    with :ok <- UART.configure(state.uart, speed: baud), :ok <- UART.flush(state.uart, :receive) do
      {:noreply, notify(state, :set)}
    else
      {:error, reason} -> {:noreply, notify(state, {:set_failed, reason})}
    end
  end

  def handle_cast({:read, ms}, state) do
    case UART.read(state.uart, ms) do
      {:ok, bytes} -> {:noreply, notify(state, {:read, bytes})}
      {:error, reason} -> {:noreply, notify(state, {:read_failed, reason})}
    end
  end

  def handle_cast({:active, active}, state) do
    result = UART.configure(state.uart, active: active)

    # The end of a port without a reader is not reported.
    case {result, UART.configuration(state.uart)} do
      {:ok, {name, _options}} when name != :closed -> {:noreply, state}
      {:ok, {:closed, _options}} -> {:stop, {:shutdown, :eio}, state}
      {{:error, reason}, _any} -> {:stop, {:shutdown, reason}, state}
    end
  end

  def handle_cast({:write, bytes}, state) do
    result = UART.write(state.uart, bytes, @write_ms)
    send(state.owner, {:serial_written, self(), byte_size(bytes), result})
    {:noreply, state}
  end

  defp open_port(device, baud) do
    Process.set_label({:serial, device})
    with :ok <- free(device), do: open_free(device, baud)
  end

  # The creator of a PTY also has it open, without reading from it.
  defp free(device) do
    with {:ok, %File.Stat{type: type, minor_device: number}} <- File.stat(device),
         false <- type == :device and bsr(number, 8) in @pty_majors,
         {:in_use, _who} = reason <- owner(device) do
      {:error, reason}
    else
      _pty_or_nobody -> :ok
    end
  end

  defp open_free(device, baud) do
    {:ok, uart} = UART.start_link()

    case UART.open(uart, device, speed: baud, active: false, id: :pid) do
      :ok ->
        {:ok, uart}

      {:error, reason} ->
        UART.stop(uart)
        {:error, if(reason in [:eagain, :ebusy], do: owner(device) || reason, else: reason)}
    end
  end

  # Known only if we may see the other process. Who has the lock counts: a link that is refused as well, or that was just stopped,
  # has the port open for a moment.
  defp owner(device) do
    holders = PortOwner.holders(device)

    case {PortOwner.lockers(device, holders), holders} do
      {[], []} -> nil
      {[], holders} -> {:in_use, who(holders)}
      {lockers, _holders} -> {:in_use, who(lockers)}
    end
  end

  defp who(holders), do: if(Enum.any?(holders, &link?/1), do: "another link", else: names(holders))

  defp link?({program, pid}), do: program == "circuits_uart" and PortOwner.ours?(pid)

  defp names(holders) do
    holders |> Enum.take(3) |> Enum.map_join(", ", fn {program, pid} -> "#{program} (process #{pid})" end)
  end

  defp notify(state, event) do
    send(state.owner, {:serial, self(), event})
    state
  end
end
