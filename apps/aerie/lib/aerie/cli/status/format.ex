defmodule Aerie.CLI.Status.Format do
  @moduledoc "Formats values for an operator. An unknown value is a dash, never a zero."

  @unknown "-"

  @doc "A number with `decimals` places and a unit."
  @spec number(number() | nil, non_neg_integer(), String.t()) :: String.t()
  def number(value, decimals, unit \\ "")
  def number(value, 0, unit) when is_number(value), do: "#{round(value)}#{unit}"

  def number(value, decimals, unit) when is_number(value),
    do: :erlang.float_to_binary(value * 1.0, decimals: decimals) <> unit

  def number(_unknown, _decimals, _unit), do: @unknown

  @doc "A share from 0 to 1 as per cent."
  @spec percent(number() | nil) :: String.t()
  def percent(share) when is_number(share), do: "#{round(share * 100)}%"
  def percent(_unknown), do: @unknown

  @doc "A text, or a dash if there is none. Control characters are dropped, because they could steer the terminal."
  @spec text(term()) :: String.t()
  def text(nil), do: @unknown
  def text(value), do: value |> to_string() |> Aerie.Base.Printable.line("")

  @doc "An age in microseconds, as text; a dash if it is not known."
  @spec age(integer() | nil) :: String.t()
  def age(nil), do: @unknown
  def age(us) when us < 0, do: "0 s"
  def age(us) when us < 10_000_000, do: number(us / 1_000_000, 1, " s")
  def age(us), do: duration(us)

  @doc "A duration in microseconds, as text: `42 s`, `3 min`, `2 h 5 min`."
  @spec duration(integer()) :: String.t()
  def duration(us) do
    seconds = div(us, 1_000_000)

    cond do
      seconds < 120 -> "#{seconds} s"
      seconds < 7200 -> "#{div(seconds, 60)} min"
      true -> "#{div(seconds, 3600)} h #{div(rem(seconds, 3600), 60)} min"
    end
  end

  @doc "A text cut or padded to exactly `width` columns; a cut text ends with `…`."
  @spec fit(String.t(), pos_integer(), :left | :right) :: String.t()
  def fit(text, width, side \\ :left) do
    length = String.length(text)

    cond do
      length > width -> String.slice(text, 0, width - 1) <> "…"
      side == :left -> text <> String.duplicate(" ", width - length)
      true -> String.duplicate(" ", width - length) <> text
    end
  end
end
