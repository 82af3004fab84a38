defmodule MavCodec.Parser.Scanner do
  @moduledoc """
  The loop over received bytes: it returns frames, keeps incomplete ones, and counts everything else.

  `frames/8` is the fast path for consecutive complete frames of known ids with the right CRC: version 2 without flags or
  signed, or version 1. Each costs one match, one CRC and two references. Where a frame is due and something else comes,
  `due/6` judges it. Behind damage, `gap/7` searches the next frame (`MavCodec.Parser.Search`).

  ## Rules

    * A frame with a known id and a correct CRC is accepted, whatever it contains.
    * After a wrong CRC the search continues at the next byte (F13). There, a MAVLink 1 header counts only if it has exactly
      the message's length (F9).
    * The CRC of a frame with an *unknown* id cannot be checked. The frame is accepted only if no good frame with a known id
      starts inside it, and the byte after it is a magic or the data ends there. In a stream, only `flush` tells the end,
      so an unknown frame waits for the next byte, and the result does not depend on the chunking.
    * The end of a datagram is an end of the data, except that an incomplete frame is kept for the next datagram, unless
      a good frame follows its start.
    * The work is linear in the number of bytes.
  """

  import Bitwise

  alias MavCodec.{CRC, Frame}
  alias MavCodec.Parser.{Candidate, Checksums, Known, Search}

  # The fast path does not call `Known.extra/2`, because the id is nearly always in the pages.
  @direct Known.direct_size()

  # `due?`: a frame is due at the first byte, because there is no damage before it. `ahead` is the result of
  # `Search.good/6`, and `cleared` the place up to which it has searched, so that each place is searched once; between two
  # pushes `cleared` is relative to the bytes kept.
  @enforce_keys [:known, :accepted]
  defstruct @enforce_keys ++
              [crc_errors: 0, resync_bytes: 0, incompatible: 0] ++
              [due?: true, ahead: :none, cleared: 0, sums: Checksums.new()]

  @type t :: %__MODULE__{
          known: Known.t(),
          accepted: 0..255,
          crc_errors: non_neg_integer(),
          resync_bytes: non_neg_integer(),
          incompatible: non_neg_integer(),
          due?: boolean(),
          ahead: Search.ahead(),
          cleared: non_neg_integer(),
          sums: Checksums.t()
        }

  @doc "A scanner that accepts frames of `known` ids with the `accepted` incompatibility flags."
  @spec new(Known.t(), 0..255) :: t()
  def new(known, accepted), do: %__MODULE__{known: known, accepted: accepted}

  @doc "A frame is due at the start of the next data, whatever came before."
  @spec boundary(t()) :: t()
  def boundary(%__MODULE__{due?: true} = state), do: state
  def boundary(state), do: %{state | due?: true}

  @doc """
  Returns all frames of `data`, the newest first, the bytes to keep, and the scanner with its counters. Frames get `at` as
  their time of arrival.
  """
  @spec scan(t(), binary(), integer() | nil, Search.mode()) :: {[Frame.t()], binary(), t()}
  def scan(%__MODULE__{due?: true, known: %Known{pages: pages}} = state, data, at, mode),
    do: frames(data, data, 0, pages, at, mode, [], state)

  def scan(state, data, at, mode), do: gap(data, 0, 0, at, mode, [], state)

  # The two macros are parts of `frames/8` and use its variables. A function would cost a call for each frame.
  defmacrop extra(id) do
    quote do
      if unquote(id) < @direct,
        do: elem(elem(var!(pages), unquote(id) >>> 8), unquote(id) &&& 0xFF),
        else: Known.extra(var!(state).known, unquote(id))
    end
  end

  # Takes a frame of `size` bytes if the CRC over `covered` of them is right.
  defmacrop checked(extra, covered, size, fields) do
    quote do
      case unquote(extra) do
        extra when is_integer(extra) ->
          bytes = binary_part(var!(data), var!(pos), unquote(size))

          if CRC.frame(bytes, unquote(covered), extra) == var!(crc) do
            frame = %Frame{
              unquote_splicing(fields),
              seq: var!(seq),
              system: var!(system),
              component: var!(component),
              id: var!(id),
              payload: var!(payload),
              crc_extra: extra,
              bytes: bytes,
              at: var!(at)
            }

            pos = var!(pos) + unquote(size)

            frames(
              var!(rest),
              var!(data),
              pos,
              var!(pages),
              var!(at),
              var!(mode),
              [frame | var!(found)],
              var!(state)
            )
          else
            wrong(var!(data), var!(pos), unquote(covered), var!(at), var!(mode), var!(found), var!(state))
          end

        _none_or_several ->
          due(var!(data), var!(pos), var!(at), var!(mode), var!(found), var!(state))
      end
    end
  end

  # The first argument is `data` from `pos` on. It is only matched, so that the runtime goes through the whole of `data`
  # with one match context and makes no binary for what remains.
  defp frames(
         <<0xFD, len, 0, compat, seq, system, component, id::24-little, payload::binary-size(len),
           crc::16-little, rest::binary>>,
         data,
         pos,
         pages,
         at,
         mode,
         found,
         state
       )
       when system > 0 do
    checked(extra(id), len + 9, len + 12, compat: compat)
  end

  defp frames(
         <<0xFE, len, seq, system, component, id, payload::binary-size(len), crc::16-little, rest::binary>>,
         data,
         pos,
         pages,
         at,
         mode,
         found,
         state
       )
       when system > 0 do
    checked(elem(elem(pages, 0), id), len + 5, len + 8, version: 1)
  end

  defp frames(
         <<0xFD, len, 1, compat, seq, system, component, id::24-little, payload::binary-size(len),
           crc::16-little, link_id, timestamp::48-little, signature::binary-size(6), rest::binary>>,
         data,
         pos,
         pages,
         at,
         mode,
         found,
         state
       )
       when system > 0 do
    signature = %{link_id: link_id, timestamp: timestamp, signature: signature}
    checked(extra(id), len + 9, len + 25, incompat: 1, compat: compat, signature: signature)
  end

  defp frames(<<>>, data, _pos, _pages, _at, mode, found, state),
    do: {found, <<>>, done(state, byte_size(data), true, mode)}

  defp frames(_rest, data, pos, _pages, at, mode, found, state), do: due(data, pos, at, mode, found, state)

  defp again(data, pos, at, mode, found, %{known: %{pages: pages}} = state) do
    <<_::binary-size(^pos), rest::binary>> = data
    frames(rest, data, pos, pages, at, mode, found, state)
  end

  # F13: the search continues at the next byte.
  defp wrong(data, pos, covered, at, mode, found, state) do
    state = %{state | crc_errors: state.crc_errors + 1, sums: Checksums.spent(state.sums, covered)}
    gap(data, pos, pos + 1, at, mode, found, state)
  end

  # A frame is due at `pos`.
  defp due(data, pos, at, mode, found, state) do
    case data |> from(pos) |> Candidate.classify(state.known, state.accepted) do
      {:good, size, extra} -> take(data, pos, size, extra, at, mode, found, state)
      {:incompatible, size} -> incompatible(data, pos, size, at, mode, found, state)
      {:unknown, size} -> unknown(data, pos, size, at, mode, found, state)
      {:bad_crc, size} -> wrong(data, pos, size, at, mode, found, state)
      :noise -> gap(data, pos, pos + 1, at, mode, found, state)
      :more when mode == :stream -> {found, from(data, pos), done(state, pos, true, mode)}
      :more when mode == :final -> gap(data, pos, pos + 1, at, mode, found, state)
      :more -> unfinished(data, pos, at, found, state)
    end
  end

  # A frame of an unknown id where a frame is due. If its bytes were searched before (up to `cleared`, or to a good frame),
  # there is nothing to search.
  defp unknown(data, pos, size, at, mode, found, %{ahead: ahead, cleared: cleared} = state) do
    stop = pos + size

    if stop <= cleared and not match?({_, place} when place < stop, ahead) and
         match?(<<_::binary-size(^stop), magic, _::binary>> when magic in [0xFD, 0xFE], data),
       do: take(data, pos, size, nil, at, mode, found, state),
       else: gap(data, pos, pos, at, mode, found, state)
  end

  # At the end of a datagram, the beginning of a frame is kept, unless a good frame follows its start.
  defp unfinished(data, pos, at, found, state) do
    case ahead(data, pos + 1, :datagram, state) do
      {{:good, _place}, _seen, state} -> gap(data, pos, pos + 1, at, :datagram, found, state)
      {:none, _seen, state} -> {found, from(data, pos), done(state, pos, true, :datagram)}
    end
  end

  # No frame is due at `pos`. Searches from `next` on for frames of unknown ids, up to the next good frame.
  defp gap(data, pos, next, at, mode, found, state) do
    {ahead, seen, state} = ahead(data, next, mode, state)

    {what, errors} =
      case seen do
        {errors, nil} -> {:none, errors}
        {errors, open} -> Search.open(data, open, ahead, state.known, state.accepted, mode, errors)
      end

    place = place(what, ahead, data)
    state = %{state | crc_errors: state.crc_errors + errors, resync_bytes: state.resync_bytes + place - pos}

    case {what, ahead} do
      {{:take, _place, size}, _} -> take(data, place, size, nil, at, mode, found, state)
      {:none, {:good, _place}} -> again(data, place, at, mode, found, state)
      _hold_doubt_or_none -> {found, from(data, place), done(state, place, false, mode)}
    end
  end

  defp place({:take, place, _size}, _ahead, _data), do: place
  defp place({:hold, place}, _ahead, _data), do: place
  defp place(:none, ahead, data), do: limit(ahead, data)

  # The result of `Search.good/6` from `next` on, of this call or of an earlier one.
  defp ahead(_data, next, _mode, %{ahead: {:good, place}} = state) when place >= next,
    do: {state.ahead, {0, next}, state}

  defp ahead(data, next, mode, %{cleared: cleared} = state) do
    %{known: known, accepted: accepted, sums: sums} = state
    from = max(next, cleared)
    {ahead, errors, open, sums} = Search.good(data, from, known, accepted, mode, sums)
    state = %{state | ahead: ahead, cleared: limit(ahead, data), sums: sums}
    {ahead, if(from == next, do: {errors, open}, else: {0, next}), state}
  end

  defp limit({_good_or_doubt, place}, _data), do: place
  defp limit(:none, data), do: byte_size(data)

  defp take(data, pos, size, extra, at, mode, found, state) do
    frame = data |> binary_part(pos, size) |> Frame.from_bytes(extra, at)
    again(data, pos + size, at, mode, [frame | found], state)
  end

  defp incompatible(data, pos, size, at, mode, found, state),
    do: again(data, pos + size, at, mode, found, %{state | incompatible: state.incompatible + 1})

  # The bytes from `kept` on wait for more; `due?` whether a frame was due at the first of them. In a stream, the search
  # goes on where it stopped; behind a datagram's end, frames that were cut off may go on, so it begins again.
  defp done(%{ahead: :none, cleared: 0, due?: due?, sums: {0, _, _, _}} = state, _kept, due?, _mode),
    do: state

  defp done(state, kept, due?, mode) do
    cleared = if mode == :stream, do: max(state.cleared - kept, 0), else: 0
    %{state | due?: due?, ahead: :none, cleared: cleared, sums: Checksums.new()}
  end

  defp from(data, pos), do: binary_part(data, pos, byte_size(data) - pos)
end
