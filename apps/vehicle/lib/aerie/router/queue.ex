defmodule Aerie.Router.Queue do
  @moduledoc """
  Frames that wait for an endpoint: bounded, by class. When it is full the oldest frame of the least important class that
  waits gives way, which may be the newcomer. The most important class goes out first; within a class nothing overtakes.

  So that a busy class does not stop those below it for ever, a frame that waited for #{1_000} ms is next, one at a time.
  """

  alias Aerie.Router.Classify

  @starved_ms 1_000

  defstruct max_frames: 1_000,
            max_bytes: 262_144,
            frames: 0,
            bytes: 0,
            waiting: Map.new(Classify.classes(), &{&1, :queue.new()})

  @type t :: %__MODULE__{
          max_frames: pos_integer,
          max_bytes: pos_integer,
          frames: non_neg_integer,
          bytes: non_neg_integer,
          waiting: %{Classify.class() => :queue.queue({integer, binary})}
        }

  @type dropped :: %{optional(Classify.class()) => pos_integer}

  @doc "An empty queue. Options: `:max_frames` (1000), `:max_bytes` (256 KiB)."
  @spec new(keyword) :: t
  def new(options \\ []), do: struct!(__MODULE__, options)

  @doc "Adds frames of one class at `now` (monotonic ms); what had to go, by class."
  @spec push(t, Classify.class(), [binary], integer) :: {t, dropped}
  def push(%__MODULE__{} = queue, class, frames, now) do
    Enum.reduce(frames, {queue, %{}}, fn frame, {queue, dropped} ->
      queue |> put(class, {now, own(frame)}) |> shrink(dropped)
    end)
  end

  # What waits must not keep the whole read alive that it is a part of.
  defp own(frame) do
    if :binary.referenced_byte_size(frame) > 4 * byte_size(frame), do: :binary.copy(frame), else: frame
  end

  defp put(queue, class, {_at, frame} = item) do
    waiting = Map.update!(queue.waiting, class, &:queue.in(item, &1))
    %{queue | waiting: waiting, frames: queue.frames + 1, bytes: queue.bytes + byte_size(frame)}
  end

  defp shrink(%{frames: frames, bytes: bytes} = queue, dropped)
       when frames <= queue.max_frames and bytes <= queue.max_bytes,
       do: {queue, dropped}

  defp shrink(queue, dropped) do
    class = Classify.classes() |> Enum.reverse() |> Enum.find(&(not :queue.is_empty(queue.waiting[&1])))
    {_frame, queue} = take(queue, class)
    shrink(queue, Map.update(dropped, class, 1, &(&1 + 1)))
  end

  @doc "Other limits; what had to go, by class."
  @spec resize(t, keyword) :: {t, dropped}
  def resize(queue, limits), do: queue |> struct!(limits) |> shrink(%{})

  @doc "The next frame at `now` and its class, nil when none waits."
  @spec next(t, integer) :: {Classify.class(), binary} | nil
  def next(%__MODULE__{frames: 0}, _now), do: nil

  def next(queue, now) do
    class = turn(queue, now)
    {_at, frame} = :queue.get(queue.waiting[class])
    {class, frame}
  end

  @doc "Takes the next frame out."
  @spec pop(t, integer) :: {{Classify.class(), binary}, t} | nil
  def pop(%__MODULE__{frames: 0}, _now), do: nil

  def pop(queue, now) do
    class = turn(queue, now)
    {frame, queue} = take(queue, class)
    {{class, frame}, queue}
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

  defp turn(queue, now) do
    waiting = Enum.reject(Classify.classes(), &:queue.is_empty(queue.waiting[&1]))
    Enum.find(Enum.reverse(waiting), hd(waiting), &starved?(queue.waiting[&1], now))
  end

  defp starved?(waiting, now) do
    {at, _frame} = :queue.get(waiting)
    now - at >= @starved_ms
  end

  @doc "How many frames wait, by class."
  @spec depth(t) :: %{Classify.class() => non_neg_integer}
  def depth(queue), do: Map.new(queue.waiting, fn {class, waiting} -> {class, :queue.len(waiting)} end)
end
