defmodule Aerie.Api.WebSocket.Capacity do
  @moduledoc """
  Limits the number of WebSocket clients. A connection reserves its place before its handshake is answered, and the place is
  free again when the connection ends for any reason. One process counts them, so that simultaneous handshakes cannot exceed
  the limit.
  """
  use GenServer

  alias Aerie.Base.Names

  @doc "Options: `:gateway`, `:max_clients`."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options) do
    name = Names.via(Keyword.fetch!(options, :gateway), :websocket_capacity)
    GenServer.start_link(__MODULE__, options, name: name)
  end

  @doc "Reserves a place for a connection's process; a process that has one keeps it."
  @spec reserve(Names.gateway(), pid()) :: :ok | :full | :unavailable
  def reserve(gateway, connection) do
    GenServer.call(Names.via(gateway, :websocket_capacity), {:reserve, connection})
  catch
    # This process is restarting.
    :exit, _reason -> :unavailable
  end

  @impl GenServer
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    Process.set_label({:websocket_capacity, gateway})
    # After a restart of this process, its predecessor's connections still have their places.
    connections = Names.processes(gateway, :websocket_client)

    {:ok,
     %{
       max_clients: Keyword.fetch!(options, :max_clients),
       reserved: Map.new(connections, &{&1, Process.monitor(&1)})
     }}
  end

  @impl GenServer
  def handle_call({:reserve, connection}, _from, %{reserved: reserved} = state) do
    cond do
      is_map_key(reserved, connection) -> {:reply, :ok, state}
      map_size(reserved) >= state.max_clients -> {:reply, :full, state}
      true -> {:reply, :ok, put_in(state.reserved[connection], Process.monitor(connection))}
    end
  end

  @impl GenServer
  def handle_info({:DOWN, _monitor, :process, connection, _reason}, state),
    do: {:noreply, %{state | reserved: Map.delete(state.reserved, connection)}}

  def handle_info(_stray, state), do: {:noreply, state}
end
