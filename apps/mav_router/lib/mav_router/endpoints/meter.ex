defmodule MavRouter.Endpoints.Meter do
  @every_ms 1_000
  @rtt_ms 30_000

  @moduledoc """
  Measures once a second: the rates of the endpoints, the scores of the links to vehicles, and which link of each group carries.

  | in `:scores` | |
  |---|---|
  | `{:rates, endpoint}` | per second, of the last second |
  | `{:score, link}` | `%{score, loss, rtt_ms, age_ms}`: 0 to 100 (`MavRouter.Routes.Score`), and what it was made of |
  | `{:carrier, group}` | the link that carries |

  Loss follows from the sequence numbers heard on a link in the last seconds. Round trips are measured by the vehicles' sessions,
  with TIMESYNC and PING (`note_rtt/3`), and hold for #{div(@rtt_ms, 1_000)} s.
  """
  use GenServer

  alias Aerie.Base.Store
  alias Aerie.Base.Names
  alias MavRouter.Endpoints
  alias MavRouter.Routes.Score
  alias MavRouter.Tables
  alias MavRouter.Endpoints.Counters

  # How much of the former loss stays in the mean after a second.
  @keep 0.8

  @spec start_link(gateway: Names.gateway()) :: GenServer.on_start()
  def start_link(options) do
    gateway = Keyword.fetch!(options, :gateway)
    GenServer.start_link(__MODULE__, gateway, name: Names.via(gateway, :router_meter))
  end

  @doc "Notes a round trip measured over a link, in ms. What holds is the mean of it and the one before."
  @spec note_rtt(Names.gateway(), String.t(), number) :: :ok
  def note_rtt(gateway, link, ms) when is_number(ms) and ms >= 0 do
    with tables when is_map(tables) <- Tables.of(gateway) do
      now = System.monotonic_time(:millisecond)
      mean = if before = rtt(tables, link, now), do: (before + ms) / 2, else: ms
      :ets.insert(tables.scores, {{:rtt, link}, mean, now})
    end

    :ok
  end

  @typedoc "`MavRouter.Link.fields/0` says what is what; nil where nothing is known, and without a group."
  @type quality :: %{
          score: float,
          loss: float | nil,
          rtt_ms: number | nil,
          age_ms: non_neg_integer | nil,
          group: String.t() | nil,
          carries: boolean | nil
        }

  @doc "How good a link is; nil before its first measurement."
  @spec quality(Names.gateway(), String.t()) :: quality | nil
  def quality(gateway, link) do
    with tables when is_map(tables) <- Tables.of(gateway),
         %{} = reading <- :ets.lookup_element(tables.scores, {:score, link}, 2, nil) do
      case Endpoints.owner(tables, link) do
        %{group: group} when group != nil ->
          pick = :ets.lookup_element(tables.scores, {:carrier, group}, 2, nil)
          Map.merge(reading, %{group: group, carries: pick == link})

        _none ->
          Map.merge(reading, %{group: nil, carries: nil})
      end
    end
  end

  @impl GenServer
  def init(gateway) do
    Process.set_label({:router_meter, gateway})
    Process.send_after(self(), :measure, @every_ms)
    {:ok, new(gateway)}
  end

  @impl GenServer
  def handle_info(:measure, state) do
    Process.send_after(self(), :measure, @every_ms)

    case Tables.of(state.gateway) do
      nil -> {:noreply, state}
      tables -> {:noreply, measure(state, tables, System.monotonic_time(:millisecond))}
    end
  end

  @doc "The state between two measurements; empty."
  @spec new(Names.gateway()) :: map
  def new(gateway), do: %{gateway: gateway, at: nil, counts: %{}, sequences: %{}, losses: %{}, choices: %{}}

  @doc "One measurement at a monotonic time in ms."
  @spec measure(map, Tables.t(), integer) :: map
  def measure(state, tables, now), do: state |> rates(tables, now) |> groups(tables, now)

  defp rates(state, tables, now) do
    counts = Map.new(Endpoints.list(tables), &{&1.key, Counters.read(&1.counters)})
    seconds = if state.at, do: max(now - state.at, 1) / 1000

    for {key, now} <- counts, before = state.counts[key], seconds do
      per_second = fn name -> Float.round((now[name] - before[name]) / seconds, 1) end
      rates = Map.new([:frames_in, :frames_out, :bytes_out], &{&1, per_second.(&1)})
      :ets.insert(tables.scores, {{:rates, key}, rates})
    end

    for {key, _tally} <- state.counts,
        not is_map_key(counts, key),
        do: :ets.delete(tables.scores, {:rates, key})

    %{state | at: now, counts: counts}
  end

  defp groups(state, tables, now) do
    owners = for {_id, %{side: :vehicle} = owner} <- :ets.tab2list(tables.owners), do: owner
    {scores, state} = Enum.flat_map_reduce(owners, state, &score(&2, tables, &1.id, now))
    scores = Map.new(scores)
    groups = owners |> Enum.filter(& &1.group) |> Enum.group_by(& &1.group, & &1.id)
    Enum.reduce(groups, forget(state, owners), &group(&2, tables, &1, scores))
  end

  defp forget(state, owners) do
    ids = Enum.map(owners, & &1.id)
    %{state | losses: Map.take(state.losses, ids), sequences: Map.take(state.sequences, ids)}
  end

  defp group(state, tables, {group, links}, scores) do
    scores = Map.take(scores, links)
    choice = Score.choose(state.choices[group] || Score.none(), scores)

    if choice.link != (state.choices[group] || Score.none()).link do
      :ets.insert(tables.scores, {{:carrier, group}, choice.link})
      metadata = %{gateway: state.gateway, group: group, link: choice.link}
      :telemetry.execute([:aerie, :router, :carrier], %{score: scores[choice.link]}, metadata)
    end

    put_in(state.choices[group], choice)
  end

  # A link that is down cannot be chosen.
  defp score(state, tables, link, now) do
    case Store.Links.whole(state.gateway, link) do
      %{status: status} = snapshot when status in [:up, :idle] ->
        state = loss(state, link, snapshot.sources)
        reading = %{loss: state.losses[link], rtt_ms: rtt(tables, link, now), age_ms: age(snapshot)}
        score = Score.of(reading)
        :ets.insert(tables.scores, {{:score, link}, Map.put(reading, :score, score)})
        {[{link, score}], state}

      %{} = snapshot ->
        down = %{score: 0.0, loss: state.losses[link], rtt_ms: nil, age_ms: age(snapshot)}
        :ets.insert(tables.scores, {{:score, link}, down})
        {[], state}

      # An owner that is not a link is not measured.
      nil ->
        {[], state}
    end
  end

  # Counted since the last measurement, so that a loss of an hour ago does not count for ever.
  defp loss(state, link, sources) do
    sums =
      Enum.reduce(sources, {0, 0}, fn {_ids, source}, {received, lost} ->
        {received + Map.get(source, :received, 0), lost + (Map.get(source, :lost) || 0)}
      end)

    {received, lost} = sums
    {received_before, lost_before} = Map.get(state.sequences, link, sums)
    {new, gone} = {max(received - received_before, 0), max(lost - lost_before, 0)}
    before = state.losses[link]

    mean =
      cond do
        new + gone == 0 -> before
        before == nil -> gone / (new + gone)
        true -> @keep * before + (1 - @keep) * gone / (new + gone)
      end

    %{
      state
      | sequences: Map.put(state.sequences, link, sums),
        losses: if(mean, do: Map.put(state.losses, link, mean), else: state.losses)
    }
  end

  defp rtt(tables, link, now) do
    case :ets.lookup(tables.scores, {:rtt, link}) do
      [{_key, ms, at}] when now - at < @rtt_ms -> ms
      _unknown -> nil
    end
  end

  defp age(%{last_heard: nil}), do: nil
  defp age(%{last_heard: at}), do: max(div(System.os_time(:microsecond) - at, 1000), 0)
end
