defmodule Aerie.Fleet.Bridge.State.LastPublished.Late do
  @moduledoc """
  Hands what was published before the restart to detectors that are running already, because the file could not be read
  when they started. A change that was published since the start is not published again as found.
  """

  alias Aerie.Base.{Names, Store}
  alias Aerie.Vehicle.Journal
  alias Aerie.Vehicle.Detector.Observation
  alias Aerie.Vehicle.Events

  @keys %{
    "mode_change" => :mode,
    "armed" => :armed,
    "disarmed" => :armed,
    "takeoff" => :in_air,
    "landed" => :in_air
  }

  @doc "`found` goes to the vehicles that are here, and to those that are heard from now on. `now` in unix us."
  @spec notify(Names.gateway(), %{String.t() => map()}, integer()) :: :ok
  def notify(gateway, found, now) do
    here = Enum.filter(found, fn {id, _known} -> Journal.state(gateway, id) != nil end)
    Names.put_value(gateway, :bridge_last_published, found)
    Enum.each(here, fn {id, known} -> offer(gateway, id, known, now) end)

    for %{key: key} <- Store.vehicles(gateway),
        events when is_pid(events) <- [Names.whereis(gateway, :events, key)],
        do: Events.wake(events)

    :ok
  end

  defp offer(gateway, id, known, now) do
    published = for event <- Journal.recent(gateway, id), key = @keys[event.type], do: key
    observation = Observation.new(:published, now, nil, Map.drop(known, published))
    _full = Journal.offer(gateway, id, observation)
  end
end
