defmodule Bench.Table do
  @moduledoc "Prints rows: in Markdown, or in columns. A cell is anything that has a text; nil is a dash."

  @doc "The head of a table in Markdown."
  def head(names, widths \\ []) do
    row(names, widths)
    IO.puts("|" <> String.duplicate("---|", length(names)))
  end

  @doc "A row in Markdown, padded to `widths`."
  def row(cells, widths \\ []), do: IO.puts("| " <> Enum.join(padded(cells, widths), " | ") <> " |")

  @doc "A row of columns; those of a negative width stand at the right."
  def columns(cells, widths),
    do: cells |> padded(widths) |> Enum.join() |> String.trim_trailing() |> IO.puts()

  @doc "The last line of a benchmark."
  def machine, do: IO.puts("\n#{System.schedulers_online()} cores, load #{Bench.OSProcess.load()} at the end")

  defp padded(cells, widths),
    do: cells |> Enum.with_index() |> Enum.map(fn {cell, n} -> pad(text(cell), Enum.at(widths, n, 0)) end)

  defp pad(text, width) when width < 0, do: String.pad_leading(text, -width)
  defp pad(text, width), do: String.pad_trailing(text, width)

  defp text(nil), do: "–"
  defp text(list) when is_list(list), do: Enum.map_join(list, " / ", &text/1)
  defp text(cell), do: to_string(cell)
end
