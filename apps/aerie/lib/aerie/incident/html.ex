defmodule Aerie.Incident.Html do
  @moduledoc "Texts of a page. Names and status texts come from outside: every text goes through `text/1` or `line/1`. Pure."

  alias Aerie.Base.Printable

  @longest 600

  @doc "A text for HTML: `line/1`, escaped."
  @spec text(term()) :: String.t()
  def text(text) do
    text
    |> line()
    |> String.replace("&", "&amp;")
    |> String.replace("<", "&lt;")
    |> String.replace(">", "&gt;")
    |> String.replace("\"", "&quot;")
    |> String.replace("'", "&#39;")
  end

  @doc "A text on one line, without characters that are not seen, and cut if it is very long."
  @spec line(term()) :: String.t()
  def line(nil), do: ""

  def line(text) when is_binary(text) do
    text = Printable.line(text)
    if String.length(text) > @longest, do: String.slice(text, 0, @longest) <> " …", else: text
  end

  def line(other), do: other |> to_string() |> line()

  @doc "The time of day of unix microseconds, in UTC."
  @spec clock(integer()) :: String.t()
  def clock(us), do: us |> DateTime.from_unix!(:microsecond) |> Calendar.strftime("%H:%M:%S")

  @doc "A time of day with tenths of a second."
  @spec tenths(integer()) :: String.t()
  def tenths(us), do: "#{clock(us)}.#{us |> Integer.mod(1_000_000) |> div(100_000)}"
end
