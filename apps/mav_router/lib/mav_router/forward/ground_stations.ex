defmodule MavRouter.Forward.GroundStations do
  @max_stations 1_024
  @forget_us 600_000_000

  @moduledoc """
  Everything on a network that sends heartbeats and is not a vehicle: ground stations, on-board computers, trackers. The router writes
  them into a table of the store (`hear/3`), for heartbeats of links and of clients; the vehicles' sessions read it once a second,
  since what a vehicle hears on its network may keep its failsafe from triggering (H5).

  At most #{@max_stations} are kept; one that was not heard for #{div(@forget_us, 60_000_000)} minutes makes room for a new one. When
  the machine's clock is set, a station that was heard live stays as old as it was (`Aerie.Base.Timing.HostClock`).

  The session of a vehicle reads which system ids the vehicle takes for its station's, and notes them here
  (`obeyed/3`): another vehicle's heartbeat with such an id does not reach it, or its failsafe would stay quiet.
  """

  alias Aerie.Base.Timing.HostClock
  alias Aerie.Base.Store
  alias Aerie.Base.Names
  alias MavRouter.Tables

  # A frame that came by a live link has a time close to now.
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

  @doc "Notes a heartbeat; one without a time came now. One that cannot be kept is counted as `{:stations, :dropped}`."
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

  # The session notes them once a second.
  @told_ms 60_000
  @any_id 0xFFFFFFFF

  @doc """
  The system ids that a vehicle's failsafe takes for its station's; `:unknown`: it takes some, and nobody knows
  which; nil: no id is known to count.
  """
  @spec obeyed(Names.gateway(), vehicle, {integer(), integer()} | :unknown | nil) :: :ok
        when vehicle: {network :: String.t(), system :: non_neg_integer()}
  def obeyed(gateway, vehicle, ids) do
    with %{} = tables <- Tables.of(gateway), do: note(tables, vehicle, ids)
    :ok
  end

  defp note(%{obeyed: table}, vehicle, nil), do: :ets.delete(table, vehicle)
  defp note(tables, vehicle, :unknown), do: note(tables, vehicle, {0, @any_id})

  defp note(%{obeyed: table} = tables, vehicle, {low, high}) do
    before = :ets.lookup(table, vehicle)
    true = :ets.insert(table, {vehicle, low, high, System.monotonic_time(:millisecond)})
    if not match?([{_vehicle, ^low, ^high, _at}], before), do: Tables.rerouted(tables)
  end

  @doc "The vehicles of these networks that take a system for their station, itself left out."
  @spec obeyed_by(Tables.t(), networks :: [String.t()], system :: non_neg_integer()) ::
          [{network :: String.t(), system :: non_neg_integer()}]
  def obeyed_by(%{obeyed: table}, networks, system) do
    within = [{:"=<", :"$3", system}, {:>=, :"$4", system}, {:"=/=", :"$2", system}]
    found = :ets.select(table, [{{{:"$1", :"$2"}, :"$3", :"$4", :_}, within, [{{:"$1", :"$2"}}]}])
    for {network, _system} = vehicle <- found, network in networks, do: vehicle
  end

  @doc "Whether a vehicle takes a system, which is not its own, for its station."
  @spec obeys?(Tables.t(), vehicle, non_neg_integer()) :: boolean()
        when vehicle: {network :: String.t(), system :: non_neg_integer()}
  def obeys?(%{obeyed: table}, {_network, own} = vehicle, system) do
    case :ets.lookup(table, vehicle) do
      [{_vehicle, low, high, _at}] -> system != own and low <= system and system <= high
      [] -> false
    end
  end

  @doc "Forgets vehicles of which nobody has told anything for a minute: they have no session any more."
  @spec sweep(Tables.t(), now :: integer()) :: non_neg_integer()
  def sweep(%{obeyed: table}, now),
    do: :ets.select_delete(table, [{{:_, :_, :_, :"$1"}, [{:<, :"$1", now - @told_ms}], [true]}])

  @doc "How many stations are kept."
  @spec max() :: pos_integer()
  def max, do: @max_stations

  @doc "How long a station is silent before another one may take its place, in microseconds."
  @spec forget_us() :: pos_integer()
  def forget_us, do: @forget_us

  # The offset of the clocks when it was heard; nil for a time that is not this machine's.
  defp live(at) do
    now = System.os_time(:microsecond)
    if abs(now - at) < @live_us, do: now - System.monotonic_time(:microsecond)
  end

  # A time far in the future is from before the clock was set back.
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

    of_network = [{{{network, :_, :_}, :_, :"$1", :"$2"}, [], [{{:"$1", :"$2"}}]}]

    for {live, station} <- Store.with_table(gateway, :stations, [], &:ets.select(&1, of_network)),
        do: moved(station, live, offset)
  end

  defp moved(station, nil, _offset), do: station

  defp moved(station, live, offset),
    do: %{station | last_heard: station.last_heard + HostClock.step(live, offset)}
end
