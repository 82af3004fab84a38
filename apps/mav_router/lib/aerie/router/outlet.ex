defmodule Aerie.Router.Outlet do
  @moduledoc """
  What waits for one endpoint, and when how much of it may go: a queue by class behind a budget. A value, for the process
  that writes.

      {outlet, dropped} = Outlet.push(outlet, :state, frames, now)

      case Outlet.next(outlet, now) do
        {:send, bytes, rest} -> if(write(bytes) == :ok, do: rest, else: outlet)
        {:wait, ms} -> outlet
        :empty -> outlet
      end

  What could not be written stays where it was, because the outlet that still has it is kept. Times are monotonic ms.
  """

  alias Aerie.Router.Budget
  alias Aerie.Router.Classify
  alias Aerie.Router.Queue

  # Bytes of one write.
  @chunk 16_384

  @enforce_keys [:queue, :chunk]
  defstruct [:queue, :chunk, :budget]

  @type t :: %__MODULE__{queue: Queue.t(), chunk: pos_integer, budget: Budget.t() | nil}

  @doc "Options: `:queue` (those of `Queue.new/1`), `:bytes_per_s` (no budget: none), `:chunk` (bytes of one write, 16 KiB)."
  @spec new(keyword, integer) :: t
  def new(options, now) do
    budget = if options[:bytes_per_s], do: Budget.new(options[:bytes_per_s], now)
    %__MODULE__{queue: Queue.new(options[:queue] || []), chunk: options[:chunk] || @chunk, budget: budget}
  end

  @doc "Other rules for what waits already; as much of it as has room stays."
  @spec rules(t, keyword, integer) :: {t, Queue.dropped()}
  def rules(outlet, options, now) do
    fresh = new(options, now)

    budget =
      if fresh.budget && outlet.budget, do: %{fresh.budget | factor: outlet.budget.factor}, else: fresh.budget

    {queue, dropped} = Queue.resize(outlet.queue, options[:queue] || [])
    {%{fresh | queue: queue, budget: budget}, dropped}
  end

  @doc "Whether frames may be written at once, because nothing waits and nothing is rationed."
  @spec free?(t) :: boolean
  def free?(%__MODULE__{budget: nil, queue: %{frames: 0}}), do: true
  def free?(_outlet), do: false

  @doc "Notes what of these frames, which the other end said, asks for something (`Aerie.Router.Asked`); whether any does."
  @spec asked(t, [MavCodec.Frame.t()], integer) :: {boolean, t}
  def asked(outlet, frames, now) do
    {any?, queue} = Queue.asked(outlet.queue, frames, now)
    {any?, if(any?, do: %{outlet | queue: queue}, else: outlet)}
  end

  @doc "Frames of a class were written at once."
  @spec passed(t, Classify.class(), [binary], integer) :: t
  def passed(outlet, class, frames, now),
    do: %{outlet | queue: Queue.passed(outlet.queue, class, frames, now)}

  @doc "Adds frames; what had to go, by class."
  @spec push(t, Classify.class(), [binary], integer) :: {t, Queue.dropped()}
  def push(outlet, class, frames, now) do
    {queue, dropped} = Queue.push(outlet.queue, class, frames, now)
    {%{outlet | queue: queue}, dropped}
  end

  @doc "What may be written now: bytes of whole frames, and the outlet without them."
  @spec next(t, integer) :: {:send, iodata, t} | {:wait, pos_integer} | :empty
  def next(%__MODULE__{queue: %{frames: 0}}, _now), do: :empty

  def next(outlet, now) do
    outlet = %{outlet | budget: outlet.budget && Budget.fill(outlet.budget, now)}

    case take(outlet, now, [], 0) do
      {[], outlet} -> {:wait, max(Budget.wait_ms(outlet.budget), 1)}
      {frames, outlet} -> {:send, Enum.reverse(frames), outlet}
    end
  end

  defp take(outlet, now, frames, size) do
    with true <- outlet.budget == nil or Budget.open?(outlet.budget),
         {_class, frame} <- Queue.next(outlet.queue, now),
         true <- frames == [] or size + byte_size(frame) <= outlet.chunk do
      {_same, queue} = Queue.pop(outlet.queue, now)
      budget = outlet.budget && Budget.spend(outlet.budget, byte_size(frame))
      take(%{outlet | queue: queue, budget: budget}, now, [frame | frames], size + byte_size(frame))
    else
      _enough -> {frames, outlet}
    end
  end

  @doc "The radio's report (RADIO_STATUS.txbuf, %)."
  @spec radio(t, non_neg_integer) :: t
  def radio(%__MODULE__{budget: nil} = outlet, _txbuf), do: outlet
  def radio(outlet, txbuf), do: %{outlet | budget: Budget.radio(outlet.budget, txbuf)}
end
