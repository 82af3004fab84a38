defmodule Aerie.Fleet.Client.StateClient do
  @moduledoc """
  One reader of `state.sock`. It writes the newest text and waits for the reader as long as that takes, with nothing
  queued meanwhile; a reader that reads nothing for half a minute is disconnected. What a reader sends is ignored.
  """
  use GenServer, restart: :temporary

  alias Aerie.Fleet.Client.StateFeed
  alias Aerie.Base.Store

  @patience_ms 30_000
  @chatter 65_536

  @doc "Options: `:gateway`."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options), do: GenServer.start_link(__MODULE__, Keyword.fetch!(options, :gateway))

  @impl GenServer
  def init(gateway) do
    Process.set_label({:state_client, gateway})
    # A connection that never comes must not leave a process behind.
    {:ok, %{gateway: gateway, socket: nil, reader: nil, heard: 0}, @patience_ms}
  end

  @impl GenServer
  def handle_info({:socket, socket}, %{socket: nil} = state) do
    options = [active: :once, send_timeout: @patience_ms, send_timeout_close: true]

    case :inet.setopts(socket, options) do
      :ok -> {:noreply, %{state | socket: socket, reader: StateFeed.join(state.gateway)}}
      {:error, _gone} -> {:stop, :normal, state}
    end
  end

  def handle_info(:state_lines, state) do
    case StateFeed.latest(state.reader) do
      empty when empty in [nil, ""] -> {:noreply, state}
      lines -> write(state, lines)
    end
  end

  def handle_info({:tcp, socket, bytes}, %{socket: socket} = state) do
    heard = state.heard + byte_size(bytes)
    _ = :inet.setopts(socket, active: :once)
    if heard > @chatter, do: leave(state, :chatter), else: {:noreply, %{state | heard: heard}}
  end

  def handle_info({:tcp_closed, socket}, %{socket: socket} = state), do: {:stop, :normal, state}
  def handle_info({:tcp_error, socket, _reason}, %{socket: socket} = state), do: {:stop, :normal, state}
  def handle_info(:timeout, %{socket: nil} = state), do: {:stop, :normal, state}
  def handle_info(_stray, state), do: {:noreply, state}

  defp write(state, lines) do
    case :gen_tcp.send(state.socket, lines) do
      :ok -> {:noreply, state}
      {:error, :timeout} -> leave(state, :stalled)
      {:error, _gone} -> {:stop, :normal, state}
    end
  end

  defp leave(state, why) do
    Store.count(state.gateway, {:clients, :state, why})
    {:stop, :normal, state}
  end
end
