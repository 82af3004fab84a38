defmodule Aerie.CLI.Output.Columns do
  @moduledoc "Rows as a table for a terminal. Pure."

  @doc "Lines with a heading: `rows` are lists of values, nil shown as a gap. Columns are as wide as their widest text."
  @spec render([String.t()], [[term()]]) :: iodata()
  def render(heading, rows) do
    lines = [heading | Enum.map(rows, fn row -> Enum.map(row, &cell/1) end)]

    widths =
      lines
      |> Enum.zip_with(& &1)
      |> Enum.map(fn column -> column |> Enum.map(&String.length/1) |> Enum.max() end)

    Enum.map(lines, &[line(&1, widths), ?\n])
  end

  defp line(cells, widths) do
    [cells, widths]
    |> Enum.zip_with(fn [cell, width] -> String.pad_trailing(cell, width) end)
    |> Enum.join("  ")
    |> String.trim_trailing()
  end

  @doc "A value as text: a gap for an unknown value, no control characters."
  @spec cell(term()) :: String.t()
  def cell(nil), do: "-"

  def cell(text) when is_binary(text), do: Aerie.Base.Printable.line(text)

  def cell(number) when is_float(number), do: :erlang.float_to_binary(number, [:compact, decimals: 7])
  def cell(other), do: cell(to_string(other))
end
