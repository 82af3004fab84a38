defmodule MavRouter.Endpoints.Queue.ClassQueue do
  @starved_ms 1_000

  @moduledoc """
  Frames that wait for an endpoint: bounded, by class. When the queue is full it drops the oldest frame of the least important
  class, which may be the new one. The most important class goes out first, and the frames of a class stay in order.

  Data that the endpoint requested (`MavRouter.Endpoints.Queue.RequestedData`) has a queue and a bound of its own, and
  takes turns, frame by frame, with telemetry and what is less important. When its queue is full it drops the new
  frame, so that the data has no gap up to there.

  So that a busy class does not stop those below it for ever, a frame that has waited for #{@starved_ms} ms is next, one at a time.
  """

  alias MavRouter.Endpoints.Queue.RequestedData
  alias MavRouter.Endpoints.Queue.TrafficClass

  defstruct max_frames: 1_000,
            max_bytes: 262_144,
            frames: 0,
            bytes: 0,
            requested: %RequestedData{},
            requested_next: true,
            waiting: Map.new(TrafficClass.classes(), &{&1, :queue.new()})

  # The classes of requested data, and those that go before it.
  @transfers [:transfer, :bulk]
  @first [:control, :ack]

  @typedoc "`frames`: all that wait; `bytes`: of all but `requested`"
  @type t :: %__MODULE__{
          max_frames: pos_integer,
          max_bytes: pos_integer,
          frames: non_neg_integer,
          bytes: non_neg_integer,
          requested: RequestedData.t(),
          requested_next: boolean,
          waiting: %{TrafficClass.class() => :queue.queue({integer, binary})}
        }

  @type dropped :: %{optional(TrafficClass.class()) => pos_integer}

  @doc "An empty queue. Options: `:max_frames` (1000), `:max_bytes` (256 KiB), `:max_asked` (8 MiB)."
  @spec new(keyword) :: t
  def new(options \\ []), do: limited(%__MODULE__{}, options)

  defp limited(queue, options) do
    {requested, plain} = Keyword.split(options, [:max_asked])
    queue = struct!(queue, plain)
    %{queue | requested: %{queue.requested | max_bytes: requested[:max_asked] || queue.requested.max_bytes}}
  end

  @doc "Notes the requests among frames from the endpoint; whether there are any."
  @spec request(t, [MavCodec.Frame.t()], integer) :: {boolean, t}
  def request(queue, frames, now) do
    case RequestedData.note(queue.requested, frames, now) do
      {true, requested} -> {true, %{queue | requested: requested}}
      {false, _same} -> {false, queue}
    end
  end

  @doc "Frames of a class were written without waiting."
  @spec passed(t, TrafficClass.class(), [binary], integer) :: t
  def passed(%{requested: %{until: until}} = queue, class, frames, now)
      when class in @transfers and until != %{},
      do: %{queue | requested: RequestedData.answered(queue.requested, frames, now)}

  def passed(queue, _class, _frames, _now), do: queue

  @doc "Adds frames of one class at `now` (monotonic ms); gives how many were dropped, by class."
  @spec push(t, TrafficClass.class(), [binary], integer) :: {t, dropped}
  def push(%__MODULE__{} = queue, class, frames, now) do
    Enum.reduce(frames, {queue, %{}}, fn frame, {queue, dropped} ->
      frame = own(frame)

      case class in @transfers && RequestedData.push(queue.requested, frame, now) do
        {:ok, requested} -> {%{queue | requested: requested, frames: queue.frames + 1}, dropped}
        :full -> {queue, Map.update(dropped, class, 1, &(&1 + 1))}
        _other -> queue |> put(class, {now, frame}) |> shrink(dropped)
      end
    end)
  end

  # A frame that waits must not keep the whole read in memory.
  defp own(frame) do
    if :binary.referenced_byte_size(frame) > 4 * byte_size(frame), do: :binary.copy(frame), else: frame
  end

  defp put(queue, class, {_at, frame} = item) do
    waiting = Map.update!(queue.waiting, class, &:queue.in(item, &1))
    %{queue | waiting: waiting, frames: queue.frames + 1, bytes: queue.bytes + byte_size(frame)}
  end

  defp shrink(%{frames: frames, bytes: bytes} = queue, dropped)
       when frames - queue.requested.frames <= queue.max_frames and bytes <= queue.max_bytes,
       do: {queue, dropped}

  defp shrink(queue, dropped) do
    class = TrafficClass.classes() |> Enum.reverse() |> Enum.find(&(not :queue.is_empty(queue.waiting[&1])))
    {_frame, queue} = take(queue, class)
    shrink(queue, Map.update(dropped, class, 1, &(&1 + 1)))
  end

  @doc "Sets other limits; gives how many were dropped, by class."
  @spec resize(t, keyword) :: {t, dropped}
  def resize(queue, limits), do: queue |> limited(limits) |> shrink(%{})

  @doc "The next frame at `now` and its class, nil when none waits."
  @spec next(t, integer) :: {TrafficClass.class(), binary} | nil
  def next(%__MODULE__{frames: 0}, _now), do: nil

  def next(queue, now) do
    case turn(queue, now) do
      :requested -> {:transfer, RequestedData.peek(queue.requested)}
      class -> {class, elem(:queue.get(queue.waiting[class]), 1)}
    end
  end

  @doc "Takes the next frame out."
  @spec pop(t, integer) :: {{TrafficClass.class(), binary}, t} | nil
  def pop(%__MODULE__{frames: 0}, _now), do: nil

  def pop(queue, now) do
    case turn(queue, now) do
      :requested ->
        {frame, requested} = RequestedData.pop(queue.requested)
        {{:transfer, frame}, %{queue | requested: requested, frames: queue.frames - 1, requested_next: false}}

      class ->
        {frame, queue} = take(queue, class)
        {{class, frame}, if(class in @first, do: queue, else: %{queue | requested_next: true})}
    end
  end

  defp take(queue, class) do
    {{:value, {_at, frame}}, rest} = :queue.out(queue.waiting[class])

    {frame,
     %{
       queue
       | waiting: %{queue.waiting | class => rest},
         frames: queue.frames - 1,
         bytes: queue.bytes - byte_size(frame)
     }}
  end

  defp turn(%{requested: %{frames: 0}} = queue, now), do: by_class(queue, now)
  defp turn(%{requested: %{frames: all}, frames: all}, _now), do: :requested

  defp turn(queue, now) do
    class = by_class(queue, now)
    if queue.requested_next and class not in @first, do: :requested, else: class
  end

  defp by_class(queue, now) do
    waiting = Enum.reject(TrafficClass.classes(), &:queue.is_empty(queue.waiting[&1]))
    Enum.find(Enum.reverse(waiting), hd(waiting), &starved?(queue.waiting[&1], now))
  end

  defp starved?(waiting, now) do
    {at, _frame} = :queue.get(waiting)
    now - at >= @starved_ms
  end
end
