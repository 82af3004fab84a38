defmodule MavRouter.Router.AutoSystemId do
  @window_ms 3_000

  @moduledoc """
  The system id of a gateway on board that is configured with `mavlink.system_id: auto` (R11): that of the autopilot, if exactly one
  is heard within #{div(@window_ms, 1_000)} s of the first heartbeat.

  Until then the gateway has no id: it lets no vehicle in and sends nothing of its own, while clients and vehicles hear each other
  as always. If several autopilots are heard it belongs to none of them, takes the id of a hub, and says so in the log and as
  telemetry. The decision holds until the gateway ends, whichever of its parts restart (`MavRouter.Identity` keeps it).

  Telemetry: `[:aerie, :identity, :latched]` with `gateway`, `system`, `heard` (the keys of the autopilots).
  """

  alias Aerie.Base.Store
  alias MavRouter.Identity
  alias Aerie.Base.Names
  alias MavRouter.Tables
  alias MavRouter.Signing

  require Logger

  @max_heard 16

  @doc "The router's settings of its own ids: `own: ids`, or `auto_component:`, the one that is known of them."
  @spec settings(Identity.Settings.t(), Names.gateway()) :: keyword
  def settings(identity, gateway) do
    case Identity.ids(identity, gateway) do
      {:auto, component} -> [own: nil, auto_component: component]
      ids -> [own: ids]
    end
  end

  @doc "Whether an autopilot that is heard may have a session at `now` (monotonic ms)."
  @spec open?(Names.gateway(), Tables.t(), Store.vehicle_key(), integer) :: boolean
  def open?(gateway, tables, key, now) do
    case Tables.setting(tables, :auto_component, nil) do
      nil -> true
      component -> note_heard(gateway, tables, key, component, now)
    end
  end

  defp note_heard(gateway, tables, key, component, now) do
    before = autopilots(tables)
    if length(before) < @max_heard, do: :ets.insert_new(tables.settings, {{:autopilot, key}, now})
    first = tables |> autopilots() |> Enum.map(&elem(&1, 1)) |> Enum.min()

    if now - first < @window_ms do
      false
    else
      decide(
        gateway,
        tables,
        for({key, at} <- autopilots(tables), at - first < @window_ms, do: key),
        component
      )

      true
    end
  end

  defp autopilots(tables),
    do: :ets.select(tables.settings, [{{{:autopilot, :"$1"}, :"$2"}, [], [{{:"$1", :"$2"}}]}])

  # Two links may decide at the same moment; their decision is the same.
  defp decide(gateway, tables, keys, component) do
    system = system(keys)
    Identity.remember(gateway, system)
    Signing.identify(gateway, {system, component})
    :ets.insert(tables.settings, {:own, {system, component}})

    if :ets.take(tables.settings, :auto_component) != [] do
      Tables.changed(tables)
      :ets.match_delete(tables.settings, {{:autopilot, :_}, :_})
      notify(gateway, system, Enum.sort(keys))
    end
  end

  # The system id for these autopilots: theirs if it is one, a hub's otherwise.
  defp system([{_network, system}]), do: system
  defp system(_several), do: elem(Identity.default_ids(), 0)

  defp notify(gateway, system, keys) do
    case keys do
      [_one] -> Logger.info("this gateway belongs to system #{system}")
      several -> Logger.error(text(several))
    end

    :telemetry.execute([:aerie, :identity, :latched], %{}, %{gateway: gateway, system: system, heard: keys})
  end

  defp text(keys) do
    ids = Enum.map_join(keys, ", ", fn {network, system} -> "#{system} on #{network}" end)

    "mavlink.system_id is auto, and several autopilots are heard (#{ids}): this gateway belongs to none of them and takes system id " <>
      "#{system(keys)}. Set mavlink.system_id."
  end
end
