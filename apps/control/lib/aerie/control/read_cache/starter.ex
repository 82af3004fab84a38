defmodule Aerie.Control.ReadCache.Starter do
  @moduledoc "Starts `Aerie.Control.ReadCache.Vehicle` when a vehicle appears, and stops it when the vehicle is forgotten."
  use GenServer

  alias Aerie.Base.{Names, Store}
  alias Aerie.Control.ReadCache
  alias Aerie.Base.PubSub

  @again_ms 1_000

  @spec start_link(gateway: Names.gateway()) :: GenServer.on_start()
  def start_link(options),
    do:
      GenServer.start_link(__MODULE__, options[:gateway],
        name: Names.via(options[:gateway], :read_cache_starter)
      )

  @impl GenServer
  def init(gateway) do
    Process.set_label({:read_cache_starter, gateway})
    :ok = PubSub.subscribe(gateway, :roster)
    {:ok, Enum.reduce(Store.vehicles(gateway), %{gateway: gateway, keys: %{}}, &start_if_needed(&2, &1.id))}
  end

  @impl GenServer
  def handle_info({:fleet, :roster, id}, state), do: {:noreply, start_if_needed(state, id)}
  def handle_info(_other, state), do: {:noreply, state}

  defp start_if_needed(state, id) do
    case {Store.vehicle(state.gateway, id), state.keys} do
      {%{key: key}, keys} when not is_map_key(keys, id) ->
        started =
          DynamicSupervisor.start_child(
            supervisor(state),
            {ReadCache.Vehicle, gateway: state.gateway, key: key}
          )

        if match?({:ok, _pid}, started), do: put_in(state.keys[id], key), else: again(state, id)

      {nil, %{^id => key}} ->
        _ =
          with pid when pid != nil <- Names.whereis(state.gateway, :read_cache, key),
               do: DynamicSupervisor.terminate_child(supervisor(state), pid)

        %{state | keys: Map.delete(state.keys, id)}

      _as_it_was ->
        state
    end
  end

  defp again(state, id) do
    Process.send_after(self(), {:fleet, :roster, id}, @again_ms)
    state
  end

  defp supervisor(state), do: Names.via(state.gateway, :read_cache_vehicles)
end
