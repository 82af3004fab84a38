defmodule Aerie.Vehicle.Events.External do
  @moduledoc "Events of a vehicle that other parts of the gateway detect, such as `Aerie.Signing`."
  @behaviour Aerie.Signing.Events

  alias Aerie.Fleet.Journal
  alias Aerie.Names
  alias Aerie.Signing
  alias Aerie.Store
  alias Aerie.Vehicle.Detector.Observation
  alias Aerie.Vehicle.Events

  @impl Signing.Events
  def event(gateway, key, type, data, at) do
    with %{id: id} <- Store.vehicle(gateway, key),
         events when is_pid(events) <- Names.whereis(gateway, :events, key) do
      observation = Observation.new(:external, at, nil, %{type: type, data: data})
      _full = Journal.offer(gateway, id, observation)
      Events.wake(events)
      :ok
    else
      _unknown -> :ok
    end
  end
end
