defmodule Protocols.Mission.Responder do
  @moduledoc """
  Plans that ground stations read from the gateway, so that a vehicle is not read once per station. Pure:
  `handle(served, event) -> {served, actions}`.

  Only a plan that was read completely is served, and only until something shows that the vehicle may have another one:
  a write by anybody, a changed id or count (W7), another home if that is item 0, a reboot. A plan that may be out of date is
  read from the vehicle first; stations that request it meanwhile wait for that read.

  If a plan changes while a station reads it, the station's read is cancelled and it begins again: it never gets items of
  two plans.

  Events, with the time `now` in microseconds:

    * `{:station, message, source, now}` - a message of a ground station to the vehicle
    * `{:vehicle, message, now}` - a message of the vehicle, for any receiver
    * `{:read, type, result, now}` - the plan was read: a result of `Protocols.Mission.Transfer` with items
    * `{:unread, type, now}` - reading the plan failed
    * `{:written, type, now}` - the gateway knows of a write that the vehicle's messages may not have shown yet
    * `{:rebooted, now}`

  Actions:

    * `{:reply, message}` - to the station that is its target, in the vehicle's name
    * `{:forward, message, source}` - forward a station's message to the vehicle
    * `{:fetch, type}` - read the plan; `:read` or `:unread` follows
  """

  alias Protocols.Mission.{Item, Reply, Result}
  alias MavCodec.Messages, as: M

  @types 0..2
  @mission 0
  @all 255
  # For each type; beyond that, the station that was silent longest is forgotten.
  @max_stations 64
  # A station that requests nothing for this long has gone.
  @forgotten 30_000_000
  # Positions of home vary by about a decimetre.
  @near 10
  @near_m 0.5

  @enforce_keys [:protocol]
  defstruct [:protocol, plans: %{}, fetching: %{}, readers: %{}, changed: %{}, ids: %{}, version: 0]

  @typep station :: {0..255, 0..255}
  @type t :: %__MODULE__{
          protocol: module(),
          plans: %{
            (0..2) => %{
              items: tuple(),
              opaque_id: pos_integer() | nil,
              version: pos_integer(),
              read_at: integer(),
              total: integer() | nil
            }
          },
          fetching: %{(0..2) => %{station() => struct()}},
          readers: %{{0..2, station()} => {version :: pos_integer(), at :: integer()}},
          changed: %{(0..2) => integer()},
          version: non_neg_integer()
        }
  @type event ::
          {:station, struct(), station(), integer()}
          | {:vehicle, struct(), integer()}
          | {:read, 0..2, Result.t(), integer()}
          | {:unread | :written, 0..2, integer()}
          | {:rebooted, integer()}
  @type action :: {:reply, struct()} | {:forward, struct(), station()} | {:fetch, 0..2}

  @doc "The state before anything is known about the vehicle's plans."
  @spec new(module()) :: t()
  def new(protocol), do: %__MODULE__{protocol: protocol}

  @doc "Handles an event."
  @spec handle(t(), event()) :: {t(), [action()]}
  def handle(served, event)

  def handle(served, {:station, %M.MissionRequestList{mission_type: type} = m, from, now})
      when type in @types do
    case served.plans do
      %{^type => plan} ->
        {reading(served, type, from, plan.version, now), [{:reply, count(plan, type, from)}]}

      _not_fresh ->
        wait(served, type, m, from)
    end
  end

  def handle(served, {:station, %module{mission_type: type, seq: seq} = m, from, now})
      when module in [M.MissionRequestInt, M.MissionRequest] do
    key = {type, from}

    case served do
      %{readers: %{^key => {version, at}}, plans: %{^type => %{version: version} = plan}}
      when now - at < @forgotten ->
        {reading(served, type, from, version, now), [{:reply, item(plan, seq, type, from)}]}

      %{readers: %{^key => _old_plan}} ->
        {%{served | readers: Map.delete(served.readers, key)},
         [{:reply, Reply.ack(type, :OPERATION_CANCELLED, from)}]}

      _not_ours ->
        {served, [{:forward, m, from}]}
    end
  end

  # The end of a read that the vehicle did not see.
  def handle(served, {:station, %M.MissionAck{mission_type: type} = m, from, _now}) do
    if is_map_key(served.readers, {type, from}),
      do: {%{served | readers: Map.delete(served.readers, {type, from})}, []},
      else: {served, [{:forward, m, from}]}
  end

  # Messages that write a plan.
  def handle(served, {:station, %module{mission_type: type} = m, from, now})
      when module in [
             M.MissionCount,
             M.MissionItem,
             M.MissionItemInt,
             M.MissionClearAll,
             M.MissionWritePartialList
           ],
      do: {forget(served, type, now), [{:forward, m, from}]}

  def handle(served, {:station, message, from, _now}), do: {served, [{:forward, message, from}]}

  # A read that began before the plan changed may have the old plan.
  def handle(served, {:read, type, %Result{items: items, read_at: began} = result, now})
      when is_list(items) do
    if began >= Map.get(served.changed, type, began) and same_id?(served.ids[type], result.opaque_id, began),
      do: known_again(served, type, result, now),
      else: {served, if(is_map_key(served.fetching, type), do: [{:fetch, type}], else: [])}
  end

  # The vehicle itself has to answer.
  def handle(served, {:unread, type, _now}) do
    {waiting, fetching} = Map.pop(served.fetching, type, %{})
    {%{served | fetching: fetching}, for({from, message} <- waiting, do: {:forward, message, from})}
  end

  def handle(served, {:written, type, now}), do: {forget(served, type, now), []}
  def handle(served, {:rebooted, now}), do: {forget(served, @all, now), []}

  def handle(served, {:vehicle, %M.MissionCurrent{} = m, now}) do
    served =
      [{0, m.mission_id}, {1, m.fence_id}, {2, m.rally_points_id}]
      |> Enum.reduce(served, fn {type, id}, served -> known(served, type, id, now) end)

    {total(served, m.total, now), []}
  end

  # Somebody's upload or clearing was accepted. The vehicle says nothing here about a refused one or the end of a reading.
  def handle(served, {:vehicle, %M.MissionAck{type: 0, mission_type: type}, now}),
    do: {forget(served, type, now), []}

  def handle(served, {:vehicle, %M.MissionCount{mission_type: type} = m, now}) do
    case served.plans do
      %{^type => plan} when tuple_size(plan.items) != m.count -> {forget(served, type, now), []}
      # If the firmware has no ids, this count is unrelated to the one in MISSION_CURRENT.
      _same when m.opaque_id == 0 -> {served, []}
      _same -> {known(served, type, m.opaque_id, now), []}
    end
  end

  def handle(%{plans: %{@mission => %{items: items}}} = served, {:vehicle, %M.HomePosition{} = m, now})
      when tuple_size(items) > 0 do
    if served.protocol.home_is_item_0?() and not home?(elem(items, 0), m),
      do: {forget(served, @mission, now), []},
      else: {served, []}
  end

  def handle(served, {:vehicle, _other, _now}), do: {served, []}

  # --- Waiting for a read

  defp known_again(served, type, result, now) do
    version = served.version + 1
    known = Map.take(result, [:opaque_id, :read_at])
    plan = Map.merge(known, %{items: List.to_tuple(result.items), version: version, total: nil})
    {waiting, fetching} = Map.pop(served.fetching, type, %{})
    served = %{served | plans: Map.put(served.plans, type, plan), fetching: fetching, version: version}

    Enum.reduce(waiting, {served, []}, fn {from, _message}, {served, replies} ->
      {reading(served, type, from, version, now), [{:reply, count(plan, type, from)} | replies]}
    end)
  end

  defp wait(served, type, message, from) do
    waiting = Map.get(served.fetching, type, %{})

    cond do
      map_size(waiting) >= @max_stations and not is_map_key(waiting, from) ->
        {served, [{:forward, message, from}]}

      waiting == %{} ->
        {put_in(served.fetching[type], %{from => message}), [{:fetch, type}]}

      true ->
        {put_in(served.fetching[type], Map.put(waiting, from, message)), []}
    end
  end

  defp reading(served, type, from, version, now) do
    %{served | readers: served.readers |> Map.put({type, from}, {version, now}) |> bounded(now)}
  end

  defp bounded(readers, now) when map_size(readers) > @max_stations * 3 do
    kept = Map.reject(readers, fn {_key, {_version, at}} -> now - at >= @forgotten end)

    if map_size(kept) > @max_stations * 3,
      do: Map.delete(kept, kept |> Enum.min_by(fn {_key, {_version, at}} -> at end) |> elem(0)),
      else: kept
  end

  defp bounded(readers, _now), do: readers

  # --- What makes a plan stale

  defp forget(served, @all, now), do: Enum.reduce(@types, served, &forget(&2, &1, now))

  defp forget(served, type, now),
    do: %{served | plans: Map.delete(served.plans, type), changed: Map.put(served.changed, type, now)}

  # 0: the vehicle's plans have no ids, or it has no plan.
  defp known(served, type, id, now) do
    before = served.ids[type]
    served = %{served | ids: Map.put(served.ids, type, {id, now})}

    cond do
      before != nil and elem(before, 0) != id -> forget(served, type, now)
      stale?(served.plans[type], id) -> forget(served, type, now)
      true -> served
    end
  end

  defp stale?(%{opaque_id: known}, id), do: known != nil and id != known
  defp stale?(nil, _id), do: false

  defp same_id?({id, at}, opaque_id, began) when at >= began and id != 0 and opaque_id != nil,
    do: id == opaque_id

  defp same_id?(_unknown, _opaque_id, _began), do: true

  # Firmwares count the total differently, but a change means the same everywhere.
  defp total(%{plans: %{@mission => %{total: nil} = plan}} = served, total, _now),
    do: put_in(served.plans[@mission], %{plan | total: total})

  defp total(%{plans: %{@mission => %{total: known}}} = served, total, now) when known != total,
    do: forget(served, @mission, now)

  defp total(served, _total, _now), do: served

  defp home?(item, home) do
    is_integer(item.x) and is_integer(item.y) and is_number(item.z) and abs(item.x - home.latitude) <= @near and
      abs(item.y - home.longitude) <= @near and abs(item.z - home.altitude / 1000) <= @near_m
  end

  # --- Answers

  defp count(plan, type, from), do: Reply.count(type, tuple_size(plan.items), from, plan.opaque_id || 0)

  defp item(plan, seq, type, from) when seq < tuple_size(plan.items),
    do: Item.message(elem(plan.items, seq), seq, type, from)

  defp item(_plan, _seq, type, from), do: Reply.ack(type, :INVALID_SEQUENCE, from)
end
