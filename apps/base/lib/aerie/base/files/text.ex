defmodule Aerie.Base.Files.Text do
  @moduledoc """
  What the readers of text files that other programs wrote have in common. Pure.

  A byte order mark is skipped. `#` begins a comment. Only comments may have bytes that are not UTF-8: some programs write
  them in Latin-1.
  """

  @bom <<0xEF, 0xBB, 0xBF>>
  # A vehicle has no numbers with more digits, and they take long to convert.
  @max_number 64
  @decimal ~r/\A([+-]?)(\d*)(?:\.(\d*))?([eE][+-]?\d+)?\z/

  @doc "A text without its byte order mark."
  @spec unmarked(binary()) :: binary()
  def unmarked(@bom <> text), do: text
  def unmarked(text), do: text

  @doc "The lines that are not empty, without comments, each with its number from 1."
  @spec lines(binary()) :: {:ok, [{String.t(), pos_integer()}]} | {:error, String.t()}
  def lines(text) do
    lines =
      for {line, number} <-
            text |> unmarked() |> :binary.split(["\r\n", "\n", "\r"], [:global]) |> Enum.with_index(1),
          [line | _comment] = :binary.split(line, "#"),
          do: {line, number}

    if Enum.all?(lines, fn {line, _number} -> String.valid?(line) end),
      do: {:ok, for({line, number} <- lines, line = String.trim(line), line != "", do: {line, number})},
      else: {:error, "the file is not text in UTF-8"}
  end

  @doc "A decimal number, also `.5` and `50.`: an integer if it is written as one."
  @spec number(String.t()) :: {:ok, number()} | :error
  def number(text) when byte_size(text) > @max_number, do: :error

  def number(text) do
    case {Integer.parse(text), Regex.run(@decimal, text)} do
      {{value, ""}, _decimal} ->
        {:ok, value}

      {_part, [_all, sign, whole, decimals | exponent]} when whole != "" or decimals != "" ->
        float(sign, whole, decimals, exponent)

      _neither ->
        :error
    end
  end

  defp float(sign, whole, decimals, exponent) do
    {:ok, String.to_float("#{sign}#{whole(whole)}.#{whole(decimals)}#{exponent}")}
  rescue
    # An exponent beyond a float's range.
    ArgumentError -> :error
  end

  defp whole(""), do: "0"
  defp whole(digits), do: digits
end
