defmodule Aerie.Fleet.Stations do
  @moduledoc """
  Everything on a network that sends heartbeats and is no vehicle: ground stations, on-board computers, trackers. A table of
  the store, written by the router (`hear/3`) for heartbeats of links and of clients alike, read once a second by the
  vehicles' sessions: a vehicle hears what is on its network, so these are the ones that may keep its failsafe quiet (H5).

  At most #{1_024} are kept; one that was not heard for ten minutes makes room for a new one.
  """

  alias Aerie.Fleet.Store
  alias Aerie.Names

  @max_stations 1_024
  @forget_us 600_000_000

  @typedoc """
  - `type`: MAV_TYPE of its heartbeat (6: a ground station)
  - `via`: the link or client endpoint that it was heard by
  - `last_heard`: unix microseconds
  """
  @type station :: %{
          system: non_neg_integer(),
          component: 0..255,
          type: 0..255,
          via: term(),
          last_heard: integer()
        }

  @doc "Notes a heartbeat. `:ok` also when it could not be kept; that is counted as `{:stations, :dropped}`."
  @spec hear(Names.gateway(), network :: String.t(), station()) :: :ok
  def hear(gateway, network, %{system: system, component: component} = station) do
    table = Store.table!(gateway, :stations)
    key = {network, system, component}

    if :ets.member(table, key) or room?(table, station.last_heard) do
      true = :ets.insert(table, {key, station.last_heard, station})
      :ok
    else
      Store.count(gateway, {:stations, :dropped})
      :ok
    end
  end

  defp room?(table, now) do
    :ets.info(table, :size) < @max_stations or
      :ets.select_delete(table, [{{:_, :"$1", :_}, [{:<, :"$1", now - @forget_us}], [true]}]) > 0
  end

  @doc "The stations of a network."
  @spec list(Names.gateway(), network :: String.t()) :: [station()]
  def list(gateway, network) do
    Store.with_table(gateway, :stations, [], fn table ->
      :ets.select(table, [{{{network, :_, :_}, :_, :"$1"}, [], [:"$1"]}])
    end)
  end
end
