defmodule Aerie.Control.Logs.Download do
  @moduledoc """
  Downloads one log (LOG_REQUEST_DATA, X1). Pure: `handle(download, event) -> {download, actions}`.

  The log is requested in windows of 256 packets of 90 bytes. Lost packets of a window are requested again before the next window:
  while there are many, everything from the first gap to the last, then gap by gap.

  Events, with the time `now` in microseconds of a clock that is never set:

    * `{:start, now}`, `{:cancel, now}`
    * `{:message, message, {system, component}, now}`
    * `{:rebooted, now}` - ends it: PX4's ids are indices of a list that may have changed. List the logs again, and
      continue at `offset/1`
    * `{:tick, now}` - at `wake_at/1` at the latest

  Actions, in order: `{:send, messages}`; `{:data, offset, bytes}`, each byte once; `{:progress, done, total}` in bytes, with
  every window; `{:done, {:ok, size} | {:error, reason}}` once.
  """

  alias Aerie.Control.Ftp.{Ranges, RoundTrip}
  alias Aerie.Control.Transfers.Spool
  alias MavCodec.Messages, as: M

  @piece 90
  @window 256 * @piece
  @few 4
  @repeats 24
  @first_repeats 8
  @silence RoundTrip.silence()

  @enforce_keys [:id, :size, :target, :deadline, :trip, :ranges, :max_bytes]
  defstruct [
    :id,
    :size,
    :target,
    :deadline,
    :trip,
    :ranges,
    :max_bytes,
    :due,
    :asked_at,
    :since,
    request: {0, 0},
    repeats: 0,
    heard?: false,
    phase: :idle
  ]

  @type t :: %__MODULE__{}

  @typedoc "`:too_large`: more than `:max_bytes`"
  @type reason :: :no_answer | :rebooted | :too_large | :deadline | :cancelled
  @type event ::
          {:start | :cancel | :tick | :rebooted, integer()}
          | {:message, struct(), {non_neg_integer(), 0..255}, integer()}
  @type action ::
          {:send, [struct(), ...]}
          | {:data, non_neg_integer(), binary()}
          | {:progress, non_neg_integer(), non_neg_integer()}
          | {:done, {:ok, term()} | {:error, term()}}

  @doc """
  A download of a log of `Aerie.Control.Logs.List` that has not begun. Options: `:offset` (where to continue), `:max_bytes`
  (that of `Aerie.Control.Transfers.Spool`), `:rtt_us`.
  """
  @spec new(Aerie.Control.Logs.List.entry(), {non_neg_integer(), 0..255}, deadline :: integer(), keyword()) ::
          t()
  def new(entry, target, deadline, options \\ []) do
    %__MODULE__{
      id: entry.id,
      size: entry.size,
      target: target,
      deadline: deadline,
      trip: RoundTrip.new(options[:rtt_us]),
      ranges: Ranges.new(Keyword.get(options, :offset, 0)),
      max_bytes: Keyword.get(options, :max_bytes, Spool.max_bytes())
    }
  end

  @doc "When `{:tick, now}` has to come, nil for never."
  @spec wake_at(t()) :: integer() | nil
  def wake_at(%{phase: :asked} = d), do: min(d.due, d.deadline)
  def wake_at(_download), do: nil

  @doc "The number of bytes from the beginning without a gap: where another download can continue."
  @spec offset(t()) :: non_neg_integer()
  def offset(d), do: Ranges.contiguous(d.ranges)

  @spec handle(t(), event()) :: {t(), [action()]}
  def handle(%{phase: :done} = d, _event), do: {d, []}
  def handle(d, {:cancel, _now}), do: finish(d, {:error, :cancelled})
  def handle(d, {:rebooted, _now}), do: finish(d, {:error, :rebooted})

  def handle(%{deadline: deadline} = d, {_event, now}) when now >= deadline,
    do: finish(d, {:error, :deadline})

  def handle(%{phase: :idle, size: size, max_bytes: max} = d, {:start, _now}) when size > max,
    do: finish(d, {:error, :too_large})

  def handle(%{phase: :idle} = d, {:start, now}), do: next(%{d | phase: :asked, since: now}, now)
  def handle(%{phase: :asked, due: due} = d, {:tick, now}) when now >= due, do: late(d, now)

  def handle(
        %{phase: :asked, target: from, id: id} = d,
        {:message, %M.LogData{id: id, count: count} = m, from, now}
      )
      when count <= @piece,
      do: took(d, m, now)

  def handle(d, _other), do: {d, []}

  defp took(d, m, now) do
    to = min(m.ofs + m.count, d.size)
    gaps = for {a, b} <- Ranges.gaps(d.ranges, to), b > m.ofs, do: {max(a, m.ofs), b}
    data = for {a, b} <- gaps, do: {:data, a, binary_part(m.data, a - m.ofs, b - a)}
    {from, stop} = d.request

    trip =
      if d.repeats == 0 and m.ofs == from and d.asked_at,
        do: RoundTrip.sample(d.trip, now - d.asked_at),
        else: d.trip

    # A short packet is the end, even if the list gave a larger size.
    ends? = m.count < @piece and m.ofs + m.count < min(stop, d.size) and m.ofs >= from
    size = if ends?, do: max(m.ofs + m.count, Ranges.top(d.ranges)), else: d.size
    d = %{d | ranges: Ranges.add(d.ranges, m.ofs, to), size: size, trip: trip, repeats: 0, heard?: true}

    {d, more} =
      if ends? or to >= min(stop, size),
        do: next(d, now),
        else: {%{d | due: now + RoundTrip.timeout(d.trip)}, []}

    {d, data ++ more}
  end

  defp late(%{repeats: @repeats} = d, _now), do: finish(d, {:error, :no_answer})

  defp late(%{repeats: repeats, heard?: false, since: since} = d, now)
       when repeats >= @first_repeats and now - since >= @silence,
       do: finish(d, {:error, :no_answer})

  defp late(d, now), do: next(%{d | repeats: d.repeats + 1}, now)

  defp next(d, now) do
    top = Ranges.top(d.ranges)

    case Ranges.gaps(d.ranges, top) do
      [] when top >= d.size -> finish(d, {:ok, d.size})
      [] -> ask(d, top, min(top + @window, d.size), now)
      gaps when length(gaps) > @few -> ask(d, elem(hd(gaps), 0), elem(List.last(gaps), 1), now)
      [{from, to} | _rest] -> ask(d, from, to, now)
    end
  end

  defp ask(%{target: {system, component}} = d, from, to, now) do
    message = %M.LogRequestData{
      target_system: system,
      target_component: component,
      id: d.id,
      ofs: from,
      count: to - from
    }

    new? = d.request != {from, to}
    progress = if new?, do: [{:progress, Ranges.size(d.ranges), d.size}], else: []
    due = now + RoundTrip.timeout(d.trip, div(d.repeats, 4))
    {%{d | request: {from, to}, asked_at: if(new?, do: now), due: due}, progress ++ [{:send, [message]}]}
  end

  # Makes the vehicle stop sending and resume logging.
  defp finish(d, result) do
    {system, component} = d.target

    stop =
      if d.phase == :asked,
        do: [{:send, [%M.LogRequestEnd{target_system: system, target_component: component}]}],
        else: []

    {%{d | phase: :done}, stop ++ [{:done, result}]}
  end
end
