defmodule Phoenix.HTML.Escape do
  @moduledoc false
  # Escapes `& < > " '`, and shows what is not seen and changes what is (controls, signs of direction) as U+FFFD. Text without any
  # of them, the common case, is returned unchanged.

  @unseen Enum.concat([
            Enum.to_list(0x00..0x1F) -- [?\t, ?\n, ?\r],
            0x7F..0x9F,
            [0x61C],
            0x200B..0x200F,
            0x2028..0x202E,
            0x2060..0x206F
          ])

  @spec text(binary()) :: iodata()
  def text(text), do: scan(text, text, 0, 0, [])

  for {character, escaped} <- [{?&, "&amp;"}, {?<, "&lt;"}, {?>, "&gt;"}, {?", "&quot;"}, {?', "&#39;"}] do
    defp scan(<<unquote(character), rest::binary>>, all, from, length, done) do
      done = [done, binary_part(all, from, length), unquote(escaped)]
      scan(rest, all, from + length + 1, 0, done)
    end
  end

  for character <- @unseen, bytes = <<character::utf8>> do
    defp scan(<<unquote(bytes), rest::binary>>, all, from, length, done) do
      done = [done, binary_part(all, from, length), "\uFFFD"]
      scan(rest, all, from + length + unquote(byte_size(bytes)), 0, done)
    end
  end

  defp scan(<<_, rest::binary>>, all, from, length, done), do: scan(rest, all, from, length + 1, done)
  defp scan(<<>>, all, 0, _length, []), do: all
  defp scan(<<>>, all, from, length, done), do: [done, binary_part(all, from, length)]
end
