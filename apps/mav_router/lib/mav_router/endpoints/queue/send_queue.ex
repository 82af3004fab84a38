defmodule MavRouter.Endpoints.Queue.SendQueue do
  # Bytes of one write.
  @chunk 16_384

  @moduledoc """
  The frames that wait for one endpoint, and how many may go out when: a queue by class
  (`MavRouter.Endpoints.Queue.ClassQueue`) behind a budget (`MavRouter.Endpoints.Queue.Budget`). A value, for the
  process that writes.

      {send_queue, dropped} = SendQueue.push(send_queue, :state, frames, now)

      case SendQueue.next(send_queue, now) do
        {:send, bytes, rest} -> if(write(bytes) == :ok, do: rest, else: send_queue)
        {:wait, ms} -> send_queue
        :empty -> send_queue
      end

  Frames that could not be written are not lost, because the queue that still has them is kept. Times are monotonic ms.
  """

  alias MavRouter.Endpoints.Queue.Budget
  alias MavRouter.Endpoints.Queue.TrafficClass
  alias MavRouter.Endpoints.Queue.ClassQueue

  @enforce_keys [:queue, :chunk]
  defstruct [:queue, :chunk, :budget]

  @type t :: %__MODULE__{queue: ClassQueue.t(), chunk: pos_integer, budget: Budget.t() | nil}

  @doc "Options: `:queue` (those of `ClassQueue.new/1`), `:bytes_per_s` (none: no budget), `:chunk` (bytes of one write, #{@chunk})."
  @spec new(keyword, integer) :: t
  def new(options, now) do
    budget = if options[:bytes_per_s], do: Budget.new(options[:bytes_per_s], now)

    %__MODULE__{
      queue: ClassQueue.new(options[:queue] || []),
      chunk: options[:chunk] || @chunk,
      budget: budget
    }
  end

  @doc "Sets other rules; the frames that have room stay. Gives how many were dropped, by class."
  @spec rules(t, keyword, integer) :: {t, ClassQueue.dropped()}
  def rules(send_queue, options, now) do
    fresh = new(options, now)

    budget =
      if fresh.budget && send_queue.budget,
        do: %{fresh.budget | factor: send_queue.budget.factor},
        else: fresh.budget

    {queue, dropped} = ClassQueue.resize(send_queue.queue, options[:queue] || [])
    {%{fresh | queue: queue, budget: budget}, dropped}
  end

  @doc "Whether frames may be written at once: nothing waits, and there is no budget."
  @spec free?(t) :: boolean
  def free?(%__MODULE__{budget: nil, queue: %{frames: 0}}), do: true
  def free?(_send_queue), do: false

  @doc "Notes the requests among frames from the other end (`MavRouter.Endpoints.Queue.RequestedData`); whether there are any."
  @spec request(t, [MavCodec.Frame.t()], integer) :: {boolean, t}
  def request(send_queue, frames, now) do
    {any?, queue} = ClassQueue.request(send_queue.queue, frames, now)
    {any?, if(any?, do: %{send_queue | queue: queue}, else: send_queue)}
  end

  @doc "Frames of a class were written at once."
  @spec passed(t, TrafficClass.class(), [binary], integer) :: t
  def passed(send_queue, class, frames, now),
    do: %{send_queue | queue: ClassQueue.passed(send_queue.queue, class, frames, now)}

  @doc "Adds frames; gives how many were dropped, by class."
  @spec push(t, TrafficClass.class(), [binary], integer) :: {t, ClassQueue.dropped()}
  def push(send_queue, class, frames, now) do
    {queue, dropped} = ClassQueue.push(send_queue.queue, class, frames, now)
    {%{send_queue | queue: queue}, dropped}
  end

  @doc "The whole frames that may be written now, and the queue without them; else how long to wait."
  @spec next(t, integer) :: {:send, iodata, t} | {:wait, pos_integer} | :empty
  def next(%__MODULE__{queue: %{frames: 0}}, _now), do: :empty

  def next(send_queue, now) do
    send_queue = %{send_queue | budget: send_queue.budget && Budget.fill(send_queue.budget, now)}

    case take(send_queue, now, [], 0) do
      {[], send_queue} -> {:wait, max(Budget.wait_ms(send_queue.budget), 1)}
      {frames, send_queue} -> {:send, Enum.reverse(frames), send_queue}
    end
  end

  defp take(send_queue, now, frames, size) do
    with true <- send_queue.budget == nil or Budget.open?(send_queue.budget),
         {_class, frame} <- ClassQueue.next(send_queue.queue, now),
         true <- frames == [] or size + byte_size(frame) <= send_queue.chunk do
      {_same, queue} = ClassQueue.pop(send_queue.queue, now)
      budget = send_queue.budget && Budget.spend(send_queue.budget, byte_size(frame))
      take(%{send_queue | queue: queue, budget: budget}, now, [frame | frames], size + byte_size(frame))
    else
      _enough -> {frames, send_queue}
    end
  end

  @doc "The radio's report (RADIO_STATUS.txbuf, %)."
  @spec radio(t, non_neg_integer, integer) :: t
  def radio(%__MODULE__{budget: nil} = send_queue, _txbuf, _now), do: send_queue
  def radio(send_queue, txbuf, now), do: %{send_queue | budget: Budget.radio(send_queue.budget, txbuf, now)}
end
