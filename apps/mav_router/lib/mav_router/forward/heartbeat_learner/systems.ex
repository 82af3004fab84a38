defmodule MavRouter.Forward.HeartbeatLearner.Systems do
  @moduledoc """
  Everything that sends heartbeats: vehicles, ground stations, radios, gimbals; kept in `Aerie.Base.Store.systems/1` under
  `{network, system}` as

      %{last_heard: us, vehicle: boolean, components: %{component => %{role, type, autopilot, link, last_heard}}}

  Two links that hear one system at the same moment may overwrite each other's note of a component; the next heartbeat corrects that.
  """

  alias MavRouter.Forward.GroundStations
  alias Aerie.Base.Store
  alias Aerie.Base.Names
  alias MavCodec.Meaning.Heartbeat
  alias MavCodec.Frame

  @max_components 64

  @doc "Notes a heartbeat heard by a link."
  @spec note(Names.gateway(), String.t(), String.t(), Frame.t(), Heartbeat.t()) :: :ok | {:error, :too_many}
  def note(gateway, network, link, frame, heartbeat) do
    key = {network, frame.system}
    before = Store.system(gateway, key) || %{components: %{}, vehicle: false}

    component = %{
      role: Heartbeat.role(heartbeat),
      type: heartbeat.type,
      autopilot: heartbeat.autopilot,
      link: link,
      last_heard: frame.at
    }

    if not Heartbeat.vehicle?(heartbeat) do
      station = %{system: frame.system, component: frame.component, type: heartbeat.type}
      GroundStations.hear(gateway, network, Map.merge(station, %{via: link, last_heard: frame.at}))
    end

    Store.see_system(gateway, key, %{
      last_heard: frame.at,
      vehicle: before.vehicle or Heartbeat.vehicle?(heartbeat),
      components: put(before.components, frame.component, component)
    })
  end

  defp put(components, id, component)
       when is_map_key(components, id) or map_size(components) < @max_components do
    Map.put(components, id, component)
  end

  defp put(components, _id, _component), do: components
end
