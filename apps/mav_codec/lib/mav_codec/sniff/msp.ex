defmodule MavCodec.Sniff.Msp do
  @moduledoc """
  Finds MSP, which Betaflight and iNav speak (Q1): `$M` and `$X`, each with `<` (request), `>` (answer) or `!` (refusal).
  """

  import Bitwise

  alias MavCodec.Sniff
  alias MavCodec.Sniff.Crc8

  @directions ~c"<>!"

  @doc "One finding for each version that occurs."
  @spec scan(binary) :: [Sniff.found()]
  def scan(bytes) do
    messages = messages(bytes, [])
    Enum.map(Enum.group_by(messages, &elem(&1, 0)), fn {version, found} -> found(version, found) end)
  end

  defp found(version, messages) do
    answers = Enum.count(messages, fn {_version, direction, _size} -> direction != ?< end)

    %{
      protocol: version,
      units: length(messages),
      bytes: messages |> Enum.map(&elem(&1, 2)) |> Enum.sum(),
      chance: 0.01,
      evidence: "#{Sniff.Words.count(length(messages), "message")}, #{answers} of them answers"
    }
  end

  # Continues behind a message, otherwise one byte further.
  defp messages(<<"$", _::binary>> = bytes, found) do
    case message(bytes) do
      {:ok, version, direction, size} ->
        messages(binary_part(bytes, size, byte_size(bytes) - size), [{version, direction, size} | found])

      :none ->
        messages(binary_part(bytes, 1, byte_size(bytes) - 1), found)
    end
  end

  defp messages(<<_byte, rest::binary>>, found), do: messages(rest, found)
  defp messages(<<>>, found), do: found

  # A size of 255 means that the real size follows in 16 bits.
  defp message(<<"$M", direction, 255, command, size::16-little, payload::binary-size(size), sum, _::binary>>)
       when direction in @directions do
    checked(xor([255, command, size &&& 0xFF, size >>> 8], payload) == sum, :msp1, direction, 8 + size)
  end

  defp message(<<"$M", direction, size, command, payload::binary-size(size), sum, _::binary>>)
       when direction in @directions do
    checked(xor([size, command], payload) == sum, :msp1, direction, 6 + size)
  end

  defp message(
         <<"$X", direction, flag, code::16, size::16-little, payload::binary-size(size), crc, _::binary>>
       )
       when direction in @directions do
    good? = Crc8.of(<<flag, code::16, size::16-little, payload::binary>>) == crc
    checked(good?, :msp2, direction, 9 + size)
  end

  defp message(_other), do: :none

  defp checked(true, version, direction, size), do: {:ok, version, direction, size}
  defp checked(false, _version, _direction, _size), do: :none

  defp xor(head, payload),
    do: for(<<byte <- payload>>, reduce: Enum.reduce(head, 0, &bxor/2), do: (sum -> bxor(sum, byte)))
end
