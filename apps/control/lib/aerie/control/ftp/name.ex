defmodule Aerie.Control.Ftp.Name do
  @moduledoc """
  The names of files on a vehicle, as text. A vehicle's names are bytes: those of a card that was written elsewhere may be in Latin-1,
  or cut in the middle of a character.

  What is not UTF-8, and control characters, are written as `\\xE9`, byte by byte, and read back so that the file can be asked for. A name that has such
  characters itself has its backslash as `\\x5C`. What can be seen of ASCII has no other form, so that nothing is hidden from a reader of
  the text.
  """

  @doc "The text of a name or path."
  @spec text(binary()) :: String.t()
  def text(bytes), do: text(bytes, [])

  defp text(<<"\\x", high, low, rest::binary>> = bytes, text) do
    if byte(high, low), do: text(<<"x", high, low, rest::binary>>, [text, "\\x5C"]), else: plain(bytes, text)
  end

  defp text(bytes, text), do: plain(bytes, text)

  defp plain(<<control, rest::binary>>, text) when control in 1..31 or control == 127,
    do: text(rest, [text, "\\x", Base.encode16(<<control>>)])

  defp plain(<<character::utf8, rest::binary>>, text), do: text(rest, [text, <<character::utf8>>])
  defp plain(<<byte, rest::binary>>, text), do: text(rest, [text, "\\x", Base.encode16(<<byte>>)])
  defp plain(<<>>, text), do: IO.iodata_to_binary(text)

  @doc "The bytes of a text."
  @spec bytes(String.t()) :: binary()
  def bytes(text), do: bytes(text, [])

  defp bytes(<<"\\x", high, low, rest::binary>>, bytes) do
    case byte(high, low) do
      nil -> bytes(<<"x", high, low, rest::binary>>, [bytes, "\\"])
      byte -> bytes(rest, [bytes, byte])
    end
  end

  defp bytes(<<byte, rest::binary>>, bytes), do: bytes(rest, [bytes, byte])
  defp bytes(<<>>, bytes), do: IO.iodata_to_binary(bytes)

  # A byte of no visible character of ASCII, or the backslash. A name has no NUL.
  defp byte(high, low) when (high in ?0..?9 or high in ?A..?F) and (low in ?0..?9 or low in ?A..?F) do
    byte = digit(high) * 16 + digit(low)
    if byte in 1..31 or byte >= 127 or byte == ?\\, do: byte
  end

  defp byte(_high, _low), do: nil

  defp digit(digit) when digit in ?0..?9, do: digit - ?0
  defp digit(digit), do: digit - ?A + 10
end
