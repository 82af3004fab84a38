defmodule Aerie.Router.Watch do
  @moduledoc """
  Watches the processes that have endpoints and removes the endpoints of those that ended without doing it themselves.
  When this process dies, its successor watches all of them anew.
  """
  use GenServer

  alias Aerie.Successor
  alias Aerie.Names
  alias Aerie.Router.Endpoints
  alias Aerie.Router.Tables

  @spec start_link(gateway: Names.gateway()) :: GenServer.on_start()
  def start_link(options) do
    gateway = Keyword.fetch!(options, :gateway)
    name = Names.via(gateway, :router_watch)
    Successor.start(fn -> GenServer.start_link(__MODULE__, gateway, name: name) end)
  end

  @doc "Watches a process from now on."
  @spec process(Names.gateway(), pid) :: :ok
  def process(gateway, pid) do
    with watch when is_pid(watch) <- Names.whereis(gateway, :router_watch), do: send(watch, {:watch, pid})
    :ok
  end

  @impl GenServer
  def init(gateway) do
    Process.set_label({:router_watch, gateway})
    tables = Tables.of(gateway)

    {:ok,
     tables |> Endpoints.list() |> Enum.map(& &1.pid) |> Enum.reduce(%{gateway: gateway, pids: %{}}, &watch/2)}
  end

  @impl GenServer
  def handle_info({:watch, pid}, state), do: {:noreply, watch(pid, state)}

  def handle_info({:DOWN, _ref, :process, pid, _reason}, state) do
    with tables when is_map(tables) <- Tables.of(state.gateway), do: Endpoints.down(tables, pid)
    {:noreply, %{state | pids: Map.delete(state.pids, pid)}}
  end

  defp watch(pid, %{pids: pids} = state) when is_map_key(pids, pid), do: state
  defp watch(pid, state), do: %{state | pids: Map.put(state.pids, pid, Process.monitor(pid))}
end
