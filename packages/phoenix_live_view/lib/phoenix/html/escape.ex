defmodule Phoenix.HTML.Escape do
  @moduledoc false
  # Escapes `& < > " '`. Text without any of them, the common case, is returned unchanged.

  @spec text(binary()) :: iodata()
  def text(text), do: scan(text, text, 0, 0, [])

  for {character, escaped} <- [{?&, "&amp;"}, {?<, "&lt;"}, {?>, "&gt;"}, {?", "&quot;"}, {?', "&#39;"}] do
    defp scan(<<unquote(character), rest::binary>>, all, from, length, done) do
      done = [done, binary_part(all, from, length), unquote(escaped)]
      scan(rest, all, from + length + 1, 0, done)
    end
  end

  defp scan(<<_, rest::binary>>, all, from, length, done), do: scan(rest, all, from, length + 1, done)
  defp scan(<<>>, all, 0, _length, []), do: all
  defp scan(<<>>, all, from, length, done), do: [done, binary_part(all, from, length)]
end
