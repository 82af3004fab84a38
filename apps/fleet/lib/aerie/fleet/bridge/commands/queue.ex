defmodule Aerie.Fleet.Bridge.Commands.Queue do
  @moduledoc """
  Which request over NATS is worked on, which waits, and which is not even read. Pure: requests are told apart by what they claim
  (`Aerie.Control.Policy.Roles.Sources.claim/3`), which costs microseconds, before they cost a place.

  | lane | requests | limit | beyond it |
  |---|---|---|---|
  | a listed key | whose signature is to be checked | 8 at once for each key, 256 wait | dropped |
  | | whose signature was good | 512, and 64 for what holds a vehicle or brings it down | `busy` |
  | | that came before with the same signature | 32 of these | `busy` |
  | unsigned | while `policy.unsigned` gives a role | 256 of these, and 32 for what holds a vehicle or brings it down | `busy` |
  | refused | without a signature, by an unlisted key, malformed, stale | 8 at once, 20 a second after the first 100 | dropped |
  | `busy` | what there is no place for | 16 at once | dropped |

  So neither requests without a signature nor forged ones of one key keep the signed ones of another key away, nor do copies of a message
  that somebody has overheard.
  """

  alias Aerie.Base.Timing.TokenBucket

  @checking 8
  @waiting 256
  @signed 512
  @reserve 64
  @copies 32
  @unsigned 256
  @unsigned_reserve 32
  @refused 8
  @refused_interval_us 50_000
  @refused_burst 100

  @busy 16

  # Signatures that were good, in two generations: each is known for a minute at least, as long as it counts.
  @generation_us 60_000_000
  @most_seen 8_192

  @typedoc "`phase` of a task: its signature is checked, it is carried out as one of a kind, it is refused, or told that there is no place."
  @type phase :: {:checking, String.t()} | :signed | :copy | :unsigned | :refused | :busy
  @type claim :: {:listed, String.t()} | :unsigned | :refused

  @enforce_keys [:seen]
  defstruct [:seen, counts: %{}, queues: %{}, bucket: nil]

  @opaque t :: %__MODULE__{}

  @spec new(now :: integer()) :: t()
  def new(now), do: %__MODULE__{seen: {now, MapSet.new(), MapSet.new()}}

  @doc """
  A request has come. `ending?`: it holds a vehicle or brings it down.

    * `{:run, phase, lanes}` - work on it; `left/2` and `verified/5` say what becomes of it
    * `{:wait, lanes}` - it waits for its turn (`left/2`, `verified/5`)
    * `:drop` - it is counted, and that is all
  """
  @spec arrive(t(), claim(), request :: term(), ending? :: boolean(), now :: integer()) ::
          {:run, phase(), t()} | {:wait, t()} | :drop
  def arrive(lanes, {:listed, key}, request, _ending?, _now) do
    {number, queue} = Map.get(lanes.queues, key, {0, :queue.new()})

    cond do
      count(lanes, {:checking, key}) < @checking ->
        {:run, {:checking, key}, enter(lanes, {:checking, key})}

      number < @waiting ->
        {:wait, put_in(lanes.queues[key], {number + 1, :queue.in(request, queue)})}

      true ->
        :drop
    end
  end

  def arrive(lanes, :unsigned, _request, ending?, _now) do
    if count(lanes, :unsigned) < @unsigned + if(ending?, do: @unsigned_reserve, else: 0),
      do: {:run, :unsigned, enter(lanes, :unsigned)},
      else: busy(lanes)
  end

  def arrive(lanes, :refused, _request, _ending?, now) do
    with true <- count(lanes, :refused) < @refused,
         {:ok, bucket} <- TokenBucket.take(lanes.bucket, now, @refused_interval_us, @refused_burst) do
      {:run, :refused, enter(%{lanes | bucket: bucket}, :refused)}
    else
      _full -> :drop
    end
  end

  defp busy(lanes),
    do: if(count(lanes, :busy) < @busy, do: {:run, :busy, enter(lanes, :busy)}, else: :drop)

  @doc """
  The signature of a request of a key was good. Gives how it goes on (nil: as many are carried out as there may be), and the request of the
  same key whose turn it is.
  """
  @spec verified(t(), key :: String.t(), signature :: binary(), ending? :: boolean(), now :: integer()) ::
          {:signed | :copy | nil, next :: {:ok, term()} | :none, t()}
  def verified(lanes, key, signature, ending?, now) do
    {seen?, lanes} = seen(lanes, signature, now)
    {next, lanes} = left(lanes, {:checking, key})
    {phase, most} = if seen?, do: {:copy, @copies}, else: {:signed, @signed}
    most = most + if(ending?, do: @reserve, else: 0)

    if count(lanes, phase) < most,
      do: {phase, next, enter(lanes, phase)},
      else: {nil, next, lanes}
  end

  @doc "A task has ended, or its check has. Gives the request whose turn it is; it has entered the same phase."
  @spec left(t(), phase()) :: {{:ok, term()} | :none, t()}
  def left(lanes, phase) do
    lanes = %{lanes | counts: Map.update!(lanes.counts, phase, &(&1 - 1))}
    lanes = if lanes.counts[phase] == 0, do: %{lanes | counts: Map.delete(lanes.counts, phase)}, else: lanes
    next(lanes, phase)
  end

  defp next(lanes, {:checking, key}) when is_map_key(lanes.queues, key) do
    {number, queue} = lanes.queues[key]
    {{:value, request}, queue} = :queue.out(queue)

    queues =
      if number == 1,
        do: Map.delete(lanes.queues, key),
        else: Map.put(lanes.queues, key, {number - 1, queue})

    {{:ok, request}, enter(%{lanes | queues: queues}, {:checking, key})}
  end

  defp next(lanes, _phase), do: {:none, lanes}

  @doc "Whether one more request of a listed key can wait for its signature to be checked."
  @spec room?(t(), key :: String.t()) :: boolean()
  def room?(%{queues: queues}, key) do
    case queues do
      %{^key => {number, _queue}} -> number < @waiting
      _none_waits -> true
    end
  end

  @doc "How many requests are in a phase."
  @spec count(t(), phase()) :: non_neg_integer()
  def count(lanes, phase), do: Map.get(lanes.counts, phase, 0)

  defp enter(lanes, phase), do: %{lanes | counts: Map.update(lanes.counts, phase, 1, &(&1 + 1))}

  defp seen(%{seen: {since, new, old}} = lanes, signature, now) do
    {since, new, old} =
      if now - since > @generation_us or MapSet.size(new) >= @most_seen,
        do: {now, MapSet.new(), new},
        else: {since, new, old}

    {signature in new or signature in old, %{lanes | seen: {since, MapSet.put(new, signature), old}}}
  end
end
