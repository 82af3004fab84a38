defmodule MavCodec.Parser.Search do
  @moduledoc """
  Searches bytes that do not start with a good frame for the next frames, in one pass.

  `good/6` looks ahead for the next frame of a known id with the right CRC; `open/7` searches for what may be a frame of an
  unknown id or the beginning of an incomplete frame. Both do a bounded amount of work for each byte, whatever the bytes are
  (`MavCodec.Parser.Checksums`), and allocate nothing for other bytes.

  MAVLink 1 has no extensions and truncates nothing, so behind damage a header of version 1 counts only if its length is
  exactly the message's (F9). Where a frame is due, the scanner does not require that.
  """

  import Bitwise

  require MavCodec.Parser.Checksums

  alias MavCodec.CRC
  alias MavCodec.Parser.{Checksums, Known}

  @direct Known.direct_size()
  @signed 0x01
  @source32 0x02
  @target32 0x04
  # The longest header without magic plus payload; and more bytes than any read has.
  @longest 16 + 255
  @most 0xFFFF_FFFF_FFFF

  @typedoc """
    * `{:good, place}` - a frame of a known id with the right CRC
    * `{:doubt, place}` - in a stream, the beginning of a frame of a known id; nothing behind it was searched
    * `:none` - neither, up to the end of the data
  """
  @type ahead :: {:good | :doubt, non_neg_integer()} | :none

  @typedoc "`:stream` - more bytes may follow; `:datagram` - a boundary; `:final` - nothing follows."
  @type mode :: :stream | :datagram | :final

  @doc """
  Returns the next good frame of `data` from `pos` on; the number of wrong CRCs before it, or before the first place where
  `open/7` should search; and that place, or `nil`.
  """
  @spec good(binary(), non_neg_integer(), Known.t(), 0..255, mode(), Checksums.t()) ::
          {ahead(), errors :: non_neg_integer(), open :: non_neg_integer() | nil, Checksums.t()}
  def good(data, pos, known, accepted, mode, sums) do
    <<_::binary-size(^pos), rest::binary>> = data
    scan(rest, pos, known.pages, known.lengths, fixed(data, known, accepted, mode), 0, nil, sums)
  end

  # Constant during a search; `refused` are the flags that are not accepted (F6).
  defp fixed(data, known, accepted, mode),
    do: {known, 0xFF - accepted, mode, byte_size(data), data, known.others}

  # This function and its helpers begin with a match, so that the runtime makes no binary of the rest, and keep their
  # arguments in their places, so that no register is moved.
  defp scan(<<0xFE, rest::binary>>, pos, pages, lengths, fixed, errors, open, sums) do
    case rest do
      <<len, _seq, system, _component, id, _::binary>> when system > 0 ->
        case elem(lengths, id) do
          ^len ->
            extra = elem(elem(pages, 0), id)
            candidate(rest, pos, pages, lengths, fixed, errors, open, sums, 5 + len, 0, extra)

          other when is_integer(other) ->
            scan(rest, pos + 1, pages, lengths, fixed, errors, open, sums)

          nil ->
            case elem(elem(pages, 0), id) do
              nil when open == nil -> nobody(rest, pos, pages, lengths, fixed, errors, nil, sums, 5 + len, 0)
              nil -> scan(rest, pos + 1, pages, lengths, fixed, errors, open, sums)
              extra -> candidate(rest, pos, pages, lengths, fixed, errors, open, sums, 5 + len, 0, extra)
            end
        end

      <<_::5-binary, _::binary>> ->
        scan(rest, pos + 1, pages, lengths, fixed, errors, open, sums)

      _incomplete ->
        incomplete(rest, pos, pages, lengths, fixed, errors, open, sums)
    end
  end

  defp scan(<<0xFD, rest::binary>>, pos, pages, lengths, fixed, errors, open, sums) do
    case rest do
      <<len, flags, _::2-binary, system, _component, id::24-little, _::binary>>
      when (flags &&& @source32) == 0 ->
        if system == 0,
          do: scan(rest, pos + 1, pages, lengths, fixed, errors, open, sums),
          else: v2(rest, pos, pages, lengths, fixed, errors, open, sums, 9 + len, flags, id)

      <<len, flags, _::2-binary, system::32, _component, id::24-little, _::binary>>
      when (flags &&& @source32) != 0 ->
        if system == 0,
          do: scan(rest, pos + 1, pages, lengths, fixed, errors, open, sums),
          else: v2(rest, pos, pages, lengths, fixed, errors, open, sums, 12 + len, flags, id)

      _incomplete ->
        incomplete(rest, pos, pages, lengths, fixed, errors, open, sums)
    end
  end

  defp scan(<<_, rest::binary>>, pos, pages, lengths, fixed, errors, open, sums),
    do: scan(rest, pos + 1, pages, lengths, fixed, errors, open, sums)

  defp scan(<<>>, _pos, _pages, _lengths, _fixed, errors, open, sums), do: {:none, errors, open, sums}

  # Only tail calls: any other call would save all registers of the loop. `covered` as with short ids.
  defp v2(<<rest::binary>>, pos, pages, lengths, fixed, errors, open, sums, covered, flags, id)
       when id < @direct do
    case elem(elem(pages, id >>> 8), id &&& 0xFF) do
      nil when open == nil and (flags &&& elem(fixed, 1)) == 0 ->
        nobody(rest, pos, pages, lengths, fixed, errors, nil, sums, covered + (flags &&& @target32), flags)

      nil ->
        scan(rest, pos + 1, pages, lengths, fixed, errors, open, sums)

      extra ->
        covered = covered + (flags &&& @target32)
        signed = 13 * (flags &&& @signed)
        candidate(rest, pos, pages, lengths, fixed, errors, open, sums, covered, signed, extra)
    end
  end

  defp v2(<<rest::binary>>, pos, pages, lengths, fixed, errors, open, sums, _covered, flags, _id)
       when elem(fixed, 5) == [] and (open != nil or (flags &&& elem(fixed, 1)) != 0),
       do: scan(rest, pos + 1, pages, lengths, fixed, errors, open, sums)

  defp v2(<<rest::binary>>, pos, pages, lengths, fixed, errors, open, sums, covered, flags, id) do
    covered = covered + (flags &&& @target32)

    case Known.extra(elem(fixed, 0), id) do
      nil when open == nil ->
        nobody(rest, pos, pages, lengths, fixed, errors, nil, sums, covered, flags)

      nil ->
        scan(rest, pos + 1, pages, lengths, fixed, errors, open, sums)

      extra ->
        signed = 13 * (flags &&& @signed)
        candidate(rest, pos, pages, lengths, fixed, errors, open, sums, covered, signed, extra)
    end
  end

  # An unknown id: the first place that may be a frame is remembered.
  defp nobody(<<rest::binary>>, pos, pages, lengths, fixed, errors, nil, sums, covered, flags) do
    signed = 13 * (flags &&& @signed)

    case rest do
      _refused when (flags &&& elem(fixed, 1)) != 0 ->
        scan(rest, pos + 1, pages, lengths, fixed, errors, nil, sums)

      <<_::binary-size(^covered), _crc::16, _::binary-size(^signed), magic, _::binary>>
      when magic not in [0xFD, 0xFE] ->
        scan(rest, pos + 1, pages, lengths, fixed, errors, nil, sums)

      _possible_or_incomplete ->
        scan(rest, pos + 1, pages, lengths, fixed, errors, pos, sums)
    end
  end

  # `covered` bytes of header and payload, `signed` bytes of signature. The guard is always true: it lets the compiler leave
  # out checks of each number.
  defp candidate(<<rest::binary>>, pos, pages, lengths, fixed, errors, open, sums, covered, signed, extra)
       when is_integer(pos) and pos in 0..@most and covered in 0..@longest and signed in 0..13 do
    {_spent, from, to, registers} = sums
    stop = pos + covered

    cond do
      stop <= to and pos >= from and extra in 0..255 and stop + signed + 3 <= elem(fixed, 3) ->
        <<_::binary-size(^covered), crc::16-little, _::binary>> = rest
        before = Checksums.register(registers, pos - from)
        behind = Checksums.register(registers, stop - from)

        cond do
          Checksums.frame(before, behind, covered, extra) == crc -> {{:good, pos}, errors, open, sums}
          open == nil -> scan(rest, pos + 1, pages, lengths, fixed, errors + 1, nil, sums)
          true -> scan(rest, pos + 1, pages, lengths, fixed, errors, open, sums)
        end

      stop + signed + 3 > elem(fixed, 3) ->
        incomplete(rest, pos, pages, lengths, fixed, errors, open, sums)

      true ->
        outside(rest, pos, pages, lengths, fixed, errors, open, sums, covered, signed, extra)
    end
  end

  # There is no window, or it ends here; or the id has several CRC_EXTRAs.
  defp outside(<<rest::binary>>, pos, pages, lengths, fixed, errors, open, sums, covered, signed, extra) do
    <<_::binary-size(^covered), crc::16-little, _::binary>> = rest

    case Checksums.reach(sums, elem(fixed, 4), pos, covered) do
      {:direct, sums} ->
        bytes = binary_part(elem(fixed, 4), pos, covered + 1)

        if extra |> List.wrap() |> Enum.any?(&(CRC.frame(bytes, covered, &1) == crc)),
          do: {{:good, pos}, errors, open, sums},
          else: wrong(rest, pos, pages, lengths, fixed, errors, open, sums)

      {:window, sums} when is_integer(extra) ->
        candidate(rest, pos, pages, lengths, fixed, errors, open, sums, covered, signed, extra)

      {:window, {_spent, from, _to, registers} = sums} ->
        before = Checksums.register(registers, pos - from)
        behind = Checksums.register(registers, pos - from + covered)

        if Enum.any?(extra, &(Checksums.frame(before, behind, covered, &1) == crc)),
          do: {{:good, pos}, errors, open, sums},
          else: wrong(rest, pos, pages, lengths, fixed, errors, open, sums)
    end
  end

  defp wrong(<<rest::binary>>, pos, pages, lengths, fixed, errors, nil, sums),
    do: scan(rest, pos + 1, pages, lengths, fixed, errors + 1, nil, sums)

  defp wrong(<<rest::binary>>, pos, pages, lengths, fixed, errors, open, sums),
    do: scan(rest, pos + 1, pages, lengths, fixed, errors, open, sums)

  # The header, or the frame of a known id, ends behind the data.
  defp incomplete(<<_::binary>>, pos, _pages, _lengths, {_, _, :stream, _, _, _}, errors, open, sums),
    do: {{:doubt, pos}, errors, open, sums}

  defp incomplete(<<rest::binary>>, pos, pages, lengths, fixed, errors, open, sums),
    do: scan(rest, pos + 1, pages, lengths, fixed, errors, open || pos, sums)

  @doc """
  Returns the next frame of an unknown id in `data` from `pos` on, `{:take, place, size}`, or the beginning of a frame that
  must wait for more bytes, `{:hold, place}`; and the number of wrong CRCs before it.

  `ahead` is the result of `good/6`, so no frame of a known id before it is good. The CRC of a frame of an unknown id cannot
  be checked. It is accepted if the byte behind it is a magic, or the data ends there, and no good frame begins inside it.
  """
  @spec open(binary(), non_neg_integer(), ahead(), Known.t(), 0..255, mode(), non_neg_integer()) ::
          {{:take, non_neg_integer(), pos_integer()} | {:hold, non_neg_integer()} | :none,
           errors :: non_neg_integer()}
  def open(data, pos, ahead, known, accepted, mode, errors) do
    <<_::binary-size(^pos), rest::binary>> = data
    fixed = fixed(data, known, accepted, mode)
    sift(rest, pos, known.pages, known.lengths, fixed, errors, limit(ahead, data), match?({:good, _}, ahead))
  end

  # The last place to search; if a good frame is ahead (`good?`), the byte before it.
  defp limit({:good, place}, _data), do: place - 1
  defp limit({:doubt, place}, _data), do: place
  defp limit(:none, data), do: byte_size(data)

  # Arguments keep their places and every call is a tail call, as in `scan/8`.
  defp sift(<<magic, _::binary>>, pos, _pages, _lengths, _fixed, errors, limit, _good?)
       when magic in [0xFD, 0xFE] and pos > limit,
       do: {:none, errors}

  defp sift(<<0xFE, rest::binary>>, pos, pages, lengths, fixed, errors, limit, good?) do
    case rest do
      <<_len, _seq, 0, _component, _id, _::binary>> ->
        sift(rest, pos + 1, pages, lengths, fixed, errors, limit, good?)

      <<len, _seq, _system, _component, id, _::binary>> ->
        case elem(elem(pages, 0), id) do
          nil ->
            unknown(rest, pos, pages, lengths, fixed, errors, limit, good?, 5 + len, 0)

          _extra ->
            case elem(lengths, id) do
              length when is_integer(length) and length != len ->
                sift(rest, pos + 1, pages, lengths, fixed, errors, limit, good?)

              _same_or_disputed ->
                known(rest, pos, pages, lengths, fixed, errors, limit, good?, 5 + len, 0)
            end
        end

      _incomplete ->
        wait(rest, pos, pages, lengths, fixed, errors, limit, good?)
    end
  end

  defp sift(<<0xFD, rest::binary>>, pos, pages, lengths, fixed, errors, limit, good?) do
    case rest do
      <<len, flags, _::2-binary, system, _component, id::24-little, _::binary>>
      when (flags &&& @source32) == 0 ->
        if system == 0,
          do: sift(rest, pos + 1, pages, lengths, fixed, errors, limit, good?),
          else: sift2(rest, pos, pages, lengths, fixed, errors, limit, good?, 9 + len, flags, id)

      <<len, flags, _::2-binary, system::32, _component, id::24-little, _::binary>>
      when (flags &&& @source32) != 0 ->
        if system == 0,
          do: sift(rest, pos + 1, pages, lengths, fixed, errors, limit, good?),
          else: sift2(rest, pos, pages, lengths, fixed, errors, limit, good?, 12 + len, flags, id)

      _incomplete ->
        wait(rest, pos, pages, lengths, fixed, errors, limit, good?)
    end
  end

  defp sift(<<_, rest::binary>>, pos, pages, lengths, fixed, errors, limit, good?),
    do: sift(rest, pos + 1, pages, lengths, fixed, errors, limit, good?)

  defp sift(<<>>, _pos, _pages, _lengths, _fixed, errors, _limit, _good?), do: {:none, errors}

  # `covered` as with short ids.
  defp sift2(<<rest::binary>>, pos, pages, lengths, fixed, errors, limit, good?, covered, flags, id)
       when id < @direct do
    case elem(elem(pages, id >>> 8), id &&& 0xFF) do
      nil -> unknown(rest, pos, pages, lengths, fixed, errors, limit, good?, covered, flags)
      _extra -> known(rest, pos, pages, lengths, fixed, errors, limit, good?, covered, flags)
    end
  end

  defp sift2(<<rest::binary>>, pos, pages, lengths, fixed, errors, limit, good?, covered, flags, _id)
       when elem(fixed, 5) == [],
       do: unknown(rest, pos, pages, lengths, fixed, errors, limit, good?, covered, flags)

  defp sift2(<<rest::binary>>, pos, pages, lengths, fixed, errors, limit, good?, covered, flags, id) do
    if Known.extra(elem(fixed, 0), id) == nil,
      do: unknown(rest, pos, pages, lengths, fixed, errors, limit, good?, covered, flags),
      else: known(rest, pos, pages, lengths, fixed, errors, limit, good?, covered, flags)
  end

  # A known id: the frame is incomplete, or its CRC is wrong, because a good one would be ahead.
  defp known(<<rest::binary>>, pos, pages, lengths, fixed, errors, limit, good?, covered, flags) do
    if pos + 3 + covered + (flags &&& @target32) + 13 * (flags &&& @signed) > elem(fixed, 3),
      do: wait(rest, pos, pages, lengths, fixed, errors, limit, good?),
      else: sift(rest, pos + 1, pages, lengths, fixed, errors + 1, limit, good?)
  end

  # An unknown id: its flags (F6) and the byte behind it say whether it may be a frame. It cannot contain a good one. In a
  # stream, what is inside must have been looked at, and the byte behind it must be there.
  defp unknown(<<rest::binary>>, pos, pages, lengths, fixed, errors, limit, true, covered, _flags)
       when pos + covered + 2 > limit,
       do: sift(rest, pos + 1, pages, lengths, fixed, errors, limit, true)

  defp unknown(<<rest::binary>>, pos, pages, lengths, fixed, errors, limit, good?, covered, flags) do
    size = covered + (flags &&& @target32) + 2 + 13 * (flags &&& @signed)
    stop = pos + 1 + size

    case rest do
      _refused when (flags &&& elem(fixed, 1)) != 0 or (good? and stop > limit + 1) ->
        sift(rest, pos + 1, pages, lengths, fixed, errors, limit, good?)

      <<_::binary-size(^size), magic, _::binary>> when magic not in [0xFD, 0xFE] ->
        sift(rest, pos + 1, pages, lengths, fixed, errors, limit, good?)

      _incomplete when stop > elem(fixed, 3) ->
        wait(rest, pos, pages, lengths, fixed, errors, limit, good?)

      _unsure when elem(fixed, 2) == :stream and not good? and (stop > limit or stop == elem(fixed, 3)) ->
        {{:hold, pos}, errors}

      _possible ->
        {{:take, pos, stop - pos}, errors}
    end
  end

  # The frame that begins here is not complete.
  defp wait(<<rest::binary>>, pos, pages, lengths, fixed, errors, limit, good?)
       when good? or elem(fixed, 2) == :final,
       do: sift(rest, pos + 1, pages, lengths, fixed, errors, limit, good?)

  defp wait(<<_::binary>>, pos, _pages, _lengths, _fixed, errors, _limit, _good?), do: {{:hold, pos}, errors}
end
