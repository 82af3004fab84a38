defmodule MavCodec.Parser.Search do
  @moduledoc """
  Searches bytes that do not start with a good frame for the next frames, in one pass.

  `good/6` looks ahead for the next frame of a known id with the right CRC; `open/7` for what may be a frame of an unknown id
  or the beginning of one that is not complete. Both do a bounded amount of work for each byte, whatever the bytes are
  (`MavCodec.Parser.Checksums`), and neither makes anything for a byte that is none of it.

  MAVLink 1 has no extensions and cuts nothing, so here, behind damage, a header of version 1 counts only when its length is
  the message's own (F9). Where a frame is due, the scanner does not ask for that.
  """

  import Bitwise

  require MavCodec.Parser.Checksums

  alias MavCodec.CRC
  alias MavCodec.Parser.{Checksums, Known}

  @direct Known.direct_size()
  @signed 0x01
  @source32 0x02
  @target32 0x04
  # Header without the magic, and payload; and more bytes than any read has.
  @longest 16 + 255
  @most 0xFFFF_FFFF_FFFF

  @typedoc """
    * `{:good, place}` - a frame of a known id with the right CRC
    * `{:doubt, place}` - in a stream, the beginning of a frame of a known id: nothing behind it was looked at
    * `:none` - neither, up to the end of the data
  """
  @type ahead :: {:good | :doubt, non_neg_integer()} | :none

  @doc """
  The next good frame of `data` from `pos` on; how many wrong CRCs were before it, or before the first place that `open/7`
  should look at; and that place, or `nil`.
  """
  @spec good(binary(), non_neg_integer(), Known.t(), 0..255, boolean(), Checksums.t()) ::
          {ahead(), errors :: non_neg_integer(), open :: non_neg_integer() | nil, Checksums.t()}
  def good(data, pos, known, accepted, stream?, sums) do
    <<_::binary-size(^pos), rest::binary>> = data
    fixed = fixed(data, known, accepted, stream?)
    look(rest, pos, known.pages, known.lengths, fixed, 0, nil, sums)
  end

  # What stays the same; `refused` are the flags of frames that are not taken (F6).
  defp fixed(data, known, accepted, stream?),
    do: {known, 0xFF - accepted, stream?, byte_size(data), data, known.others}

  # This and its helpers begin with a match, so that the runtime makes no binary for what remains, and keep their arguments
  # in their places, so that nothing is moved.
  defp look(<<0xFE, rest::binary>>, pos, pages, lengths, fixed, errors, open, sums) do
    case rest do
      <<len, _seq, system, _component, id, _::binary>> when system > 0 ->
        case elem(lengths, id) do
          ^len ->
            extra = elem(elem(pages, 0), id)
            candidate(rest, pos, pages, lengths, fixed, errors, open, sums, 5 + len, 0, extra)

          other when is_integer(other) ->
            look(rest, pos + 1, pages, lengths, fixed, errors, open, sums)

          nil ->
            case elem(elem(pages, 0), id) do
              nil when open == nil -> nobody(rest, pos, pages, lengths, fixed, errors, nil, sums, 5 + len, 0)
              nil -> look(rest, pos + 1, pages, lengths, fixed, errors, open, sums)
              extra -> candidate(rest, pos, pages, lengths, fixed, errors, open, sums, 5 + len, 0, extra)
            end
        end

      <<_::5-binary, _::binary>> ->
        look(rest, pos + 1, pages, lengths, fixed, errors, open, sums)

      _incomplete ->
        incomplete(rest, pos, pages, lengths, fixed, errors, open, sums)
    end
  end

  defp look(<<0xFD, rest::binary>>, pos, pages, lengths, fixed, errors, open, sums) do
    case rest do
      <<len, flags, _::2-binary, system, _component, id::24-little, _::binary>>
      when (flags &&& @source32) == 0 ->
        if system == 0,
          do: look(rest, pos + 1, pages, lengths, fixed, errors, open, sums),
          else: v2(rest, pos, pages, lengths, fixed, errors, open, sums, 9 + len, flags, id)

      <<len, flags, _::2-binary, system::32, _component, id::24-little, _::binary>>
      when (flags &&& @source32) != 0 ->
        if system == 0,
          do: look(rest, pos + 1, pages, lengths, fixed, errors, open, sums),
          else: v2(rest, pos, pages, lengths, fixed, errors, open, sums, 12 + len, flags, id)

      _incomplete ->
        incomplete(rest, pos, pages, lengths, fixed, errors, open, sums)
    end
  end

  defp look(<<_, rest::binary>>, pos, pages, lengths, fixed, errors, open, sums),
    do: look(rest, pos + 1, pages, lengths, fixed, errors, open, sums)

  defp look(<<>>, _pos, _pages, _lengths, _fixed, errors, open, sums), do: {:none, errors, open, sums}

  # Here is nothing but tail calls: another call would put aside all that the loop holds. `covered` as with short ids.
  defp v2(<<rest::binary>>, pos, pages, lengths, fixed, errors, open, sums, covered, flags, id)
       when id < @direct do
    case elem(elem(pages, id >>> 8), id &&& 0xFF) do
      nil when open == nil and (flags &&& elem(fixed, 1)) == 0 ->
        nobody(rest, pos, pages, lengths, fixed, errors, nil, sums, covered + (flags &&& @target32), flags)

      nil ->
        look(rest, pos + 1, pages, lengths, fixed, errors, open, sums)

      extra ->
        covered = covered + (flags &&& @target32)
        signed = 13 * (flags &&& @signed)
        candidate(rest, pos, pages, lengths, fixed, errors, open, sums, covered, signed, extra)
    end
  end

  defp v2(<<rest::binary>>, pos, pages, lengths, fixed, errors, open, sums, _covered, flags, _id)
       when elem(fixed, 5) == [] and (open != nil or (flags &&& elem(fixed, 1)) != 0),
       do: look(rest, pos + 1, pages, lengths, fixed, errors, open, sums)

  defp v2(<<rest::binary>>, pos, pages, lengths, fixed, errors, open, sums, covered, flags, id) do
    covered = covered + (flags &&& @target32)

    case Known.extra(elem(fixed, 0), id) do
      nil when open == nil ->
        nobody(rest, pos, pages, lengths, fixed, errors, nil, sums, covered, flags)

      nil ->
        look(rest, pos + 1, pages, lengths, fixed, errors, open, sums)

      extra ->
        signed = 13 * (flags &&& @signed)
        candidate(rest, pos, pages, lengths, fixed, errors, open, sums, covered, signed, extra)
    end
  end

  # An unknown id: the first place that may be a frame is remembered.
  defp nobody(<<rest::binary>>, pos, pages, lengths, fixed, errors, nil, sums, covered, flags) do
    if unknown(pos, covered, flags, fixed) == :noise,
      do: look(rest, pos + 1, pages, lengths, fixed, errors, nil, sums),
      else: look(rest, pos + 1, pages, lengths, fixed, errors, pos, sums)
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
          open == nil -> look(rest, pos + 1, pages, lengths, fixed, errors + 1, nil, sums)
          true -> look(rest, pos + 1, pages, lengths, fixed, errors, open, sums)
        end

      stop + signed + 3 > elem(fixed, 3) ->
        incomplete(rest, pos, pages, lengths, fixed, errors, open, sums)

      true ->
        outside(rest, pos, pages, lengths, fixed, errors, open, sums, covered, signed, extra)
    end
  end

  # No window, or it ends here; or several CRC_EXTRAs, each of which is as good as a header of its own.
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
    do: look(rest, pos + 1, pages, lengths, fixed, errors + 1, nil, sums)

  defp wrong(<<rest::binary>>, pos, pages, lengths, fixed, errors, open, sums),
    do: look(rest, pos + 1, pages, lengths, fixed, errors, open, sums)

  # The header, or the frame of a known id, ends behind the data.
  defp incomplete(<<_::binary>>, pos, _pages, _lengths, {_, _, true, _, _, _}, errors, open, sums),
    do: {{:doubt, pos}, errors, open, sums}

  defp incomplete(<<rest::binary>>, pos, pages, lengths, fixed, errors, open, sums),
    do: look(rest, pos + 1, pages, lengths, fixed, errors, open || pos, sums)

  @doc """
  The next place of `data` from `pos` on that is a frame of an unknown id, `{:take, place, size}`, or
  the beginning of a frame that must be waited for, `{:hold, place}`; and how many wrong CRCs were before it.

  `ahead` is what `good/6` found, so none of the known ids before it is good. A frame of an unknown id has no CRC that
  could be checked. It is believed when the byte behind it is a magic, or the data ends there, and no good frame begins
  inside it.
  """
  @spec open(
          binary(),
          non_neg_integer(),
          ahead(),
          Known.t(),
          0..255,
          :stream | :datagram | :final,
          non_neg_integer()
        ) ::
          {{:take, non_neg_integer(), pos_integer()} | {:hold, non_neg_integer()} | :none,
           errors :: non_neg_integer()}
  def open(data, pos, ahead, known, accepted, mode, errors) do
    <<_::binary-size(^pos), rest::binary>> = data
    limit = limit(ahead, data)
    sift(rest, pos, limit, ahead, fixed(data, known, accepted, mode == :stream), mode, errors)
  end

  # The last place to look at.
  defp limit({:good, place}, _data), do: place - 1
  defp limit({:doubt, place}, _data), do: place
  defp limit(:none, data), do: byte_size(data)

  # This and its helpers begin with a match, so that the runtime makes no binary for what remains.
  defp sift(<<magic, _::binary>>, pos, limit, _ahead, _fixed, _mode, errors)
       when magic in [0xFD, 0xFE] and pos > limit,
       do: {:none, errors}

  defp sift(<<0xFE, rest::binary>>, pos, limit, ahead, {known, _, _, size, _, _} = fixed, mode, errors) do
    case rest do
      <<_len, _seq, 0, _component, _id, _::binary>> ->
        sift(rest, pos + 1, limit, ahead, fixed, mode, errors)

      <<len, _seq, _system, _component, id, _::binary>> ->
        cond do
          elem(elem(known.pages, 0), id) == nil ->
            claim(rest, pos, unknown(pos, 5 + len, 0, fixed), limit, ahead, fixed, mode, errors)

          other_length?(elem(known.lengths, id), len) ->
            sift(rest, pos + 1, limit, ahead, fixed, mode, errors)

          pos + 8 + len > size ->
            claim(rest, pos, :more, limit, ahead, fixed, mode, errors)

          true ->
            sift(rest, pos + 1, limit, ahead, fixed, mode, errors + 1)
        end

      _incomplete ->
        claim(rest, pos, :more, limit, ahead, fixed, mode, errors)
    end
  end

  defp sift(<<0xFD, rest::binary>>, pos, limit, ahead, fixed, mode, errors) do
    case rest do
      <<len, flags, _::2-binary, system, _component, id::24-little, _::binary>>
      when (flags &&& @source32) == 0 ->
        sift2(rest, pos, 9, len, flags, system, id, limit, ahead, fixed, mode, errors)

      <<len, flags, _::2-binary, system::32, _component, id::24-little, _::binary>>
      when (flags &&& @source32) != 0 ->
        sift2(rest, pos, 12, len, flags, system, id, limit, ahead, fixed, mode, errors)

      _incomplete ->
        claim(rest, pos, :more, limit, ahead, fixed, mode, errors)
    end
  end

  defp sift(<<_, rest::binary>>, pos, limit, ahead, fixed, mode, errors),
    do: sift(rest, pos + 1, limit, ahead, fixed, mode, errors)

  defp sift(<<>>, _pos, _limit, _ahead, _fixed, _mode, errors), do: {:none, errors}

  defp other_length?(length, len), do: length != nil and length != len

  defp sift2(<<rest::binary>>, pos, _header, _len, _flags, 0, _id, limit, ahead, fixed, mode, errors),
    do: sift(rest, pos + 1, limit, ahead, fixed, mode, errors)

  defp sift2(<<rest::binary>>, pos, header, len, flags, _system, id, limit, ahead, fixed, mode, errors) do
    header = if (flags &&& @target32) == 0, do: header, else: header + 4

    cond do
      Known.extra(elem(fixed, 0), id) == nil ->
        claim(rest, pos, unknown(pos, header + len, flags, fixed), limit, ahead, fixed, mode, errors)

      pos + 3 + header + len + 13 * (flags &&& @signed) > elem(fixed, 3) ->
        claim(rest, pos, :more, limit, ahead, fixed, mode, errors)

      true ->
        sift(rest, pos + 1, limit, ahead, fixed, mode, errors + 1)
    end
  end

  # A good frame begins within what is claimed, or behind it.
  defp claim(<<rest::binary>>, pos, what, limit, {:good, good} = ahead, fixed, mode, errors) do
    case what do
      {:ends, stop} when stop <= good -> {{:take, pos, stop - pos}, errors}
      _noise -> sift(rest, pos + 1, limit, ahead, fixed, mode, errors)
    end
  end

  # A stream: what is inside must be known, and one byte that follows.
  defp claim(<<_::binary>>, pos, {:ends, stop}, limit, _ahead, {_, _, true, size, _, _}, _mode, errors) do
    if stop <= limit and stop < size,
      do: {{:take, pos, stop - pos}, errors},
      else: {{:hold, pos}, errors}
  end

  defp claim(<<_::binary>>, pos, {:ends, stop}, _limit, _ahead, _fixed, _mode, errors),
    do: {{:take, pos, stop - pos}, errors}

  defp claim(<<_::binary>>, pos, :more, _limit, _ahead, _fixed, mode, errors) when mode != :final,
    do: {{:hold, pos}, errors}

  defp claim(<<rest::binary>>, pos, _noise, limit, ahead, fixed, mode, errors),
    do: sift(rest, pos + 1, limit, ahead, fixed, mode, errors)

  # Where a frame of an unknown id would end, if it may be one by its flags (F6) and the byte behind it.
  defp unknown(pos, covered, flags, {_known, refused, _stream?, size, data, _others}) do
    stop = pos + 3 + covered + 13 * (flags &&& @signed)

    cond do
      (flags &&& refused) != 0 -> :noise
      stop > size -> :more
      stop == size -> {:ends, stop}
      :binary.at(data, stop) in [0xFD, 0xFE] -> {:ends, stop}
      true -> :noise
    end
  end
end
