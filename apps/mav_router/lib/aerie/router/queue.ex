defmodule Aerie.Router.Queue do
  @moduledoc """
  Frames that wait for an endpoint: bounded, by class. When it is full the oldest frame of the least important class that
  waits gives way, which may be the newcomer. The most important class goes out first; within a class nothing overtakes.

  Answers to what the endpoint asked for (`Aerie.Router.Asked`) have a queue and a bound of their own and take turns, frame
  by frame, with telemetry and what is less important; when their room is full the newcomer gives way, so that what came is
  without holes up to there.

  So that a busy class does not stop those below it for ever, a frame that waited for #{1_000} ms is next, one at a time.
  """

  alias Aerie.Router.Asked
  alias Aerie.Router.Classify

  @starved_ms 1_000

  defstruct max_frames: 1_000,
            max_bytes: 262_144,
            frames: 0,
            bytes: 0,
            asked: %Asked{},
            asked_next: true,
            waiting: Map.new(Classify.classes(), &{&1, :queue.new()})

  # Classes that answers to requests are of, and those that they give way to.
  @transfers [:transfer, :bulk]
  @first [:control, :ack]

  @typedoc "`frames`: all that wait; `bytes`: without the answers in `asked`"
  @type t :: %__MODULE__{
          max_frames: pos_integer,
          max_bytes: pos_integer,
          frames: non_neg_integer,
          bytes: non_neg_integer,
          asked: Asked.t(),
          asked_next: boolean,
          waiting: %{Classify.class() => :queue.queue({integer, binary})}
        }

  @type dropped :: %{optional(Classify.class()) => pos_integer}

  @doc "An empty queue. Options: `:max_frames` (1000), `:max_bytes` (256 KiB), `:max_asked` (8 MiB)."
  @spec new(keyword) :: t
  def new(options \\ []), do: limited(%__MODULE__{}, options)

  defp limited(queue, options) do
    {asked, plain} = Keyword.split(options, [:max_asked])
    queue = struct!(queue, plain)
    %{queue | asked: %{queue.asked | max_bytes: asked[:max_asked] || queue.asked.max_bytes}}
  end

  @doc "Notes what of these frames, which the endpoint said, asks for something; whether any does."
  @spec asked(t, [MavCodec.Frame.t()], integer) :: {boolean, t}
  def asked(queue, frames, now) do
    case Asked.note(queue.asked, frames, now) do
      {true, asked} -> {true, %{queue | asked: asked}}
      {false, _same} -> {false, queue}
    end
  end

  @doc "Frames of a class were written without waiting here."
  @spec passed(t, Classify.class(), [binary], integer) :: t
  def passed(%{asked: %{until: until}} = queue, class, frames, now) when class in @transfers and until != %{},
    do: %{queue | asked: Asked.answered(queue.asked, frames, now)}

  def passed(queue, _class, _frames, _now), do: queue

  @doc "Adds frames of one class at `now` (monotonic ms); what had to go, by class."
  @spec push(t, Classify.class(), [binary], integer) :: {t, dropped}
  def push(%__MODULE__{} = queue, class, frames, now) do
    Enum.reduce(frames, {queue, %{}}, fn frame, {queue, dropped} ->
      frame = own(frame)

      case class in @transfers && Asked.push(queue.asked, frame, now) do
        {:ok, asked} -> {%{queue | asked: asked, frames: queue.frames + 1}, dropped}
        :full -> {queue, Map.update(dropped, class, 1, &(&1 + 1))}
        _other -> queue |> put(class, {now, frame}) |> shrink(dropped)
      end
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
       when frames - queue.asked.frames <= queue.max_frames and bytes <= queue.max_bytes,
       do: {queue, dropped}

  defp shrink(queue, dropped) do
    class = Classify.classes() |> Enum.reverse() |> Enum.find(&(not :queue.is_empty(queue.waiting[&1])))
    {_frame, queue} = take(queue, class)
    shrink(queue, Map.update(dropped, class, 1, &(&1 + 1)))
  end

  @doc "Other limits; what had to go, by class."
  @spec resize(t, keyword) :: {t, dropped}
  def resize(queue, limits), do: queue |> limited(limits) |> shrink(%{})

  @doc "The next frame at `now` and its class, nil when none waits."
  @spec next(t, integer) :: {Classify.class(), binary} | nil
  def next(%__MODULE__{frames: 0}, _now), do: nil

  def next(queue, now) do
    case turn(queue, now) do
      :asked -> {:transfer, Asked.peek(queue.asked)}
      class -> {class, elem(:queue.get(queue.waiting[class]), 1)}
    end
  end

  @doc "Takes the next frame out."
  @spec pop(t, integer) :: {{Classify.class(), binary}, t} | nil
  def pop(%__MODULE__{frames: 0}, _now), do: nil

  def pop(queue, now) do
    case turn(queue, now) do
      :asked ->
        {frame, asked} = Asked.pop(queue.asked)
        {{:transfer, frame}, %{queue | asked: asked, frames: queue.frames - 1, asked_next: false}}

      class ->
        {frame, queue} = take(queue, class)
        {{class, frame}, if(class in @first, do: queue, else: %{queue | asked_next: true})}
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

  defp turn(%{asked: %{frames: 0}} = queue, now), do: by_class(queue, now)
  defp turn(%{asked: %{frames: all}, frames: all}, _now), do: :asked

  defp turn(queue, now) do
    class = by_class(queue, now)
    if queue.asked_next and class not in @first, do: :asked, else: class
  end

  defp by_class(queue, now) do
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
