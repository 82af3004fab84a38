defmodule Aerie.Router.Stations do
  @moduledoc """
  Everything on a network that sends heartbeats and is no vehicle: ground stations, on-board computers, trackers. A table of
  the store, written by the router (`hear/3`) for heartbeats of links and of clients alike, read once a second by the
  vehicles' sessions: a vehicle hears what is on its network, so these are the ones that may keep its failsafe quiet (H5).

  At most #{1_024} are kept; one that was not heard for ten minutes makes room for a new one. When the machine's clock is
  set, what was heard live was heard as long ago as before (`Aerie.HostClock`).
  """

  alias Aerie.Store
  alias Aerie.HostClock
  alias Aerie.Names

  @max_stations 1_024
  @forget_us 600_000_000
  # A frame that came by a live link has a time that is about now.
  @live_us 10_000_000

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

  @doc "Notes a heartbeat; one without a time came now. `:ok` also when it could not be kept; that is counted as `{:stations, :dropped}`."
  @spec hear(Names.gateway(), network :: String.t(), station()) :: :ok
  def hear(gateway, network, %{last_heard: nil} = station),
    do: hear(gateway, network, %{station | last_heard: System.os_time(:microsecond)})

  def hear(gateway, network, %{system: system, component: component} = station) do
    table = Store.table!(gateway, :stations)
    key = {network, system, component}

    if :ets.member(table, key) or room?(table, station.last_heard) do
      true = :ets.insert(table, {key, station.last_heard, live(station.last_heard), station})
      :ok
    else
      Store.count(gateway, {:stations, :dropped})
      :ok
    end
  end

  # The offset of the clocks under which it was heard; nil for a time that is not this machine's.
  defp live(at) do
    now = System.os_time(:microsecond)
    if abs(now - at) < @live_us, do: now - System.monotonic_time(:microsecond)
  end

  # One from long after is from before the clock was set back.
  defp room?(table, now) do
    :ets.info(table, :size) < @max_stations or
      :ets.select_delete(table, [
        {{:_, :"$1", :_, :_}, [{:<, :"$1", now - @forget_us}], [true]},
        {{:_, :"$1", :_, :_}, [{:>, :"$1", now + @forget_us}], [true]}
      ]) > 0
  end

  @doc "The stations of a network."
  @spec list(Names.gateway(), network :: String.t()) :: [station()]
  def list(gateway, network) do
    offset = HostClock.offset()

    Store.with_table(gateway, :stations, [], fn table ->
      for {live, station} <-
            :ets.select(table, [{{{network, :_, :_}, :_, :"$1", :"$2"}, [], [{{:"$1", :"$2"}}]}]),
          do: moved(station, live, offset)
    end)
  end

  defp moved(station, nil, _offset), do: station

  defp moved(station, live, offset),
    do: %{station | last_heard: station.last_heard + HostClock.step(live, offset)}
end
