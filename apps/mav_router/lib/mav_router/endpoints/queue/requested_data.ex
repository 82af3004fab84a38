defmodule MavRouter.Endpoints.Queue.RequestedData do
  @lasts_ms 10_000

  @moduledoc """
  The data that an endpoint requested of a vehicle, and that waits to be written: logs, parameters, missions, files. A gap in them
  costs the client a request for each piece, so they have room of their own beside the telemetry
  (`MavRouter.Endpoints.Queue.ClassQueue`). For an endpoint that requested nothing the same messages are like any other.

  | kind | requests | answers |
  |---|---|---|
  | log | LOG_REQUEST_LIST, LOG_REQUEST_DATA | LOG_ENTRY, LOG_DATA |
  | parameters | PARAM_REQUEST_LIST, PARAM_REQUEST_READ, PARAM_SET, and PARAM_EXT_… | PARAM_VALUE, PARAM_EXT_VALUE |
  | mission | MISSION_REQUEST_LIST, MISSION_COUNT, MISSION_REQUEST_INT … | MISSION_COUNT, MISSION_ITEM_INT, MISSION_REQUEST_INT … |
  | file | FILE_TRANSFER_PROTOCOL | the same |

  A request lasts until #{@lasts_ms} ms after its last repetition or answer.
  """

  alias MavCodec.MessageId
  alias MavCodec.Frame

  @kinds [
    log: {~w(LOG_REQUEST_LIST LOG_REQUEST_DATA), ~w(LOG_ENTRY LOG_DATA)},
    params:
      {~w(PARAM_REQUEST_LIST PARAM_REQUEST_READ PARAM_SET PARAM_EXT_REQUEST_LIST PARAM_EXT_REQUEST_READ PARAM_EXT_SET),
       ~w(PARAM_VALUE PARAM_EXT_VALUE)},
    mission:
      {~w(MISSION_REQUEST_LIST MISSION_REQUEST_PARTIAL_LIST MISSION_REQUEST MISSION_REQUEST_INT MISSION_COUNT
       MISSION_WRITE_PARTIAL_LIST MISSION_ITEM MISSION_ITEM_INT),
       ~w(MISSION_COUNT MISSION_ITEM MISSION_ITEM_INT MISSION_REQUEST MISSION_REQUEST_INT)},
    file: {~w(FILE_TRANSFER_PROTOCOL), ~w(FILE_TRANSFER_PROTOCOL)}
  ]

  defstruct max_bytes: 8_388_608, until: %{}, frames: 0, bytes: 0, waiting: :queue.new()

  @typedoc "`until`: monotonic ms by kind; `waiting`: frames with the time at which they came"
  @type t :: %__MODULE__{
          max_bytes: pos_integer,
          until: %{atom => integer},
          frames: non_neg_integer,
          bytes: non_neg_integer,
          waiting: :queue.queue({integer, binary})
        }

  @doc "How many milliseconds a request lasts."
  @spec lasts_ms() :: pos_integer
  def lasts_ms, do: @lasts_ms

  @doc "Notes the requests among frames from the endpoint; whether there are any."
  @spec note(t, [Frame.t()], integer) :: {boolean, t}
  def note(requested, frames, now), do: note(frames, requested, now, false)

  defp note([], requested, _now, any?), do: {any?, requested}

  defp note([%{id: id} | rest], requested, now, any?) do
    case request(id) do
      nil -> note(rest, requested, now, any?)
      kind -> note(rest, put_in(requested.until[kind], now + @lasts_ms), now, true)
    end
  end

  for {kind, {requests, _answers}} <- @kinds, name <- requests do
    defp request(unquote(MessageId.of!(name))), do: unquote(kind)
  end

  defp request(_other), do: nil

  for {kind, {_requests, answers}} <- @kinds, name <- answers do
    defp answer(unquote(MessageId.of!(name))), do: unquote(kind)
  end

  defp answer(_other), do: nil

  @doc """
  Queues a frame that answers a request, which prolongs the request. `:full`: there is no room; `:other`: it was not requested.
  """
  @spec push(t, binary, integer) :: {:ok, t} | :full | :other
  def push(%__MODULE__{until: until}, _frame, _now) when until == %{}, do: :other

  def push(requested, frame, now) do
    with kind when kind != nil <- frame |> id() |> answer(),
         %{^kind => until} when now < until <- requested.until do
      size = byte_size(frame)

      if requested.bytes + size > requested.max_bytes do
        :full
      else
        {:ok,
         %{
           requested
           | until: %{requested.until | kind => now + @lasts_ms},
             frames: requested.frames + 1,
             bytes: requested.bytes + size,
             waiting: :queue.in({now, frame}, requested.waiting)
         }}
      end
    else
      _not_requested -> :other
    end
  end

  @doc "Frames were written without waiting: the request that they answer is prolonged."
  @spec answered(t, [binary], integer) :: t
  def answered(%__MODULE__{until: until} = requested, _frames, _now) when until == %{}, do: requested

  def answered(requested, [frame | _rest], now) do
    kind = frame |> id() |> answer()

    case requested.until do
      %{^kind => until} when now < until -> put_in(requested.until[kind], now + @lasts_ms)
      _not_requested -> requested
    end
  end

  defp id(frame) do
    case Frame.header(frame) do
      {:ok, _header, _payload, _total, id, _system} -> id
      _to_be_signed -> nil
    end
  end

  @doc "The next frame."
  @spec peek(t) :: binary
  def peek(requested) do
    {_at, frame} = :queue.get(requested.waiting)
    frame
  end

  @doc "Takes the next frame out."
  @spec pop(t) :: {binary, t}
  def pop(requested) do
    {{:value, {_at, frame}}, waiting} = :queue.out(requested.waiting)

    {frame,
     %{requested | waiting: waiting, frames: requested.frames - 1, bytes: requested.bytes - byte_size(frame)}}
  end
end
