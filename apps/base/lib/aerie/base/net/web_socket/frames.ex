defmodule Aerie.Base.Net.WebSocket.Frames do
  @moduledoc """
  Parses what the other side of a WebSocket sends (RFC 6455): a value into which bytes are pushed in any pieces. A client masks its frames, a server must
  not.

  The content of messages is passed on as it comes, so a header that claims a great length costs no memory: only a header or a
  control frame (125 bytes) is buffered. Text is passed on like binary; it holds no MAVLink, and the parser counts it.
  """

  defstruct buffer: "", fragment: :undefined, in: :header, masked?: false, mask: nil

  @typedoc """
  - `in`: what comes next, a header or so many bytes of a message's frame
  - `masked?`: whether the other side is a client; `mask`: that of the frame, and how far it was used
  """
  @type t :: %__MODULE__{
          buffer: binary,
          fragment: term,
          in: :header | {:payload, pos_integer},
          masked?: boolean,
          mask: {key :: non_neg_integer, used :: 0..3} | nil
        }

  @typedoc "`:bad`: no WebSocket frame, or one that the other side must not send; no event follows it"
  @type event ::
          {:data, binary}
          | {:ping, binary}
          | :pong
          | {:close, code :: 1000..4999 | nil, text :: binary}
          | :bad

  @doc "Nothing received yet from a server, or from a client."
  @spec new(:server | :client) :: t
  def new(other_side \\ :server), do: %__MODULE__{masked?: other_side == :client}

  @doc "Takes more bytes; returns what was in them, in order."
  @spec push(t, binary) :: {[event], t}
  def push(%__MODULE__{} = frames, bytes), do: take(frames, bytes, [])

  defp take(%{in: {:payload, left}} = frames, bytes, events) when byte_size(bytes) < left do
    {bytes, mask} = unmask(bytes, frames.mask)
    done(data(events, bytes), %{frames | in: {:payload, left - byte_size(bytes)}, mask: mask})
  end

  defp take(%{in: {:payload, left}} = frames, bytes, events) do
    <<data::binary-size(^left), rest::binary>> = bytes
    {data, _used} = unmask(data, frames.mask)
    take(%{frames | in: :header, mask: nil}, rest, data(events, data))
  end

  defp take(%{in: :header} = frames, bytes, events) do
    bytes = frames.buffer <> bytes

    case :cow_ws.parse_header(bytes, %{}, frames.fragment) do
      :more ->
        done(events, %{frames | buffer: bytes})

      :error ->
        done([:bad | events], frames)

      # A server must not mask, a client must.
      {_type, _fragment, _rsv, _length, mask, _rest} when frames.masked? == (mask == :undefined) ->
        done([:bad | events], frames)

      {type, fragment, _rsv, length, mask, rest} ->
        frames = %{frames | mask: if(mask != :undefined, do: {mask, 0})}
        frame(type, fragment, length, rest, bytes, frames, events)
    end
  end

  defp frame(type, _fragment, length, rest, bytes, frames, events) when type in [:ping, :pong, :close] do
    case rest do
      <<payload::binary-size(^length), rest::binary>> ->
        {payload, _used} = unmask(payload, frames.mask)
        take(%{frames | buffer: "", mask: nil}, rest, [control(type, payload) | events])

      _not_all_yet ->
        done(events, %{frames | buffer: bytes})
    end
  end

  defp frame(_data, fragment, length, rest, _bytes, frames, events) do
    fragment = if match?({:fin, _type, _rsv}, fragment), do: :undefined, else: fragment
    frames = %{frames | buffer: "", fragment: fragment}

    if length == 0,
      do: take(frames, rest, events),
      else: take(%{frames | in: {:payload, length}}, rest, events)
  end

  defp unmask(bytes, nil), do: {bytes, nil}

  defp unmask(bytes, {key, used}) do
    size = byte_size(bytes)
    pad = :binary.copy(<<key::32>>, div(size + used, 4) + 1)
    {:crypto.exor(bytes, binary_part(pad, used, size)), {key, rem(size + used, 4)}}
  end

  defp data(events, ""), do: events
  defp data(events, bytes), do: [{:data, bytes} | events]

  defp control(:ping, payload), do: {:ping, payload}
  defp control(:pong, _payload), do: :pong
  defp control(:close, <<code::16, text::binary>>), do: {:close, code, text}
  defp control(:close, _none), do: {:close, nil, ""}

  defp done(events, frames), do: {Enum.reverse(events), frames}

  @doc "A binary message as a client sends it, masked."
  @spec message(iodata) :: iodata
  def message(bytes), do: :cow_ws.masked_frame({:binary, bytes}, %{})

  @doc "The same as a server sends it."
  @spec reply(iodata) :: iodata
  def reply(bytes), do: :cow_ws.frame({:binary, bytes}, %{})

  @doc "A control frame as a server sends it."
  @spec answer({:pong, binary} | :close) :: iodata
  def answer(frame), do: :cow_ws.frame(frame, %{})

  @doc "A control frame as a client sends it: `:ping`, `{:pong, payload}`, `{:close, code, text}`."
  @spec control(:ping | {:pong, binary} | {:close, 1000..4999, binary}) :: iodata
  def control(frame), do: :cow_ws.masked_frame(frame, %{})
end
