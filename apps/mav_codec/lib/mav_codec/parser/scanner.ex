defmodule MavCodec.Parser.Scanner do
  @moduledoc """
  The loop over received bytes: frames out, what is not yet complete kept, everything else counted.

  `frames/8` is the fast path: a complete v2 frame without flags, of a known id, with the right CRC, at the start of the
  bytes. It costs one match, one CRC and two references. Everything else goes to `careful/6`, which decides by the rules
  of this module and comes back.

  ## Rules

    * A frame of a known id with the right CRC is taken, whatever stands inside it.
    * After a wrong CRC the search goes on at the next byte (F13).
    * A frame of an *unknown* id has no CRC that could be checked. It is taken only when no good frame of a known id
      starts within its extent, and the byte after it is a magic or the data ends there. In a stream, "ends" is known
      only by `flush`, so an unknown frame waits for the next byte; thus the result does not depend on how the bytes
      were cut into pieces.
    * The end of a datagram is an end of the data, except that an incomplete frame is kept for the next datagram, unless
      a good frame stands behind its start.
  """

  alias MavCodec.{CRC, Frame}
  alias MavCodec.Parser.{Candidate, Known}

  # Not called `Known.extra/2` in the fast path: the id is mostly in the tuple.
  @direct Known.direct_size()

  # `seen` is what the search for good frames inside doubtful ones has found in this data, so that no byte is judged more
  # than once by it: see `search/3`.
  @enforce_keys [:known, :accepted]
  defstruct @enforce_keys ++
              [crc_errors: 0, resync_bytes: 0, unknown_ids: 0, incompatible: 0, signed: 0, seen: nil]

  @typedoc "`:stream` - more bytes may follow; `:datagram` - a boundary; `:final` - nothing follows."
  @type mode :: :stream | :datagram | :final
  @type t :: %__MODULE__{
          known: Known.t(),
          accepted: 0..255,
          crc_errors: non_neg_integer(),
          resync_bytes: non_neg_integer(),
          unknown_ids: non_neg_integer(),
          incompatible: non_neg_integer(),
          signed: non_neg_integer(),
          seen: {non_neg_integer(), non_neg_integer() | nil, [non_neg_integer()]} | nil
        }

  @doc "A scanner that takes frames of `known` ids and the `accepted` incompatibility flags."
  @spec new(Known.t(), 0..255) :: t()
  def new(known, accepted), do: %__MODULE__{known: known, accepted: accepted}

  @doc """
  All frames of `data`, the newest first, the bytes to keep, and the scanner with what was counted. Frames get `at` as
  their time of arrival.
  """
  @spec scan(t(), binary(), integer() | nil, mode()) :: {[Frame.t()], binary(), t()}
  def scan(%__MODULE__{known: %Known{direct: direct}, seen: nil} = state, data, at, mode),
    do: frames(data, data, 0, direct, at, mode, [], state)

  def scan(state, data, at, mode), do: scan(%{state | seen: nil}, data, at, mode)

  # The first argument is `data` from `pos` on. It is only matched, so that the runtime goes through the whole of `data`
  # with one match context and makes no binary for what remains.
  defp frames(
         <<0xFD, len, 0, compat, seq, system, component, id::24-little, payload::binary-size(len),
           crc::16-little, rest::binary>>,
         data,
         pos,
         direct,
         at,
         mode,
         found,
         state
       )
       when system > 0 do
    bytes = binary_part(data, pos, len + 12)

    case if(id < @direct, do: elem(direct, id), else: Known.extra(state.known, id)) do
      extra when is_integer(extra) ->
        case CRC.frame(bytes, len + 9, extra) do
          ^crc ->
            frame = %Frame{
              seq: seq,
              system: system,
              component: component,
              id: id,
              payload: payload,
              compat: compat,
              crc_extra: extra,
              bytes: bytes,
              at: at
            }

            frames(rest, data, pos + len + 12, direct, at, mode, [frame | found], state)

          _wrong ->
            careful(from(data, pos), direct, at, mode, found, state)
        end

      _none_or_several ->
        careful(from(data, pos), direct, at, mode, found, state)
    end
  end

  defp frames(<<>>, _data, _pos, _direct, _at, _mode, found, state), do: {found, <<>>, state}

  defp frames(_rest, data, pos, direct, at, mode, found, state),
    do: careful(from(data, pos), direct, at, mode, found, state)

  defp from(data, pos), do: binary_part(data, pos, byte_size(data) - pos)

  defp careful(data, direct, at, mode, found, state) do
    case Candidate.judge(data, state.known, state.accepted) do
      {:good, size, extra} ->
        take(data, size, extra, direct, at, mode, found, state)

      {:incompatible, size} ->
        state = %{state | incompatible: state.incompatible + 1}
        again(from(data, size), direct, at, mode, found, state)

      {:unknown, size} ->
        case unknown(data, size, mode, state) do
          {:take, state} ->
            take(data, size, nil, direct, at, mode, found, %{state | unknown_ids: state.unknown_ids + 1})

          {:noise, state} ->
            skip(data, direct, at, mode, found, state)

          {:more, state} ->
            {found, data, state}
        end

      :bad_crc ->
        skip(data, direct, at, mode, found, %{state | crc_errors: state.crc_errors + 1})

      :noise ->
        skip(data, direct, at, mode, found, state)

      :more ->
        case incomplete(data, mode, state) do
          {:keep, state} -> {found, data, state}
          {:noise, state} -> skip(data, direct, at, mode, found, state)
        end
    end
  end

  defp take(data, size, extra, direct, at, mode, found, state) do
    <<bytes::binary-size(^size), rest::binary>> = data
    frame = Frame.from_bytes(bytes, extra, at)
    state = if frame.signature, do: %{state | signed: state.signed + 1}, else: state
    again(rest, direct, at, mode, [frame | found], state)
  end

  defp again(data, direct, at, mode, found, state), do: frames(data, data, 0, direct, at, mode, found, state)

  # F13: on to the next byte that could begin a frame.
  defp skip(<<_, rest::binary>>, direct, at, mode, found, state) do
    skipped = next_magic(rest, 0)
    state = %{state | resync_bytes: state.resync_bytes + skipped + 1}
    again(from(rest, skipped), direct, at, mode, found, state)
  end

  defp next_magic(<<magic, _::binary>>, at) when magic in [0xFD, 0xFE], do: at
  defp next_magic(<<_, rest::binary>>, at), do: next_magic(rest, at + 1)
  defp next_magic(<<>>, at), do: at

  # An unknown frame is believed when what follows begins like a frame and no good frame begins inside it.
  defp unknown(data, size, mode, state) do
    case data do
      <<_::binary-size(^size), magic, _::binary>> when magic in [0xFD, 0xFE] ->
        inside(data, size, mode, state)

      <<_::binary-size(^size), _, _::binary>> ->
        {:noise, state}

      _ when mode == :stream ->
        {:more, state}

      _ends_here ->
        inside(data, size, mode, state)
    end
  end

  defp inside(data, size, mode, state) do
    case search(data, size, state) do
      {:none, state} -> {:take, state}
      {:good, state} -> {:noise, state}
      {:more, state} -> if mode == :stream, do: {:more, state}, else: {:take, state}
    end
  end

  # A frame that is not complete: kept, but at a datagram's end not at the cost of a good frame behind its start.
  defp incomplete(_data, :stream, state), do: {:keep, state}
  defp incomplete(_data, :final, state), do: {:noise, state}

  defp incomplete(data, :datagram, state) do
    case search(data, byte_size(data), state) do
      {:good, state} -> {:noise, state}
      {_none_or_more, state} -> {:keep, state}
    end
  end

  # Whether a good frame of a known id begins at one of the bytes 1..size-1 of the data.
  #
  # Places are numbers of bytes from there to the end of the data, which stay true while the loop goes on through the same
  # data. `seen` is {the last place judged, the place of a good frame if that was one, the doubtful places before it};
  # all from the first candidate's place to the last one were judged.
  defp search(data, size, state) do
    total = byte_size(data)

    case state.seen do
      {last, good, doubtful} when last < total -> search(data, total - size, last, good, doubtful, state)
      _nothing_of_use -> search(data, total - size, total, nil, [], state)
    end
  end

  # `limit` is the place just behind the extent that is searched.
  defp search(_data, limit, last, good, doubtful, state) when good != nil and good > limit,
    do: {:good, %{state | seen: {last, good, doubtful}}}

  defp search(data, limit, last, good, doubtful, state) when good != nil or last - 1 <= limit do
    total = byte_size(data)
    result = if Enum.any?(doubtful, &(&1 > limit and &1 < total)), do: :more, else: :none
    {result, %{state | seen: {last, good, doubtful}}}
  end

  defp search(data, limit, last, nil, doubtful, state) do
    place = last - 1

    case Candidate.judge(from(data, byte_size(data) - place), state.known, state.accepted) do
      {:good, _, _} -> search(data, limit, place, place, doubtful, state)
      :more -> search(data, limit, place, nil, [place | doubtful], state)
      _no_frame -> search(data, limit, place, nil, doubtful, state)
    end
  end
end
