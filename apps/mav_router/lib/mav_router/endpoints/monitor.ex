defmodule MavRouter.Endpoints.Monitor do
  @moduledoc """
  Monitors the processes that have endpoints, and removes the endpoints of those that end without doing so themselves. After a
  restart it monitors all of them again.
  """
  use GenServer

  alias Aerie.Base.Names
  alias MavRouter.Endpoints
  alias MavRouter.Tables

  @spec start_link(gateway: Names.gateway()) :: GenServer.on_start()
  def start_link(options) do
    gateway = Keyword.fetch!(options, :gateway)
    GenServer.start_link(__MODULE__, gateway, name: Names.via(gateway, :endpoint_monitor))
  end

  @doc "Monitors a process from now on."
  @spec monitor(Names.gateway(), pid) :: :ok
  def monitor(gateway, pid) do
    with monitor when is_pid(monitor) <- Names.whereis(gateway, :endpoint_monitor),
         do: send(monitor, {:monitor, pid})

    :ok
  end

  @impl GenServer
  def init(gateway) do
    Process.set_label({:endpoint_monitor, gateway})
    tables = Tables.of(gateway)

    {:ok,
     tables
     |> Endpoints.list()
     |> Enum.map(& &1.pid)
     |> Enum.reduce(%{gateway: gateway, pids: %{}}, &monitored/2)}
  end

  @impl GenServer
  def handle_info({:monitor, pid}, state), do: {:noreply, monitored(pid, state)}

  def handle_info({:DOWN, _ref, :process, pid, _reason}, state) do
    with tables when is_map(tables) <- Tables.of(state.gateway), do: Endpoints.down(tables, pid)
    {:noreply, %{state | pids: Map.delete(state.pids, pid)}}
  end

  defp monitored(pid, %{pids: pids} = state) when is_map_key(pids, pid), do: state
  defp monitored(pid, state), do: %{state | pids: Map.put(state.pids, pid, Process.monitor(pid))}
end
