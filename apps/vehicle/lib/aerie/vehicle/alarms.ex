defmodule Aerie.Vehicle.Alarms do
  @moduledoc "What other parts of the gateway find out about a vehicle, as events of that vehicle."
  @behaviour Aerie.Signing.Events

  alias Aerie.Fleet.Journal
  alias Aerie.Names
  alias Aerie.Signing
  alias Aerie.Store
  alias Aerie.Vehicle.Events

  @impl Signing.Events
  def event(gateway, key, type, data, at) do
    with %{id: id} <- Store.vehicle(gateway, key),
         events when is_pid(events) <- Names.whereis(gateway, :events, key) do
      _full = Journal.offer(gateway, id, {:alarm, at, nil, type, data})
      Events.wake(events)
      :ok
    else
      _unknown -> :ok
    end
  end
end
