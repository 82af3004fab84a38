defmodule Aerie.Vehicle.Session do
  @moduledoc """
  The process of one vehicle: takes its frames and carries out what `Aerie.Vehicle.Core` says.

  Who has frames of the vehicle sends `{:frames, link_id, [frame]}`, one message per read of a link.
  """
  use GenServer

  alias Aerie.{Fleet, Names, Vehicle}

  @tick_ms 100

  @spec start_link(gateway: Names.gateway(), options: Vehicle.Options.t()) :: GenServer.on_start()
  def start_link(arguments) do
    name = Names.via(arguments[:gateway], :session, arguments[:options].key)
    GenServer.start_link(__MODULE__, arguments, name: name)
  end

  @impl GenServer
  def init(gateway: gateway, options: options) do
    Process.set_label({:session, options.id})
    core = Vehicle.Core.new(options, Fleet.Store.vehicle(gateway, options.key))
    :timer.send_interval(@tick_ms, :tick)
    {:ok, %{gateway: gateway, key: options.key, core: core, clock: nil}}
  end

  @impl GenServer
  def handle_info({:frames, _link, []}, state), do: {:noreply, state}

  def handle_info({:frames, link, frames}, state) do
    clock = {List.last(frames).at, now()}
    {:noreply, step(%{state | clock: clock}, {:frames, link, frames})}
  end

  # Nothing heard yet: there is no time to go by.
  def handle_info(:tick, %{clock: nil} = state), do: {:noreply, state}

  def handle_info(:tick, %{clock: {at, heard}} = state),
    do: {:noreply, step(state, {:tick, at + now() - heard})}

  defp step(state, event) do
    {core, actions} = Vehicle.Core.handle(state.core, event)
    Enum.each(actions, &act(state, &1))
    %{state | core: core}
  end

  defp act(state, {:snapshot, snapshot}), do: Fleet.Store.put_vehicle(state.gateway, state.key, snapshot)

  defp now, do: System.monotonic_time(:microsecond)
end
