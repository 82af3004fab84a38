defmodule Aerie.Incident.Html do
  @moduledoc "Text and numbers for HTML and SVG. Names and status texts come from outside: every text goes through `text/1`. Pure."

  alias Aerie.Base.Printable

  @longest 600

  @doc "A text: escaped, on one line, without characters that are not seen, and cut if it is very long."
  @spec text(term()) :: String.t()
  def text(nil), do: ""

  def text(text) when is_binary(text) do
    text = Printable.line(text)
    text = if String.length(text) > @longest, do: String.slice(text, 0, @longest) <> " …", else: text

    text
    |> String.replace("&", "&amp;")
    |> String.replace("<", "&lt;")
    |> String.replace(">", "&gt;")
    |> String.replace("\"", "&quot;")
    |> String.replace("'", "&#39;")
  end

  def text(other), do: other |> to_string() |> text()

  @doc "A coordinate within a drawing."
  @spec coordinate(number()) :: String.t()
  def coordinate(number), do: :erlang.float_to_binary(number * 1.0, decimals: 1)

  @doc "A value of a plot, with as many decimals as its size makes useful."
  @spec number(number()) :: String.t()
  def number(number) do
    decimals = if(abs(number) >= 100, do: 0, else: if(abs(number) >= 10, do: 1, else: 2))
    :erlang.float_to_binary(number * 1.0, decimals: decimals)
  end

  @doc "The time of day of unix microseconds, in UTC."
  @spec clock(integer()) :: String.t()
  def clock(us), do: us |> DateTime.from_unix!(:microsecond) |> Calendar.strftime("%H:%M:%S")

  @doc "A time of day with tenths of a second."
  @spec tenths(integer()) :: String.t()
  def tenths(us), do: "#{clock(us)}.#{us |> Integer.mod(1_000_000) |> div(100_000)}"
end
