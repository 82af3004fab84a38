defmodule Aerie.Base.Printable do
  @moduledoc """
  Text from outside for a terminal. A vehicle's texts, names of files and the like may have characters that are not seen and do
  something: escape sequences, and signs that reverse the direction of what follows, so that it reads as something else.
  """

  # Controls (C0, DEL, C1), signs of direction and of joining, invisible operators, line and paragraph separators, tags.
  @unseen "\\x{00}-\\x{1f}\\x{7f}-\\x{9f}\\x{ad}\\x{61c}\\x{180e}\\x{200b}-\\x{200f}\\x{2028}-\\x{202e}\\x{2060}-\\x{206f}" <>
            "\\x{feff}\\x{fff9}-\\x{fffb}\\x{e0000}-\\x{e007f}"

  @doc "A text of one line: what is not seen, or not UTF-8, is replaced."
  @spec line(binary(), String.t()) :: String.t()
  def line(text, sign \\ "?"),
    do: text |> String.replace_invalid(sign) |> String.replace(~r/[#{@unseen}]/u, sign)

  @doc """
  Lines of text, or JSON: what is not seen is written as `\\u202E`, which is the same for a reader of JSON. Tabs and ends of lines stay.
  """
  @spec lines(iodata() | IO.chardata()) :: String.t()
  def lines(text) do
    text = with {_error, _done, _rest} <- :unicode.characters_to_binary(text), do: IO.iodata_to_binary(text)
    text = String.replace_invalid(text)
    Regex.replace(~r/(?![\t\n\r])[#{@unseen}]/u, text, &escape/1)
  end

  @doc "The escape of a character."
  @spec escape(String.t()) :: String.t()
  def escape(character),
    do: for(<<unit::16 <- :unicode.characters_to_binary(character, :utf8, :utf16)>>, into: "", do: unit(unit))

  defp unit(unit),
    do: "\\u" <> (unit |> Integer.to_string(16) |> String.downcase() |> String.pad_leading(4, "0"))
end
