defmodule Aerie.Console.Map.Tiles.Fetcher.Queue do
  @moduledoc """
  Which tile is fetched when: two at a time from a server, the newest question first, the same question once. Pure.

  A server that fails is left alone: for a second, then twice as long each time, up to five minutes, or as long as it
  says. Questions of that time are answered at once, so that what is on the disk is shown without a wait. Nothing
  needs a timer.
  """

  alias Aerie.Base.Timing.Backoff
  alias Aerie.Console.Map.Tiles.Fetcher.Answer

  @at_once 2
  @most 256
  @first_ms 1_000
  @longest_ms 300_000

  @idle %{running: 0, failures: 0, until: nil, words: nil, fetched: 0, errors: 0}

  defstruct servers: %{}, jobs: %{}, waiting: []

  @typedoc "A server's counts, and until when it is left alone (monotonic ms) and why; nil while it works."
  @type server :: %{
          running: non_neg_integer(),
          failures: non_neg_integer(),
          until: integer() | nil,
          words: String.t() | nil,
          fetched: non_neg_integer(),
          errors: non_neg_integer()
        }
  @type job :: %{
          key: term(),
          server: String.t(),
          work: term(),
          # Nobody waits for it any more after that.
          deadline: integer(),
          askers: [term()]
        }
  @type t :: %__MODULE__{
          servers: %{String.t() => server()},
          jobs: %{term() => job()},
          waiting: [key :: term()]
        }
  @type event ::
          {:ask, key :: term(), server :: String.t(), asker :: term(), work :: term(), deadline :: integer()}
          | {:done, key :: term(), Answer.t()}
  @type action ::
          {:start, key :: term(), server :: String.t(), work :: term()}
          | {:reply, asker :: term(), {:ok, map()} | {:error, String.t()}}
          | {:failing, server :: String.t(), String.t()}
          | {:working, server :: String.t()}

  @doc "What follows from an event at a time (monotonic ms)."
  @spec handle(t(), event(), now :: integer()) :: {t(), [action()]}
  def handle(state, {:ask, key, name, asker, work, deadline}, now) do
    server = Map.get(state.servers, name, @idle)

    cond do
      is_map_key(state.jobs, key) ->
        {update_in(
           state.jobs[key],
           &%{&1 | askers: [asker | &1.askers], deadline: max(&1.deadline, deadline)}
         ), []}

      server.until != nil and now < server.until ->
        {state, [{:reply, asker, {:error, server.words}}]}

      length(state.waiting) >= @most ->
        {state, [{:reply, asker, {:error, "too many tiles are being fetched"}}]}

      true ->
        job = %{key: key, server: name, work: work, deadline: deadline, askers: [asker]}
        state = put_in(state.servers[name], server)
        next(%{state | jobs: Map.put(state.jobs, key, job), waiting: [key | state.waiting]}, name, now)
    end
  end

  def handle(state, {:done, key, answer}, now) do
    {job, jobs} = Map.pop!(state.jobs, key)
    server = Map.fetch!(state.servers, job.server)
    {server, told} = judge(%{server | running: server.running - 1}, job.server, answer, now)
    state = put_in(%{state | jobs: jobs}.servers[job.server], server)
    replies = for asker <- job.askers, do: {:reply, asker, result(answer)}

    {state, more} =
      if server.until, do: give_up(state, job.server, server.words), else: next(state, job.server, now)

    {state, replies ++ told ++ more}
  end

  defp result({:error, words, _wait}), do: {:error, words}
  defp result(ok), do: ok

  defp judge(server, name, {:ok, _entry}, _now) do
    told = if server.failures > 0, do: [{:working, name}], else: []
    {%{server | failures: 0, until: nil, words: nil, fetched: server.fetched + 1}, told}
  end

  defp judge(server, name, {:error, words, wait}, now) do
    failures = server.failures + 1
    ms = max(Backoff.wait(failures, @first_ms, @longest_ms, 1.0), (wait || 0) * 1_000)
    told = if failures == 1, do: [{:failing, name, words}], else: []
    {%{server | failures: failures, until: now + ms, words: words, errors: server.errors + 1}, told}
  end

  # Those that wait for a server that fails.
  defp give_up(state, name, words) do
    {gone, waiting} = Enum.split_with(state.waiting, &(state.jobs[&1].server == name))
    replies = for key <- gone, asker <- state.jobs[key].askers, do: {:reply, asker, {:error, words}}
    {%{state | waiting: waiting, jobs: Map.drop(state.jobs, gone)}, replies}
  end

  defp next(state, name, now) do
    late = Enum.filter(state.waiting, &(state.jobs[&1].deadline <= now))
    state = %{state | waiting: state.waiting -- late, jobs: Map.drop(state.jobs, late)}
    key = Enum.find(state.waiting, &(state.jobs[&1].server == name))

    if key != nil and state.servers[name].running < @at_once do
      state = update_in(state.servers[name].running, &(&1 + 1))
      {state, more} = next(%{state | waiting: List.delete(state.waiting, key)}, name, now)
      {state, [{:start, key, name, state.jobs[key].work} | more]}
    else
      {state, []}
    end
  end
end
