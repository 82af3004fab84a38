defmodule FleetWeb.WebSocket.Places do
  @moduledoc """
  Limits the number of WebSocket clients. A place is taken before a handshake is answered and becomes free when its
  connection ends for any reason. One process hands them out, so that simultaneous handshakes cannot exceed the limit.
  """
  use GenServer

  alias Aerie.Names

  @doc "Options: `:gateway`, `:most` (the number of places)."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options) do
    name = Names.via(Keyword.fetch!(options, :gateway), :websocket_places)
    GenServer.start_link(__MODULE__, options, name: name)
  end

  @doc "Takes a place for a connection's process; a process that has one keeps it."
  @spec take(Names.gateway(), pid()) :: :ok | :full | :unavailable
  def take(gateway, connection) do
    GenServer.call(Names.via(gateway, :websocket_places), {:take, connection})
  catch
    # This process is restarting.
    :exit, _reason -> :unavailable
  end

  @impl GenServer
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    Process.set_label({:websocket_places, gateway})
    # After a restart of this process, its predecessor's connections still have their places.
    connections = Names.processes(gateway, :websocket_client)
    {:ok, %{most: Keyword.fetch!(options, :most), taken: Map.new(connections, &{&1, Process.monitor(&1)})}}
  end

  @impl GenServer
  def handle_call({:take, connection}, _from, %{taken: taken} = state) do
    cond do
      is_map_key(taken, connection) -> {:reply, :ok, state}
      map_size(taken) >= state.most -> {:reply, :full, state}
      true -> {:reply, :ok, put_in(state.taken[connection], Process.monitor(connection))}
    end
  end

  @impl GenServer
  def handle_info({:DOWN, _monitor, :process, connection, _reason}, state),
    do: {:noreply, %{state | taken: Map.delete(state.taken, connection)}}

  def handle_info(_stray, state), do: {:noreply, state}
end
