defmodule Aerie.Control.Params.Fetch.Download do
  @moduledoc """
  Reads the whole list of a vehicle with PARAM_REQUEST_LIST (P4), or of another component with PARAM_EXT_REQUEST_LIST (P8). Pure: `handle(download, event) -> {download, actions}`.

  The vehicle sends the list once and does not report its end. After a silence, missing parameters are requested by
  index, ten at a time, until they come. If the list changes while it is read (another count, another name at an index; P5, P7), or
  the vehicle restarts, reading begins again, at most five times. At the end PX4's `_HASH_CHECK` is read (P6): if it
  is the same as at the beginning, it belongs to the list.

  Events, with the time `now` in microseconds of any clock that is never set:

    * `{:start, now}`, `{:cancel, now}`
    * `{:message, message, {system, component}, now}`
    * `{:rebooted, now}` - the vehicle was restarted
    * `{:tick, now}` - at `wake_at/1` at the latest

  Actions, in order:

    * `{:send, messages}`
    * `{:progress, done, total}` - whenever the percentage changes
    * `{:done, {:ok, table} | {:error, reason}}` - once; see `t:reason/0`
  """

  alias Aerie.Control.Ftp.RoundTrip
  alias Aerie.Control.Params.{Message, Param, Table}

  @no_index 65_535
  @window 10
  # Requests for the list, and the time, after which silence is an answer: on a fast link five are over in seconds, for which a computer stands still.
  @lists 5
  @begins 15_000_000
  @repeats 12
  @resyncs 5
  @hash_reads 6
  @silence RoundTrip.silence()
  @strikes 2
  @silence_shortest 300_000
  @silence_longest 3_000_000
  @pause 1_000_000
  @dead 30_000_000

  @enforce_keys [:target, :encoding, :deadline, :trip]
  defstruct [
    :target,
    :encoding,
    :deadline,
    :trip,
    :due,
    :count,
    :first_hash,
    :last_hash,
    :heard_at,
    each_us: 0,
    begins_us: @begins,
    phase: :idle,
    hashed?: false,
    gap: 0,
    sent: 0,
    resyncs: 0,
    ignored: 0,
    strikes: 0,
    percent: -1,
    list: %{},
    indices: %{},
    queue: [],
    pending: %{}
  ]

  @typedoc "`ignored`: PARAM_VALUEs without a valid name or index"
  @type t :: %__MODULE__{}

  @typedoc """
    * `:no_answer` - the vehicle does not answer, or stopped answering; `{:silent, component}` - a component that is asked by PARAM_EXT
    * `{:missing, n}` - n parameters never arrived
    * `:changing` - the list changed during each attempt to read it
    * `{:too_many, n}` - the vehicle says that it has n parameters
    * `:deadline`, `:cancelled`
  """
  @type reason ::
          :no_answer
          | {:silent, 0..255}
          | {:missing, pos_integer()}
          | :changing
          | {:too_many, pos_integer()}
          | :deadline
          | :cancelled
  @type event ::
          {:start | :cancel | :rebooted | :tick, integer()}
          | {:message, struct(), {non_neg_integer(), 0..255}, integer()}
  @type action ::
          {:send, [struct(), ...]}
          | {:progress, non_neg_integer(), pos_integer()}
          | {:done, {:ok, Table.t()} | {:error, reason()}}

  @doc """
  A download that has not begun. `target` is `{system, component}`, `deadline` in the clock of the events.

  Options: `:encoding` (`t:Aerie.Vehicle.Firmware.Traits.t/0`, or `:extended` for PARAM_EXT), `:hash` (whether the firmware has `_HASH_CHECK`), `:rtt_us`,
  `:each_us` (what the deadline grows by for each parameter that the vehicle says it has), `:begins_us` (the shortest
  time for which its first parameter is waited for, 15 s).
  """
  @spec new({non_neg_integer(), 0..255}, deadline :: integer(), keyword()) :: t()
  def new(target, deadline, options \\ []) do
    %__MODULE__{
      target: target,
      encoding: Keyword.get(options, :encoding, :c_cast),
      hashed?: Keyword.get(options, :hash, false),
      deadline: deadline,
      each_us: Keyword.get(options, :each_us, 0),
      begins_us: Keyword.get(options, :begins_us, @begins),
      trip: RoundTrip.new(options[:rtt_us])
    }
  end

  @doc "When `{:tick, now}` has to come, nil for never."
  @spec wake_at(t()) :: integer() | nil
  def wake_at(%{phase: phase}) when phase in [:idle, :done], do: nil

  def wake_at(d),
    do: d.pending |> Enum.map(fn {_index, p} -> p.due end) |> Enum.min(fn -> d.due end) |> min(d.deadline)

  @spec handle(t(), event()) :: {t(), [action()]}
  def handle(%{phase: :done} = d, _event), do: {d, []}
  def handle(d, {:cancel, _now}), do: finish(d, {:error, :cancelled})

  def handle(%{deadline: deadline} = d, {_event, now}) when now >= deadline,
    do: finish(d, {:error, :deadline})

  def handle(%{phase: :idle} = d, {:start, now}), do: request_list(%{d | heard_at: now}, now)
  def handle(%{phase: :idle} = d, _early), do: {d, []}
  def handle(d, {:rebooted, now}), do: resync(d, now)
  def handle(d, {:tick, now}), do: tick(d, now)

  def handle(%{target: from} = d, {:message, message, from, now}) do
    case Message.value(message, d.encoding) do
      {:ok, param} -> receive_param(d, param, message, now)
      :garbage -> {%{d | ignored: d.ignored + 1}, []}
      :other -> {d, []}
    end
  end

  def handle(d, _other), do: {d, []}

  # --- incoming ---

  defp receive_param(d, %Param{name: "_HASH_CHECK"} = param, _message, now) do
    d = %{d | last_hash: param.value, heard_at: now}

    if d.phase == :hash,
      do: finish(d, {:ok, table(d)}),
      else: {%{d | first_hash: d.first_hash || param.value}, []}
  end

  # Not part of the list, but the answer to somebody's PARAM_SET.
  defp receive_param(d, param, %{param_index: @no_index}, _now) do
    case Map.fetch(d.indices, param.name) do
      {:ok, index} -> {%{d | list: %{d.list | index => param}}, []}
      :error -> {d, []}
    end
  end

  defp receive_param(d, param, %{param_index: index, param_count: count}, now) do
    cond do
      count > Table.max() -> finish(d, {:error, {:too_many, count}})
      index >= count -> {%{d | ignored: d.ignored + 1}, []}
      d.count not in [nil, count] or moved?(d, param.name, index) -> changed(d, now)
      true -> take(%{grown(d, count, now) | count: count, strikes: 0}, param, index, now)
    end
  end

  defp grown(%{count: nil} = d, count, now), do: %{d | deadline: max(d.deadline, now + count * d.each_us)}
  defp grown(d, _count, _now), do: d

  # A few may be late ones of the previous list.
  defp changed(%{strikes: @strikes} = d, now), do: resync(d, now)
  defp changed(d, now), do: {%{d | strikes: d.strikes + 1, heard_at: now}, []}

  defp moved?(d, name, index),
    do:
      Map.get(d.indices, name, index) != index or
        match?(%{^index => %{name: other}} when other != name, d.list)

  defp take(d, param, index, now) do
    new? = not is_map_key(d.list, index)
    {asked, pending} = Map.pop(d.pending, index)
    trip = if asked && asked.repeats == 0, do: RoundTrip.sample(d.trip, now - asked.at), else: d.trip

    d = %{
      d
      | list: Map.put(d.list, index, param),
        indices: Map.put(d.indices, param.name, index),
        pending: pending,
        trip: trip,
        gap: if(new? and d.phase == :list, do: max(d.gap, now - d.heard_at), else: d.gap),
        heard_at: now
    }

    {d, progress} = progress(d)
    {d, more} = next(d, now)
    {d, progress ++ more}
  end

  defp progress(d) do
    done = map_size(d.list)
    percent = div(done * 100, d.count)
    if percent > d.percent, do: {%{d | percent: percent}, [{:progress, done, d.count}]}, else: {d, []}
  end

  # --- what to do next ---

  defp next(d, now) when map_size(d.list) == d.count and d.phase in [:start, :list, :missing] do
    if d.hashed?,
      do: request_hash(%{d | phase: :hash, pending: %{}, queue: [], sent: 0}, now),
      else: finish(d, {:ok, table(d)})
  end

  defp next(%{phase: :missing} = d, now), do: fill(d, now)
  defp next(%{phase: :hash} = d, _now), do: {d, []}
  defp next(d, now), do: {%{d | phase: :list, due: now + silence(d)}, []}

  # The longest pause in the list so far shows how the vehicle paces it.
  defp silence(d),
    do: (4 * d.gap) |> max(RoundTrip.timeout(d.trip)) |> max(@silence_shortest) |> min(@silence_longest)

  defp tick(%{heard_at: heard, phase: phase} = d, now)
       when now - heard >= @dead and phase != :hash and (phase != :start or now - heard >= d.begins_us),
       do: finish(d, {:error, Message.silence(d.target, d.encoding)})

  defp tick(%{phase: :missing} = d, now), do: repeat(d, now)
  defp tick(%{due: due} = d, now) when now < due, do: {d, []}

  defp tick(%{phase: :start, sent: sent, heard_at: heard} = d, now)
       when sent >= @lists and now - heard >= d.begins_us,
       do: finish(d, {:error, Message.silence(d.target, d.encoding)})

  defp tick(%{phase: :start} = d, now), do: request_list(d, now)

  defp tick(%{phase: :hash, sent: sent, heard_at: heard} = d, now)
       when sent >= @hash_reads and now - heard >= @silence,
       do: finish(d, {:ok, table(%{d | first_hash: nil})})

  defp tick(%{phase: :hash} = d, now), do: request_hash(d, now)

  defp tick(%{phase: :list} = d, now) do
    missing = for index <- 0..(d.count - 1), not is_map_key(d.list, index), do: index
    fill(%{d | phase: :missing, queue: missing}, now)
  end

  defp fill(d, now) do
    {asked, queue} = Enum.split(d.queue, @window - map_size(d.pending))
    # The rest of the list may have arrived meanwhile.
    asked = Enum.reject(asked, &is_map_key(d.list, &1))

    case {asked, queue} do
      {[], [_ | _]} when map_size(d.pending) < @window -> fill(%{d | queue: queue}, now)
      {[], _queue} -> {%{d | queue: queue}, []}
      _some -> ask(%{d | queue: queue}, Enum.map(asked, &{&1, 0}), now)
    end
  end

  defp repeat(d, now) do
    case for {index, p} <- d.pending, p.due <= now, do: {index, p.repeats + 1} do
      [] -> fill(d, now)
      late -> if Enum.any?(late, &(elem(&1, 1) > @repeats)), do: give_up(d, now), else: ask(d, late, now)
    end
  end

  # The index may no longer exist, and no vehicle reports that.
  defp give_up(%{resyncs: n} = d, now) when n < @resyncs, do: resync(d, now)
  defp give_up(d, _now), do: finish(d, {:error, {:missing, d.count - map_size(d.list)}})

  defp ask(d, asked, now) do
    pending =
      for {index, repeats} <- asked, into: d.pending do
        {index, %{at: now, repeats: repeats, due: now + RoundTrip.timeout(d.trip, div(repeats, 6))}}
      end

    {%{d | pending: pending},
     [{:send, Enum.map(asked, fn {index, _n} -> Message.read(d.target, index, d.encoding) end)}]}
  end

  defp request_list(d, now) do
    hash = if d.hashed?, do: [Message.read(d.target, "_HASH_CHECK", d.encoding)], else: []
    list = Message.list(d.target, d.encoding)
    d = %{d | phase: :start, sent: d.sent + 1, due: now + RoundTrip.timeout(d.trip, d.sent) + @pause}
    {d, [{:send, hash ++ [list]}]}
  end

  defp request_hash(d, now) do
    d = %{d | sent: d.sent + 1, due: now + RoundTrip.timeout(d.trip, min(d.sent, 1))}
    {d, [{:send, [Message.read(d.target, "_HASH_CHECK", d.encoding)]}]}
  end

  defp resync(%{resyncs: @resyncs} = d, _now), do: finish(d, {:error, :changing})

  defp resync(d, now) do
    request_list(
      %{
        d
        | resyncs: d.resyncs + 1,
          count: nil,
          first_hash: nil,
          last_hash: nil,
          gap: 0,
          strikes: 0,
          sent: 0,
          percent: -1,
          list: %{},
          indices: %{},
          queue: [],
          pending: %{}
      },
      now
    )
  end

  defp table(d) do
    hash = if d.phase == :hash and d.first_hash == d.last_hash, do: d.last_hash
    d.list |> Enum.sort() |> Enum.map(fn {_index, param} -> param end) |> Table.new(hash: hash)
  end

  defp finish(d, result), do: {%{d | phase: :done, pending: %{}, queue: []}, [{:done, result}]}
end
