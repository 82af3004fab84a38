defmodule Aerie.Router.Asked do
  @moduledoc """
  What an endpoint asked a vehicle for, and what of it waits to be written: logs, parameters, missions, files. A hole in one
  of them costs the client a request for each piece, so they have room of their own beside the telemetry
  (`Aerie.Router.Queue`); who did not ask gets the same messages like any other.

  | kind | asked for by | answered by |
  |---|---|---|
  | log | LOG_REQUEST_LIST, LOG_REQUEST_DATA | LOG_ENTRY, LOG_DATA |
  | parameters | PARAM_REQUEST_LIST, PARAM_REQUEST_READ, PARAM_SET, and PARAM_EXT_… | PARAM_VALUE, PARAM_EXT_VALUE |
  | mission | MISSION_REQUEST_LIST, MISSION_COUNT, MISSION_REQUEST_INT … | MISSION_COUNT, MISSION_ITEM_INT, MISSION_REQUEST_INT … |
  | file | FILE_TRANSFER_PROTOCOL | the same |

  It counts as asked for until #{10_000} ms after the last request or the last answer.
  """

  alias MavCodec.Dialects.All
  alias MavCodec.Frame

  @lasts_ms 10_000

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

  @doc "How many milliseconds something counts as asked for."
  @spec lasts_ms() :: pos_integer
  def lasts_ms, do: @lasts_ms

  @doc "Notes what of these frames, which the endpoint said, asks for something; whether any does."
  @spec note(t, [Frame.t()], integer) :: {boolean, t}

  def note(asked, frames, now), do: note(frames, asked, now, false)

  defp note([], asked, _now, any?), do: {any?, asked}

  defp note([%{id: id} | rest], asked, now, any?) do
    case request(id) do
      nil -> note(rest, asked, now, any?)
      kind -> note(rest, put_in(asked.until[kind], now + @lasts_ms), now, true)
    end
  end

  for {kind, {requests, _answers}} <- @kinds, name <- requests do
    defp request(unquote(All.message_id(name) || raise("no message #{name}"))), do: unquote(kind)
  end

  defp request(_other), do: nil

  for {kind, {_requests, answers}} <- @kinds, name <- answers do
    defp answer(unquote(All.message_id(name) || raise("no message #{name}"))), do: unquote(kind)
  end

  defp answer(_other), do: nil

  @doc """
  Takes a frame that answers a request: with it, or `:full`; `:other` for what was not asked for. An answer keeps the request
  alive.
  """
  @spec push(t, binary, integer) :: {:ok, t} | :full | :other
  def push(%__MODULE__{until: until}, _frame, _now) when until == %{}, do: :other

  def push(asked, frame, now) do
    with kind when kind != nil <- frame |> id() |> answer(),
         %{^kind => until} when now < until <- asked.until do
      size = byte_size(frame)

      if asked.bytes + size > asked.max_bytes do
        :full
      else
        {:ok,
         %{
           asked
           | until: %{asked.until | kind => now + @lasts_ms},
             frames: asked.frames + 1,
             bytes: asked.bytes + size,
             waiting: :queue.in({now, frame}, asked.waiting)
         }}
      end
    else
      _not_asked_for -> :other
    end
  end

  @doc "Frames were written without waiting: what they answer stays asked for."
  @spec answered(t, [binary], integer) :: t
  def answered(%__MODULE__{until: until} = asked, _frames, _now) when until == %{}, do: asked

  def answered(asked, [frame | _rest], now) do
    kind = frame |> id() |> answer()

    case asked.until do
      %{^kind => until} when now < until -> put_in(asked.until[kind], now + @lasts_ms)
      _not_asked_for -> asked
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
  def peek(asked) do
    {_at, frame} = :queue.get(asked.waiting)
    frame
  end

  @doc "Takes the next frame out."
  @spec pop(t) :: {binary, t}
  def pop(asked) do
    {{:value, {_at, frame}}, waiting} = :queue.out(asked.waiting)
    {frame, %{asked | waiting: waiting, frames: asked.frames - 1, bytes: asked.bytes - byte_size(frame)}}
  end
end
