defmodule Msp.Exchange do
  @first_us 1_000_000
  @least_us 250_000
  @most_us 3_000_000
  @gap_us 10_000
  @overdue_us 50_000
  @remembered_us 6_000_000

  @moduledoc """
  Requests and replies on one line (Q2): one request at a time, its reply recognised by the id, patience by the time that replies take.

  There are two lanes, `:state` for polls and `:task` for the rest. While the reply of one is overdue (twice the usual
  time, #{div(@overdue_us, 1000)} ms at least), it is most likely lost, and the other lane goes on: nothing that somebody
  asks keeps the vehicle's state from coming.

  A late reply tells how long replies take. It is given to the caller as such. If its request had arguments, the same
  message waits with other ones until the late reply cannot come any more: nothing in it says to which arguments it
  belongs. Flight controllers handle one request in #{div(@gap_us, 1000)} ms.
  """

  alias MavCodec.Msp.{Frame, Parser}

  # For how many times the usual time of a reply a late one may still come.
  @late 3

  defstruct parser: Parser.new(),
            asked: %{},
            sent_at: nil,
            usual_us: nil,
            late: %{},
            counters: %{requests: 0, replies: 0, refused: 0, timeouts: 0, late: 0, unasked: 0}

  @typedoc """
  - `asked`: by lane the request that waits for its reply: its name for the caller, its frame, when it was sent, and
    until when it waits
  - `usual_us`: how long replies take, a moving mean
  - `late`: by id the oldest request whose reply may still come: its name, payload, when it was sent, and until when
    others wait
  """
  @type t :: %__MODULE__{}
  @type lane :: :state | :task
  @type answer ::
          {:reply, tag :: term, Frame.t()}
          | {:refused, tag :: term}
          | {:late, tag :: term, Frame.t(), sent_at :: integer}
          | {:unasked, Frame.t()}

  @doc "An exchange on a line that was just opened."
  @spec new() :: t
  def new, do: %__MODULE__{}

  @doc "Whether this request may be sent now; if not, the earliest time for it."
  @spec ready(t, lane, Frame.t(), integer) :: :now | {:at, integer} | :busy
  def ready(exchange, lane, %{id: id, payload: payload}, now) do
    gap = if exchange.sent_at, do: exchange.sent_at + @gap_us, else: now
    free = free_at(exchange, lane, now)

    late =
      case exchange.late do
        %{^id => %{payload: other, until: until}} when other != payload -> until
        _none -> now
      end

    cond do
      free == nil or Enum.any?(exchange.asked, fn {_lane, asked} -> asked.frame.id == id end) -> :busy
      Enum.max([gap, late, free]) <= now -> :now
      true -> {:at, Enum.max([gap, late, free])}
    end
  end

  @doc "From when on a lane has room for a request; nil while it waits for a reply itself."
  @spec free_at(t, lane, integer) :: integer | nil
  def free_at(%{asked: asked} = exchange, lane, now) do
    cond do
      is_map_key(asked, lane) -> nil
      asked == %{} -> now
      true -> Enum.max(for {_lane, %{sent_at: at}} <- asked, do: at) + overdue_us(exchange)
    end
  end

  defp overdue_us(%{usual_us: nil}), do: @least_us
  defp overdue_us(%{usual_us: usual}), do: max(2 * usual, @overdue_us)

  @doc "When the next of those that wait is over; nil if none waits."
  @spec deadline(t) :: integer | nil
  def deadline(%{asked: asked}), do: Enum.min(for({_lane, %{until: at}} <- asked, do: at), fn -> nil end)

  @doc "Sends a request; `tag` names it in its answer. `patience_us`: how long it may take at least."
  @spec send(t, lane, tag :: term, Frame.t(), integer, patience_us :: non_neg_integer) :: {binary, t}
  def send(exchange, lane, tag, frame, now, patience_us \\ @least_us)
      when not is_map_key(exchange.asked, lane) do
    asked = %{tag: tag, frame: frame, sent_at: now, until: now + max(timeout_us(exchange), patience_us)}
    exchange = %{exchange | asked: Map.put(exchange.asked, lane, asked), sent_at: now}
    {Frame.encode(frame), count(exchange, :requests)}
  end

  @doc "How long a reply may take: four times the usual time, but no more than a second or twice that time."
  @spec timeout_us(t) :: pos_integer
  def timeout_us(%{usual_us: nil}), do: @first_us

  def timeout_us(%{usual_us: usual}) when is_integer(usual),
    do: (4 * usual) |> min(max(@first_us, 2 * usual)) |> min(@most_us)

  @doc "Bytes from the line."
  @spec push(t, binary, integer) :: {[answer], t}
  def push(exchange, bytes, now) do
    {frames, parser} = Parser.push(exchange.parser, bytes)
    answers(frames, %{exchange | parser: parser}, now)
  end

  defp answers(frames, exchange, now), do: Enum.map_reduce(frames, exchange, &answer(&1, &2, now))

  defp answer(%Frame{direction: :request} = frame, exchange, _now), do: unasked(frame, exchange)

  defp answer(%Frame{id: id} = frame, exchange, now) do
    late = exchange.late[id]

    case Enum.find(exchange.asked, fn {_lane, asked} -> asked.frame.id == id end) do
      {lane, asked} ->
        took = now - since(exchange, asked, late, now)
        exchange = measure(%{exchange | asked: Map.delete(exchange.asked, lane)}, took)
        replied(frame, asked.tag, %{exchange | late: Map.delete(exchange.late, id)})

      nil when late != nil and now - late.sent_at <= @remembered_us ->
        exchange = %{exchange | usual_us: max(exchange.usual_us || 0, now - late.sent_at)}
        exchange = count(%{exchange | late: Map.delete(exchange.late, id)}, :late)
        {{:late, late.tag, frame, late.sent_at}, exchange}

      nil ->
        unasked(frame, exchange)
    end
  end

  # Unless it comes as soon as usual it may be that of the one before, which was not lost: replies come in the order of requests.
  defp since(_exchange, asked, nil, _now), do: asked.sent_at

  defp since(%{usual_us: usual}, asked, late, now) do
    soon? = usual != nil and now - asked.sent_at <= 2 * usual
    if soon? or now - late.sent_at > @remembered_us, do: asked.sent_at, else: late.sent_at
  end

  defp replied(%{direction: :reply} = frame, tag, exchange),
    do: {{:reply, tag, frame}, count(exchange, :replies)}

  defp replied(_error, tag, exchange), do: {{:refused, tag}, count(exchange, :refused)}

  defp unasked(frame, exchange), do: {{:unasked, frame}, count(exchange, :unasked)}

  defp measure(%{usual_us: nil} = exchange, took), do: %{exchange | usual_us: took}

  defp measure(%{usual_us: usual} = exchange, took),
    do: %{exchange | usual_us: usual + div(took - usual, 8)}

  @doc "It is `now`: whether a request has waited too long. What waited in the parser is given up with it."
  @spec expire(t, integer) :: {:timeout, tag :: term, [answer], t} | :wait
  def expire(exchange, now) do
    case Enum.find(exchange.asked, fn {_lane, %{until: until}} -> until <= now end) do
      nil ->
        :wait

      {lane, %{tag: tag, frame: frame, sent_at: at}} ->
        gone = %{tag: tag, payload: frame.payload, sent_at: at, until: now + @late * timeout_us(exchange)}
        remembered = Map.filter(exchange.late, fn {_id, late} -> now - late.sent_at <= @remembered_us end)
        late = Map.update(remembered, frame.id, gone, &Map.put(gone, :sent_at, &1.sent_at))
        {frames, parser} = Parser.expire(exchange.parser)
        exchange = %{exchange | asked: Map.delete(exchange.asked, lane), late: late, parser: parser}
        {answers, exchange} = answers(frames, count(exchange, :timeouts), now)
        {:timeout, tag, answers, exchange}
    end
  end

  @doc "Whose replies are still to come does not matter any more; how long they take does."
  @spec forget(t) :: t
  def forget(exchange) do
    nobody = for {id, late} <- exchange.late, into: %{}, do: {id, %{late | tag: nil}}

    late =
      for {_lane, %{frame: %{id: id, payload: payload}, sent_at: at, until: until}} <- exchange.asked,
          into: nobody,
          do: {id, %{tag: nil, payload: payload, sent_at: at, until: until}}

    %{exchange | asked: %{}, late: late}
  end

  @doc "What was counted: its own counters and those of the parser."
  @spec counters(t) :: %{atom => non_neg_integer}
  def counters(exchange), do: Map.merge(exchange.counters, Parser.counters(exchange.parser))

  defp count(%{counters: counters} = exchange, name),
    do: %{exchange | counters: Map.update!(counters, name, &(&1 + 1))}
end
