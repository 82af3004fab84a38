defmodule MavCodec.Parser.Candidate do
  @moduledoc """
  Judges whether some bytes start with a frame. Used where the parser's fast path does not apply.
  """

  import Bitwise

  alias MavCodec.{CRC, Frame}
  alias MavCodec.Parser.Known

  # The flags whose layout is known, whether or not the parser accepts them: signed, 32-bit source, 32-bit target.
  @layout_flags 0x07

  @typedoc """
    * `{:good, size, extra}` - a frame of a known id with the right CRC
    * `{:incompatible, size}` - the same, with incompatibility flags that this parser must not accept (F6)
    * `{:unknown, size}` - could be a frame of an unknown id; its own bytes say no more
    * `{:bad_crc, size}` - a known id, a complete frame, a wrong CRC
    * `:noise` - cannot be the start of a frame
    * `:more` - too few bytes to tell
  """
  @type verdict ::
          {:good, pos_integer(), 0..255}
          | {:incompatible, pos_integer()}
          | {:unknown, pos_integer()}
          | {:bad_crc, pos_integer()}
          | :noise
          | :more

  @doc "Judges the start of `data`. `accepted` are the incompatibility flags that the parser takes."
  @spec classify(binary(), Known.t(), 0..255) :: verdict()
  def classify(data, known, accepted) do
    case Frame.header(data) do
      # F3: no frame comes from system 0.
      {:ok, _header, _len, _size, _id, 0} ->
        :noise

      {:ok, header, len, size, id, _system} ->
        classify(data, header + len, size, Known.extra(known, id), accepted)

      :more ->
        :more

      :error ->
        :noise
    end
  end

  defp classify(data, covered, size, extra, accepted) do
    cond do
      byte_size(data) < size -> :more
      extra == nil -> unknown(data, size, accepted)
      matched = match(data, covered, extra) -> good(data, size, matched, accepted)
      true -> {:bad_crc, size}
    end
  end

  defp good(data, size, extra, accepted) do
    if acceptable?(data, accepted), do: {:good, size, extra}, else: {:incompatible, size}
  end

  # Neither CRC nor flags can be trusted. With flags that are not accepted it is dropped in any case (F6).
  defp unknown(data, size, accepted), do: if(acceptable?(data, accepted), do: {:unknown, size}, else: :noise)

  defp acceptable?(<<0xFD, _len, incompat, _::binary>>, accepted), do: (incompat &&& bnot(accepted)) == 0
  defp acceptable?(_v1, _accepted), do: true

  # `covered` counts header and payload with the magic, which the CRC leaves out.
  defp match(data, covered, extras) do
    <<_::binary-size(^covered), crc::16-little, _::binary>> = data
    extras |> List.wrap() |> Enum.find(&(CRC.frame(data, covered - 1, &1) == crc))
  end

  @doc "The incompatibility flags that a parser accepts: the signature, and with `sysid32` those of 2.1 (N1, N3)."
  @spec accepted_flags(boolean()) :: 0..255
  def accepted_flags(true), do: @layout_flags
  def accepted_flags(false), do: 0x01
end
