defmodule Aerie.Vehicle.Events.External do
  @moduledoc "Events of a vehicle that other parts of the gateway detect, such as `MavRouter.Signing`."
  @behaviour MavRouter.Signing.Events

  alias Aerie.Vehicle.Events.Journal
  alias Aerie.Base.Names
  alias MavRouter.Signing
  alias Aerie.Base.Store
  alias Aerie.Vehicle.Events.Detector.Observation
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
