defmodule Aerie.Vehicle.Events.Journal do
  @max_inbox 4096
  # Observations that a vehicle can send at any rate get at most half of the inbox, urgent texts (critical and above) three
  # quarters. The rest is for changes of its state.
  @max_chatter 2048
  @max_urgent 3072
  @chatter [:text, :report, :params, :reached]
  @max_gone 1024
  @max_recent 256
  @page 2048
  # No firmware has as many; the names come from outside.
  @max_params 8192

  @moduledoc """
  Keeps events from their detection until NATS has acknowledged them.

  Each step of a detector happens exactly once, whichever process is killed: its new state and its events are written with *one*
  atomic `:ets.insert`. If the process is killed before that, the step is repeated from the same state; after it, the state
  says that the step is done. A detector gets its observations through an inbox in the same table, and its state says how far
  it has read.

      session ─ offer/3 ─▶ inbox ─▶ Aerie.Vehicle.Events ─ commit/4 ─▶ pending ─▶ bridge ─ ack/2
                                                                   └─▶ recent (for the API)

  Bounds: #{@max_inbox} entries in a vehicle's inbox (half of them for texts, reports, parameters and the like, three quarters for urgent
  texts), `limits.max_pending_events` unacknowledged events (the oldest is dropped), the last #{@max_recent} events of each vehicle,
  #{@max_params} parameters of a vehicle, the detectors' states of #{@max_gone} vehicles that were removed. Drops are counted as
  `{:journal, :inbox_dropped}`, `{:journal, :pending_dropped}` and `{:journal, :params_dropped}`; those of a vehicle's inbox also
  as `{:vehicle, id, :inbox_dropped}`, because they are in no `events.suppressed`.

  The table belongs to `Aerie.Base.Store`. Objects in it:

      {{:state, vehicle}, term}         {{:inbox, vehicle, n}, term}       {{:inbox_last, vehicle}, n}
      {{:pending, n}, event}            {{:id, event_id}, n}               {{:recent, vehicle, seq}, event}
      {{:param, vehicle, name}, value}  {{:params, vehicle}, count}        {:last_pending, n}
      {{:gone, n}, vehicle}             {:max_pending, n}                  {:epoch, n}
  """

  alias Aerie.Base.{Names, Store}
  alias Aerie.Base.PubSub
  alias Aerie.Vehicle.Event

  @type params :: %{String.t() => term()}

  @doc """
  Writes a detector's state and the events of its step atomically, then notifies subscribers of `:events` and `:journal`.

  `params` are parameter values to keep, part of the same write.
  """
  @spec commit(Names.gateway(), String.t(), term(), [Event.t()], params()) :: :ok
  def commit(gateway, vehicle, state, events, params \\ %{}) do
    table = Store.table!(gateway, :journal)

    known_params =
      for {name, value} <- params, room?(gateway, table, vehicle, name), do: {{:param, vehicle, name}, value}

    new_events = Enum.flat_map(events, &objects(table, &1))
    :ets.insert(table, [{{:state, vehicle}, state} | new_events ++ known_params])

    if events != [] do
      bound_pending(gateway, table)
      Enum.each(events, &:ets.delete(table, {:recent, vehicle, &1.seq - @max_recent}))
      Enum.each(events, &PubSub.publish(gateway, :events, &1))
      wake(gateway)
    end

    :ok
  end

  @doc "Writes the first state of a vehicle unless it has one, and returns its state."
  @spec begin(Names.gateway(), String.t(), term()) :: term()
  def begin(gateway, vehicle, first) do
    table = Store.table!(gateway, :journal)
    _ = :ets.insert_new(table, {{:state, vehicle}, first})
    :ets.lookup_element(table, {:state, vehicle}, 2)
  end

  @doc """
  Writes the first state of a vehicle that is not present, with its events, like `commit/5`; does nothing if it has a state,
  because then it is present. The vehicle counts as removed.
  """
  @spec begin_gone(Names.gateway(), String.t(), term(), [Event.t()]) :: boolean()
  def begin_gone(gateway, vehicle, first, events) do
    table = Store.table!(gateway, :journal)
    objects = [{{:state, vehicle}, first}, gone(vehicle) | Enum.flat_map(events, &objects(table, &1))]
    begun? = :ets.insert_new(table, objects)

    if begun? do
      bound_gone(gateway, table)
      bound_pending(gateway, table)
      Enum.each(events, &PubSub.publish(gateway, :events, &1))
      wake(gateway)
    end

    begun?
  end

  @doc "The state last committed for a vehicle, or nil."
  @spec state(Names.gateway(), String.t()) :: term() | nil
  def state(gateway, vehicle) do
    Store.with_table(gateway, :journal, nil, &:ets.lookup_element(&1, {:state, vehicle}, 2, nil))
  end

  @doc "Parts of all committed states: `[vehicle | parts]` for each that matches an ETS pattern with variables from `$2`."
  @spec states(Names.gateway(), term()) :: [[term()]]
  def states(gateway, pattern) do
    Store.with_table(gateway, :journal, [], fn table ->
      :ets.select(table, [{{{:state, :"$1"}, pattern}, [], [:"$$"]}])
    end)
  end

  @doc "The vehicles that have unacknowledged events."
  @spec waiting(Names.gateway()) :: MapSet.t(String.t())
  def waiting(gateway) do
    pattern = {{:pending, :_}, %{vehicle: :"$1"}}

    gateway
    |> Store.with_table(:journal, [], &:ets.select(&1, [{pattern, [], [:"$1"]}]))
    |> MapSet.new()
  end

  @doc "The epoch of this journal, in which events are numbered from 1; nil before it is set."
  @spec epoch(Names.gateway()) :: pos_integer() | nil
  def epoch(gateway) do
    Store.with_table(gateway, :journal, nil, &:ets.lookup_element(&1, :epoch, 2, nil))
  end

  @doc "Sets the epoch unless it is set, and returns it."
  @spec epoch(Names.gateway(), pos_integer()) :: pos_integer()
  def epoch(gateway, new) do
    table = Store.table!(gateway, :journal)
    _ = :ets.insert_new(table, {:epoch, new})
    :ets.lookup_element(table, :epoch, 2)
  end

  @doc "The last known value of a vehicle's parameter: `{:ok, value}` or `:error`."
  @spec param(Names.gateway(), String.t(), String.t()) :: {:ok, term()} | :error
  def param(gateway, vehicle, name) do
    case Store.with_table(gateway, :journal, [], &:ets.lookup(&1, {:param, vehicle, name})) do
      [{_key, value}] -> {:ok, value}
      [] -> :error
    end
  end

  @doc """
  Tells subscribers of `:journal` (`{:fleet, :journal, :pending}`) that there may be unacknowledged events.

  Called by every commit with events, and when a vehicle's event loop starts: the last one may have been killed between the
  write and the notice.
  """
  @spec wake(Names.gateway()) :: :ok
  def wake(gateway), do: PubSub.publish(gateway, :journal, :pending)

  @doc "Unacknowledged events, oldest first; at most `limit`."
  @spec pending(Names.gateway(), pos_integer() | :all) :: [Event.t()]
  def pending(gateway, limit \\ :all)

  def pending(gateway, :all),
    do: Store.with_table(gateway, :journal, [], &:ets.select(&1, all_pending()))

  def pending(gateway, limit) do
    case Store.with_table(gateway, :journal, :"$end_of_table", &:ets.select(&1, all_pending(), limit)) do
      {events, _continuation} -> events
      :"$end_of_table" -> []
    end
  end

  defp all_pending, do: [{{{:pending, :_}, :"$1"}, [], [:"$1"]}]

  @doc "The table that the store owns for the journal."
  @spec table(Aerie.Vehicle.Events.Journal.Settings.t()) :: Store.table()
  def table(%Aerie.Vehicle.Events.Journal.Settings{max_pending_events: max}),
    do: {:journal, [:ordered_set, write_concurrency: true], [{:max_pending, max}]}

  @doc "How many events wait for acknowledgement."
  @spec pending_size(Names.gateway()) :: non_neg_integer()
  def pending_size(gateway) do
    Store.with_table(gateway, :journal, 0, &:ets.select_count(&1, [{{{:pending, :_}, :_}, [], [true]}]))
  end

  @doc "Removes acknowledged events from the pending ones. Unknown ids are ignored."
  @spec ack(Names.gateway(), [String.t()]) :: :ok
  def ack(gateway, ids) do
    table = Store.table!(gateway, :journal)
    for id <- ids, {_key, n} <- :ets.take(table, {:id, id}), do: :ets.delete(table, {:pending, n})
    :ok
  end

  @doc """
  The last events of a vehicle in their order, or of `:all` by time, oldest first, acknowledged or not; at most #{@max_recent} of each
  vehicle, so that one vehicle cannot push out the events of others.

  Options: `:since` (unix us) omits earlier events; `:limit` is the largest number: with `:since` of the first ones, so that a
  reader can continue from there, else of the last ones.
  """
  @spec recent(Names.gateway(), String.t() | :all, since: integer() | nil, limit: pos_integer()) :: [
          Event.t()
        ]
  def recent(gateway, vehicle, options \\ []) do
    since = options[:since]
    limit = Keyword.get(options, :limit, @max_recent)
    {whose, order} = if vehicle == :all, do: {:_, {{:"$1", :"$3", :"$2"}}}, else: {vehicle, {{:"$2", :"$3"}}}
    within = if since, do: [{:>=, :"$1", since}], else: []
    spec = [{{{:recent, whose, :_}, %{time: :"$1", seq: :"$2", vehicle: :"$3"}}, within, [order]}]
    keep = if since, do: &Enum.take(&1, limit), else: &Enum.take(&1, -limit)

    for key <- gateway |> page(&:ets.select(&1, spec, @page)) |> gather(gateway, [], keep),
        # It may have been removed meanwhile.
        {_key, event} <- Store.with_table(gateway, :journal, [], &:ets.lookup(&1, recent_key(key))),
        do: event
  end

  # Collects the sort keys page by page; only the events of the result are copied.
  defp gather(:"$end_of_table", _gateway, kept, _keep), do: kept

  defp gather({found, continuation}, gateway, kept, keep) do
    gateway
    |> page(fn _table -> :ets.select(continuation) end)
    |> gather(gateway, keep.(Enum.sort(kept ++ found)), keep)
  end

  defp page(gateway, select), do: Store.with_table(gateway, :journal, :"$end_of_table", select)

  defp recent_key({_time, vehicle, seq}), do: {:recent, vehicle, seq}
  defp recent_key({seq, vehicle}), do: {:recent, vehicle, seq}

  @doc "Puts an observation into the inbox of a vehicle's detector. If the inbox is full, it is dropped and counted."
  @spec offer(Names.gateway(), String.t(), term()) :: :ok | {:error, :full}
  def offer(gateway, vehicle, observation) do
    table = Store.table!(gateway, :journal)
    next = :ets.lookup_element(table, {:inbox_last, vehicle}, 2, 0) + 1

    # A dropped entry takes no number, so the span of numbers is the size.
    if next - oldest(table, vehicle, next) < room(observation) do
      n = :ets.update_counter(table, {:inbox_last, vehicle}, 1, {{:inbox_last, vehicle}, 0})
      :ets.insert(table, {{:inbox, vehicle, n}, observation})
      :ok
    else
      Store.count(gateway, {:journal, :inbox_dropped})
      Store.count(gateway, {:vehicle, vehicle, :inbox_dropped})
      {:error, :full}
    end
  end

  defp room(%{kind: :text, data: %{severity: severity}}) when severity <= 2, do: @max_urgent
  defp room(%{kind: kind}) when kind in @chatter, do: @max_chatter
  defp room(_observation), do: @max_inbox

  @doc """
  The observations that a detector has not processed yet: the entries after number `done` as `{n, observation}`, in order, at
  most #{@max_inbox}.
  """
  @spec inbox(Names.gateway(), String.t(), non_neg_integer()) :: [{pos_integer(), term()}]
  def inbox(gateway, vehicle, done) do
    Store.with_table(gateway, :journal, [], fn table ->
      :ets.select(table, [{{{:inbox, vehicle, :"$1"}, :"$2"}, [{:>, :"$1", done}], [{{:"$1", :"$2"}}]}])
    end)
  end

  @doc "Removes inbox entries that the committed state has processed."
  @spec forget(Names.gateway(), String.t(), [pos_integer()]) :: :ok
  def forget(gateway, vehicle, numbers) do
    table = Store.table!(gateway, :journal)
    Enum.each(numbers, &:ets.delete(table, {:inbox, vehicle, &1}))
  end

  defp room?(gateway, table, vehicle, name) do
    cond do
      :ets.member(table, {:param, vehicle, name}) ->
        true

      :ets.update_counter(
        table,
        {:params, vehicle},
        {2, 1, @max_params, @max_params},
        {{:params, vehicle}, -1}
      ) <
          @max_params ->
        true

      true ->
        Store.count(gateway, {:journal, :params_dropped})
        false
    end
  end

  defp objects(table, event) do
    n = :ets.update_counter(table, :last_pending, 1, {:last_pending, 0})
    [{{:pending, n}, event}, {{:id, event.id}, n}, {{:recent, event.vehicle, event.seq}, event}]
  end

  defp oldest(table, vehicle, default) do
    case :ets.next(table, {:inbox, vehicle, 0}) do
      {:inbox, ^vehicle, n} -> n
      _other -> default
    end
  end

  @doc """
  Removes a vehicle's inbox and parameters. Its events stay, and so does its detector's state, which numbers the next ones,
  until #{@max_gone} other vehicles have been removed after it.
  """
  @spec forget_vehicle(Names.gateway(), String.t()) :: :ok
  def forget_vehicle(gateway, vehicle) do
    table = Store.table!(gateway, :journal)
    :ok = here(table, vehicle)
    :ets.insert(table, gone(vehicle))
    bound_gone(gateway, table)
    :ets.match_delete(table, {{:inbox, vehicle, :_}, :_})
    :ets.match_delete(table, {{:param, vehicle, :_}, :_})
    :ets.delete(table, {:params, vehicle})
    :ok
  end

  @doc "A vehicle that may have been removed is present again."
  @spec welcome(Names.gateway(), String.t()) :: :ok
  def welcome(gateway, vehicle), do: gateway |> Store.table!(:journal) |> here(vehicle)

  defp here(table, vehicle) do
    true = :ets.match_delete(table, {{:gone, :_}, vehicle})
    :ok
  end

  defp gone(vehicle), do: {{:gone, :erlang.unique_integer([:monotonic])}, vehicle}

  defp bound_gone(gateway, table) do
    gone = :ets.select_count(table, [{{{:gone, :_}, :_}, [], [true]}])
    if gone > @max_gone, do: forget_longest_gone(gateway, table)
  end

  # Removes everything but the events that wait, which the bridge will acknowledge.
  defp forget_longest_gone(gateway, table) do
    {[{key, vehicle}], _continuation} = :ets.select(table, [{{{:gone, :_}, :_}, [], [:"$_"]}], 1)
    :ets.delete(table, key)
    :ets.delete(table, {:state, vehicle})
    :ets.delete(table, {:inbox_last, vehicle})
    :ets.match_delete(table, {{:recent, vehicle, :_}, :_})
    Store.forget_counters(gateway, vehicle)
  end

  # The span of numbers is the size: numbers are not reused, so there are never more events than that.
  defp bound_pending(gateway, table) do
    with {[{n, id}], _continuation} <- :ets.select(table, oldest_pending(), 1),
         true <-
           :ets.lookup_element(table, :last_pending, 2) - n >= :ets.lookup_element(table, :max_pending, 2) do
      :ets.delete(table, {:id, id})
      dropped(gateway, :ets.take(table, {:pending, n}))
      bound_pending(gateway, table)
    else
      _within_bounds -> :ok
    end
  end

  # It was acknowledged in between, so nothing was dropped.
  defp dropped(_gateway, []), do: :ok

  defp dropped(gateway, [_object]) do
    _count = Store.count(gateway, {:journal, :pending_dropped})
    :ok
  end

  defp oldest_pending, do: [{{{:pending, :"$1"}, %{id: :"$2"}}, [], [{{:"$1", :"$2"}}]}]
end
