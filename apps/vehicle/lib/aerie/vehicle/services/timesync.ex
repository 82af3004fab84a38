defmodule Aerie.Vehicle.Services.Timesync do
  @moduledoc """
  The offset of a vehicle's clock from ours, by TIMESYNC, and the round trip by each of its links. A pure value.

  A request has our time (`ts1`); the answer repeats it and adds the vehicle's time (`tc1`). So the round trip is known,
  and half of it is the best estimate of the answer's age. The sample with the shortest round trip counts among the last
  ones, because its error, `rtt_us / 2`, is the smallest. Older samples lose by drift, 50 µs a second.

  A vehicle with several links is asked by each of them. The first copy of an answer is a sample of the clock, whichever
  link brought it; the round trip of a link is that of the copy which came by the link that was asked.

  Only answers to our own requests count, recognised by `ts1` (X5): many programs ask, and firmware sends its answers to
  all. A vehicle that does not answer is sent PING as well, which gives a round trip but no clock. A vehicle that
  answers neither is asked less often.
  """

  alias Aerie.Base.Json.Object
  alias MavCodec.Messages.{Ping, Timesync}

  @first_us 1_000_000
  @burst 3
  @burst_us 1_000_000
  @max_rtt_us 10_000_000
  @max_pending 32
  @max_links 8
  @max_samples 8
  @drift_per_s 50
  # A sample that differs by more than its error: the clock was set, or the sample is wrong. Two in a row: it was set.
  @jump_us 50_000
  @patience 5
  @ping_after 2
  @slow 6
  @answers_us 100_000

  @enforce_keys [:period]
  defstruct [
    :period,
    :next,
    :answered,
    pending: %{},
    samples: [],
    sent: 0,
    rounds: 0,
    unanswered: 0,
    unpinged: 0,
    odd: nil,
    foreign: 0
  ]

  @typedoc """
  - `period`: time between two requests (us), 0 for none
  - `pending`: requests without an answer by the link that was asked, by `ts1` or `{:ping, seq}`: when they were sent,
    by which link (nil: any), and whether another link brought a copy of the answer
  - `unanswered`, `unpinged`: rounds since the last answer to TIMESYNC and to PING
  - `odd`: a sample that contradicts the others
  - `foreign`: how many answers were not for us
  """
  @type t :: %__MODULE__{}
  @type sample :: {at :: integer(), rtt_us :: non_neg_integer(), offset_us :: integer()}
  @typedoc "The link to send it by (nil: the best one)."
  @type request :: {link :: term() | nil, Timesync.t() | Ping.t()}
  @type round_trip :: {link :: term(), us :: non_neg_integer()}

  @spec new(non_neg_integer()) :: t()
  def new(period), do: %__MODULE__{period: period}

  @doc "The requests that are due at `now` for a vehicle that is heard by these links, at most for the first eight."
  @spec expire(t(), integer(), [term()]) :: {t(), [request()]}
  def expire(sync, now, links \\ [])
  def expire(%{period: 0} = sync, _now, _links), do: {sync, []}
  def expire(%{next: nil} = sync, now, _links), do: {%{sync | next: now + @first_us}, []}
  def expire(%{next: next} = sync, now, _links) when now < next, do: {sync, []}

  def expire(sync, now, links) do
    sync = %{sync | rounds: sync.rounds + 1, unanswered: sync.unanswered + 1}
    ping? = sync.unanswered > @ping_after
    sync = if ping?, do: %{sync | unpinged: sync.unpinged + 1}, else: sync

    {requests, sync} =
      Enum.flat_map_reduce(Enum.take(targets(links), @max_links), sync, &request(&2, &1, now, ping?))

    {%{sync | next: now + pause(sync)}, requests}
  end

  # {link to send by, link whose round trip it is}; a single link need not be chosen.
  defp targets([]), do: [{nil, nil}]
  defp targets([only]), do: [{nil, only}]
  defp targets(links), do: Enum.map(links, &{&1, &1})

  defp request(sync, {by, link}, now, ping?) do
    # Nanoseconds. The digits below our microsecond distinguish our requests from others at the same time.
    ts1 = now * 1000 + rem(sync.sent * 37 + 191, 1000)
    sync = wait(%{sync | sent: sync.sent + 1}, ts1, {now, link, false})
    timesync = {by, %Timesync{tc1: 0, ts1: ts1}}

    if ping? do
      seq = rem(sync.sent, 0x1_0000_0000)
      ping = {by, %Ping{time_usec: now, seq: seq, target_system: 0, target_component: 0}}
      {[timesync, ping], wait(sync, {:ping, seq}, {now, link, false})}
    else
      {[timesync], sync}
    end
  end

  # The oldest makes room.
  defp wait(%{pending: pending} = sync, key, entry) do
    pending =
      if map_size(pending) < @max_pending,
        do: pending,
        else: Map.delete(pending, elem(Enum.min_by(pending, fn {_key, {sent, _, _}} -> sent end), 0))

    %{sync | pending: Map.put(pending, key, entry)}
  end

  defp pause(%{unanswered: unanswered, unpinged: unpinged} = sync)
       when unanswered > @patience and unpinged > @ping_after,
       do: sync.period * @slow

  defp pause(%{rounds: rounds} = sync) when rounds < @burst, do: min(@burst_us, sync.period)
  defp pause(sync), do: sync.period

  @doc "Whether a message is a TIMESYNC request."
  @spec request?(struct()) :: boolean()
  def request?(message), do: match?(%Timesync{tc1: 0}, message)

  @doc "A request of ours that is in a recording, with the time at which it was sent."
  @spec asked(t(), Timesync.t(), integer()) :: t()
  def asked(sync, %Timesync{tc1: 0, ts1: ts1}, at), do: wait(sync, ts1, {at, nil, false})

  @doc """
  An answer that came `at` by a link, and that link's round trip if it was the one asked. An answer that is not to one
  of our requests only counts as `foreign`.
  """
  @spec reply(t(), Timesync.t() | Ping.t(), integer(), term() | nil) :: {t(), round_trip() | nil}
  def reply(sync, answer, at, link \\ nil) do
    key = key(answer)

    case sync.pending do
      %{^key => {sent, asked, known?}} when at >= sent and at - sent <= @max_rtt_us ->
        rtt = at - sent
        sync = if known?, do: sync, else: answered(sync, answer, at, sent, rtt)
        here? = asked in [nil, link]

        pending =
          if here?,
            do: Map.delete(sync.pending, key),
            else: Map.put(sync.pending, key, {sent, asked, true})

        {%{sync | pending: pending}, if(here? and asked != nil, do: {asked, rtt})}

      %{^key => _late} ->
        {%{sync | pending: Map.delete(sync.pending, key)}, nil}

      _none ->
        {%{sync | foreign: sync.foreign + 1}, nil}
    end
  end

  defp key(%Timesync{ts1: ts1}), do: ts1
  defp key(%Ping{seq: seq}), do: {:ping, seq}

  defp answered(sync, %Timesync{tc1: tc1}, at, sent, rtt),
    do: add(%{sync | unanswered: 0}, {at, rtt, div(tc1, 1000) - (sent + div(rtt, 2))})

  defp answered(sync, %Ping{}, _at, _sent, _rtt), do: %{sync | unpinged: 0}

  defp add(%{samples: []} = sync, sample), do: %{sync | samples: [sample], odd: nil}

  defp add(sync, {at, rtt, offset} = sample) do
    {_best_at, best_rtt, best_offset} = best(sync, at)
    odd? = abs(offset - best_offset) > div(rtt + best_rtt, 2) + @jump_us

    cond do
      not odd? -> %{sync | samples: Enum.take([sample | sync.samples], @max_samples), odd: nil}
      sync.odd == nil -> %{sync | odd: sample}
      true -> %{sync | samples: [sample], odd: nil}
    end
  end

  defp best(sync, now) do
    Enum.min_by(sync.samples, fn {at, rtt, _offset} ->
      div(rtt, 2) + div((now - at) * @drift_per_s, 1_000_000)
    end)
  end

  @doc "Forgets all measurements: the vehicle's clock or ours is another one now."
  @spec restarted(t()) :: t()
  def restarted(sync), do: %{new(sync.period) | foreign: sync.foreign}

  @doc "Our clock was set by `step` (us), and the measured offsets change by it."
  @spec shifted(t(), integer()) :: t()
  def shifted(sync, step) do
    move = fn {at, rtt, offset} -> {at + step, rtt, offset - step} end

    %{
      sync
      | pending: %{},
        next: sync.next && sync.next + step,
        answered: nil,
        samples: Enum.map(sync.samples, move),
        odd: sync.odd && move.(sync.odd)
    }
  end

  @doc "The vehicle's clock minus ours at `now`, and its largest error (us); nil before the first answer."
  @spec offset(t(), integer()) :: {offset_us :: integer(), error_us :: non_neg_integer()} | nil
  def offset(%{samples: []}, _now), do: nil

  def offset(sync, now) do
    {at, rtt, offset} = best(sync, now)
    {offset, div(rtt, 2) + div(max(now - at, 0) * @drift_per_s, 1_000_000)}
  end

  @fields Object.fields([
            {:offset_s, {:seconds, 6}, "s", "the vehicle's clock minus the gateway's", :offset_us},
            {:error_s, {:seconds, 6}, "s", "largest error of its clock's known offset",
             from: :error_us, metric: "gateway_vehicle_clock_error_seconds"},
            {:round_trip_s, {:seconds, 6}, "s", "shortest round trip of the latest measurements of its clock",
             from: :rtt_us, metric: "gateway_vehicle_round_trip_seconds"},
            {:boot, :time, nil, "the time at which the clock was 0", :boot_at},
            {:time, :time, nil, "time of the last answer", :at},
            {:samples, :integer, nil, "number of measurements"}
          ])

  @doc "What people are shown of `show/2`."
  @spec fields() :: [Object.t()]
  def fields, do: @fields

  @doc "For the snapshot, in microseconds. The measurements are nil before the first answer."
  @spec show(t(), integer()) :: map()
  def show(%{samples: []} = sync, _now) do
    %{offset_us: nil, error_us: nil, rtt_us: nil, boot_at: nil, at: nil, samples: 0, foreign: sync.foreign}
  end

  def show(%{samples: [{last, _, _} | _] = samples} = sync, now) do
    {offset, error} = offset(sync, now)
    {_at, rtt, _offset} = best(sync, now)

    %{
      offset_us: offset,
      error_us: error,
      rtt_us: rtt,
      boot_at: -offset,
      at: last,
      samples: length(samples),
      foreign: sync.foreign
    }
  end

  @doc """
  Our answer at `now` (unix us) to a request: TIMESYNC with `tc1` 0, or PING without a target (X5). nil for anything
  else, and for a request to another target than `own`.
  """
  @spec answer(struct(), from :: {integer(), integer()}, own :: {integer(), integer()}, integer()) ::
          struct() | nil
  def answer(%Timesync{tc1: 0} = request, {system, component}, own, now) do
    if to?(request, own),
      do: %Timesync{tc1: now * 1000, ts1: request.ts1, target_system: system, target_component: component}
  end

  def answer(%Ping{target_system: 0, target_component: 0} = request, {system, component}, _own, _now) do
    %{request | target_system: system, target_component: component}
  end

  def answer(_no_request, _from, _own, _now), do: nil

  @doc "Whether a TIMESYNC message may be for us: newer firmware sets the target."
  @spec to?(Timesync.t(), own :: {integer(), integer()}) :: boolean()
  def to?(%Timesync{target_system: system, target_component: component}, {own_system, own_component}),
    do: system in [0, own_system] and component in [0, own_component]

  @doc "Whether to answer a request that came `at`: at most ten a second are answered."
  @spec answer?(t(), integer()) :: {boolean(), t()}
  def answer?(%{answered: last} = sync, at) when last != nil and at - last < @answers_us and at >= last,
    do: {false, sync}

  def answer?(sync, at), do: {true, %{sync | answered: at}}
end
