defmodule Msp.Exchange do
  @first_us 1_000_000
  @least_us 250_000
  @gap_us 10_000

  @moduledoc """
  Requests and replies on one line (Q2): one request at a time, its reply recognised by the id, the time that replies take.

  A reply that comes after its time is discarded. If its request had arguments, the same message waits with other ones until the late
  reply cannot come any more: nothing in it says to which arguments it belongs. Flight controllers handle one request in #{div(@gap_us, 1000)} ms.
  """

  alias MavCodec.Msp.{Frame, Parser}

  # For how many times the usual time of a reply a late one may still come.
  @late 3

  defstruct parser: Parser.new(),
            asked: nil,
            sent_at: nil,
            deadline: nil,
            usual_us: nil,
            late: %{},
            counters: %{requests: 0, replies: 0, refused: 0, timeouts: 0, late: 0, unasked: 0}

  @typedoc """
  - `asked`: the request that waits for its reply: its name for the caller, and its frame
  - `usual_us`: how long replies take, a moving mean
  - `late`: ids of requests whose reply may still come, with the payload and until when
  """
  @type t :: %__MODULE__{}
  @type answer ::
          {:reply, tag :: term, Frame.t()}
          | {:refused, tag :: term}
          | {:unasked, Frame.t()}

  @doc "An exchange on a line that was just opened."
  @spec new() :: t
  def new, do: %__MODULE__{}

  @doc "Whether this request may be sent now; if not, the earliest time for it."
  @spec ready(t, Frame.t(), integer) :: :now | {:at, integer} | :busy
  def ready(%{asked: asked}, _frame, _now) when asked != nil, do: :busy

  def ready(exchange, %{id: id, payload: payload}, now) do
    gap = if exchange.sent_at, do: exchange.sent_at + @gap_us, else: now

    late =
      case exchange.late do
        %{^id => {other, until}} when other != payload -> until
        _none -> now
      end

    if max(gap, late) <= now, do: :now, else: {:at, max(gap, late)}
  end

  @doc "Sends a request; `tag` names it in its answer. `patience_us`: how long it may take at least."
  @spec send(t, tag :: term, Frame.t(), integer, patience_us :: non_neg_integer) :: {binary, t}
  def send(%{asked: nil} = exchange, tag, frame, now, patience_us \\ 0) do
    deadline = now + max(timeout_us(exchange), patience_us)
    exchange = %{exchange | asked: {tag, frame}, sent_at: now, deadline: deadline}
    {Frame.encode(frame), count(exchange, :requests)}
  end

  @doc "How long a reply may take: four times the usual time, a quarter of a second at least, one second at most."
  @spec timeout_us(t) :: pos_integer
  def timeout_us(%{usual_us: nil}), do: @first_us

  def timeout_us(%{usual_us: usual}) when is_integer(usual),
    do: (4 * usual) |> max(@least_us) |> min(@first_us)

  @doc "Bytes from the line."
  @spec push(t, binary, integer) :: {[answer], t}
  def push(exchange, bytes, now) do
    {frames, parser} = Parser.push(exchange.parser, bytes)
    answers(frames, %{exchange | parser: parser}, now)
  end

  defp answers(frames, exchange, now) do
    {answers, exchange} = Enum.map_reduce(frames, exchange, &answer(&1, &2, now))
    {Enum.reject(answers, &is_nil/1), exchange}
  end

  defp answer(%Frame{id: id, direction: direction} = frame, %{asked: {tag, %{id: id}}} = exchange, now)
       when direction != :request do
    exchange = measure(%{exchange | asked: nil, deadline: nil}, now - exchange.sent_at)

    if direction == :reply,
      do: {{:reply, tag, frame}, count(exchange, :replies)},
      else: {{:refused, tag}, count(exchange, :refused)}
  end

  defp answer(%Frame{id: id, direction: direction} = frame, exchange, now) do
    case exchange.late do
      %{^id => {_payload, until}} when until > now and direction != :request ->
        {nil, count(%{exchange | late: Map.delete(exchange.late, id)}, :late)}

      _not_late ->
        {{:unasked, frame}, count(exchange, :unasked)}
    end
  end

  defp measure(%{usual_us: nil} = exchange, took), do: %{exchange | usual_us: took}

  defp measure(%{usual_us: usual} = exchange, took),
    do: %{exchange | usual_us: usual + div(took - usual, 8)}

  @doc "It is `now`: whether the request at hand has waited too long. What waited in the parser is given up with it."
  @spec expire(t, integer) :: {:timeout, tag :: term, [answer], t} | :wait
  def expire(%{asked: {tag, frame}, deadline: deadline} = exchange, now) when deadline <= now do
    late = Map.put(exchange.late, frame.id, {frame.payload, now + @late * timeout_us(exchange)})
    late = Map.filter(late, fn {_id, {_payload, until}} -> until > now end)
    {frames, parser} = Parser.expire(exchange.parser)
    exchange = count(%{exchange | asked: nil, deadline: nil, late: late, parser: parser}, :timeouts)
    {answers, exchange} = answers(frames, exchange, now)
    {:timeout, tag, answers, exchange}
  end

  def expire(_exchange, _now), do: :wait

  @doc "What was counted: its own counters and those of the parser."
  @spec counters(t) :: %{atom => non_neg_integer}
  def counters(exchange), do: Map.merge(exchange.counters, Parser.counters(exchange.parser))

  defp count(%{counters: counters} = exchange, name),
    do: %{exchange | counters: Map.update!(counters, name, &(&1 + 1))}
end
