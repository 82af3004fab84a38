defmodule Aerie.Fleet.Client.MavlinkSocket do
  @moduledoc """
  One program at `mavlink.sock`: an endpoint of the router like any ground station. A program that may open the socket
  may command vehicles; the file's permissions say which ones may.

  Writing never waits: frames for which the socket has no room stay in the pipe's queue and are tried again. A program
  that reads nothing for half a minute is disconnected; one that sends anything but lengths and frames is disconnected
  at once.
  """
  use GenServer, restart: :temporary

  alias MavRouter.Client.Connection
  alias Aerie.Base.Store
  alias Aerie.Base.Net.UnixSocket.LengthPrefix
  alias MavRouter.Link.Transport.Net
  alias Aerie.Base.Names

  @again_ms 10
  @patience_ms 30_000

  @doc "Options: `:gateway`, `:sign` (as `clients[].sign`; false when absent)."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options), do: GenServer.start_link(__MODULE__, options)

  @impl GenServer
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    Process.set_label({:mavlink_client, gateway})
    sign = Keyword.get(options, :sign, false)
    state = %{gateway: gateway, sign: sign, socket: nil, pipe: nil, rest: "", timer: nil, wrote: now()}
    # A connection that never comes must not leave a process behind.
    {:ok, state, 5_000}
  end

  @impl GenServer
  def handle_info({:socket, socket}, %{socket: nil} = state) do
    id = "unix-#{System.unique_integer([:positive])}"
    options = [active: Net.active(), buffer: 65_536, high_watermark: 262_144, send_timeout: 1_000]

    with :ok <- Names.register(state.gateway, :unix_client, id),
         {:ok, pipe} <-
           Connection.open(state.gateway, id: id, kind: :unix, text: "mavlink.sock", sign: state.sign),
         :ok <- :inet.setopts(socket, options ++ [send_timeout_close: true]) do
      {:noreply, %{state | socket: socket, pipe: pipe, wrote: now()}}
    else
      {:error, _gone} -> {:stop, :normal, state}
    end
  end

  def handle_info({:tcp, socket, bytes}, %{socket: socket} = state) do
    case LengthPrefix.split(state.rest <> bytes) do
      {:ok, frames, rest} ->
        pipe = Enum.reduce(frames, state.pipe, &Connection.read(&2, &1))
        # A kept part must not keep the whole read in memory.
        {:noreply, %{state | pipe: pipe, rest: :binary.copy(rest)}}

      {:error, _length} ->
        leave(state, :malformed)
    end
  end

  def handle_info({:tcp_passive, socket}, %{socket: socket} = state) do
    _ = :inet.setopts(socket, active: Net.active())
    {:noreply, state}
  end

  def handle_info({:forward, frames, class}, state),
    do: write(%{state | pipe: Connection.queue(state.pipe, frames, class)})

  def handle_info(:again, state), do: write(%{state | timer: nil})
  def handle_info(:disconnect, state), do: {:stop, :normal, state}
  def handle_info({:tcp_closed, socket}, %{socket: socket} = state), do: {:stop, :normal, state}
  def handle_info({:tcp_error, socket, _reason}, %{socket: socket} = state), do: {:stop, :normal, state}
  def handle_info(:timeout, %{socket: nil} = state), do: {:stop, :normal, state}
  def handle_info(_stray, state), do: {:noreply, state}

  @impl GenServer
  def terminate(_reason, %{socket: nil}), do: :ok
  # Closing would else wait for what a program that does not read will never take.
  def terminate(_reason, state), do: Net.tcp_close(state.socket)

  defp write(%{timer: timer} = state) when timer != nil, do: {:noreply, state}

  defp write(state) do
    case Connection.take(state.pipe) do
      {[], _pipe} ->
        {:noreply, %{state | wrote: now()}}

      {frames, pipe} ->
        case Net.tcp_write(state.socket, Enum.map(frames, &LengthPrefix.wrap/1)) do
          :ok -> write(%{state | pipe: pipe, wrote: now()})
          :busy -> wait(state)
          {:error, _gone} -> {:stop, :normal, state}
        end
    end
  end

  # The pipe still has what was not written.
  defp wait(state) do
    if now() - state.wrote > @patience_ms,
      do: leave(state, :stalled),
      else: {:noreply, %{state | timer: Process.send_after(self(), :again, @again_ms)}}
  end

  defp leave(state, why) do
    Store.count(state.gateway, {:clients, :mavlink, why})
    {:stop, :normal, state}
  end

  defp now, do: System.monotonic_time(:millisecond)
end
