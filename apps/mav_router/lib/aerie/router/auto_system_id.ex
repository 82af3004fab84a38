defmodule Aerie.Router.AutoSystemId do
  @moduledoc """
  Whose system id a gateway aboard takes when it is given none (`mavlink.system_id: auto`, R11): that of the autopilot, if
  exactly one is heard within three seconds of its first heartbeat.

  Until then nobody knows who we are: no vehicle is let in and nothing of ours is sent, while clients and vehicles hear each
  other as always. Two autopilots, and the gateway is none's: it takes the hub's id and says so in the log and as
  telemetry. What was decided holds until the gateway ends, whatever of it is restarted (`Aerie.Identity` keeps it).

  Telemetry: `[:aerie, :identity, :latched]` with `gateway`, `system`, `heard` (the keys of the autopilots).
  """

  alias Aerie.Store
  alias Aerie.Identity
  alias Aerie.Names
  alias Aerie.Router.Tables
  alias Aerie.Signing

  require Logger

  @window_ms 3_000
  @max_heard 16

  @doc "What the router knows of its own ids when it starts: `own: ids`, or that they are to be found out."
  @spec settings(term, Names.gateway()) :: keyword
  def settings(config, gateway) do
    case Identity.resolve(config, gateway) do
      %{mavlink: %{system_id: :auto, component_id: component}} -> [own: nil, latch: component]
      %{mavlink: %{system_id: system, component_id: component}} -> [own: {system, component}]
      _none -> [own: nil]
    end
  end

  @doc "An autopilot is heard that has no session yet: whether it may have one now. `now` is monotonic ms."
  @spec open?(Names.gateway(), Tables.t(), Store.vehicle_key(), integer) :: boolean
  def open?(gateway, tables, key, now) do
    case Tables.setting(tables, :latch, nil) do
      nil -> true
      component -> heard(gateway, tables, key, component, now)
    end
  end

  defp heard(gateway, tables, key, component, now) do
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

  # Two links may come to this at the same moment; they come to the same.
  defp decide(gateway, tables, keys, component) do
    system = system(keys)
    Identity.remember(gateway, system)
    Signing.identify(gateway, {system, component})
    :ets.insert(tables.settings, {:own, {system, component}})

    if :ets.take(tables.settings, :latch) != [] do
      Tables.changed(tables)
      :ets.match_delete(tables.settings, {{:autopilot, :_}, :_})
      tell(gateway, system, Enum.sort(keys))
    end
  end

  @doc "The id that is taken when these autopilots are heard: theirs if it is one, else a hub's."
  @spec system([Store.vehicle_key()]) :: pos_integer
  def system([{_network, system}]), do: system
  def system(_several), do: elem(Identity.default_ids(), 0)

  defp tell(gateway, system, keys) do
    case keys do
      [_one] -> Logger.info("this gateway is a part of system #{system}")
      several -> Logger.error(words(several))
    end

    :telemetry.execute([:aerie, :identity, :latched], %{}, %{gateway: gateway, system: system, heard: keys})
  end

  defp words(keys) do
    ids = Enum.map_join(keys, ", ", fn {network, system} -> "#{system} on #{network}" end)

    "mavlink.system_id is auto, and autopilots #{ids} are heard: this gateway belongs to none of them and is system #{system(keys)}. " <>
      "Give mavlink.system_id."
  end
end
