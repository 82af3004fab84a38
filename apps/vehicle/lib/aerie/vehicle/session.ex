defmodule Aerie.Vehicle.Session do
  @moduledoc """
  The process of one vehicle: takes its frames and carries out what `Aerie.Vehicle.Core` says.

  Who has frames of the vehicle sends `{:frames, link_id, [frame]}`, one message per read of a link.

  The time between frames is the time of the last one plus what has passed since by the monotonic clock; so a vehicle is
  missed after the same silence whether its frames come from a radio or from a recording, and setting the machine's clock
  loses nobody.
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
    snapshot = Fleet.Store.vehicle(gateway, options.key)
    {:ok, _timer} = :timer.send_interval(@tick_ms, :tick)

    state = %{
      gateway: gateway,
      options: options,
      core: Vehicle.Core.new(options, snapshot),
      # {a frame's time, when it was that time}
      clock: snapshot && {snapshot.last_heard, monotonic()},
      outbound: Vehicle.Outbound.new(gateway, options),
      events: nil
    }

    {:ok, state}
  end

  @impl GenServer
  def handle_info({:frames, _link, []}, state), do: {:noreply, state}

  def handle_info({:frames, link, frames}, state) do
    clock = {List.last(frames).at, monotonic()}
    {:noreply, step(%{state | clock: clock}, {:frames, link, frames})}
  end

  # Nothing heard yet: there is no time to go by.
  def handle_info(:tick, %{clock: nil} = state), do: {:noreply, state}

  def handle_info(:tick, %{clock: {at, then}} = state),
    do: {:noreply, step(state, {:tick, at + monotonic() - then})}

  defp step(state, event) do
    {core, actions} = Vehicle.Core.handle(state.core, event)
    state = Enum.reduce(actions, %{state | core: core}, &act/2)
    wake(state, actions)
  end

  defp act({:snapshot, snapshot}, state) do
    Fleet.Store.put_vehicle(state.gateway, state.options.key, snapshot)
    state
  end

  defp act({:observe, observation}, state) do
    _dropped_and_counted_when_full = Fleet.Journal.offer(state.gateway, state.options.id, observation)
    state
  end

  defp act({:publish, group, sample, at}, state) do
    Vehicle.Outbound.publish(state.outbound, group, sample, at)
    state
  end

  defp act({:send, message, version}, state) do
    %{state | outbound: Vehicle.Outbound.send(state.outbound, message, version)}
  end

  defp act({:heartbeat, version}, state) do
    %{state | outbound: Vehicle.Outbound.heartbeat(state.outbound, version)}
  end

  defp act({:count, counter}, state) do
    Fleet.Store.count(state.gateway, {:vehicle, state.options.id, counter})
    state
  end

  defp act({:status, old, new}, state) do
    metadata = %{gateway: state.gateway, vehicle: state.options.id, old: old, new: new}
    :telemetry.execute([:aerie, :vehicle, :status], %{count: 1}, metadata)
    state
  end

  defp wake(state, actions) do
    if Enum.any?(actions, &match?({:observe, _observation}, &1)) do
      # Both restart together, so the one found first stays the right one.
      events = state.events || Names.whereis(state.gateway, :events, state.options.key)
      if events, do: Vehicle.Events.wake(events)
      %{state | events: events}
    else
      state
    end
  end

  defp monotonic, do: System.monotonic_time(:microsecond)
end
