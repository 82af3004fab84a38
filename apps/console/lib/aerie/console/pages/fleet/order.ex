defmodule Aerie.Console.Pages.Fleet.Order do
  @moduledoc "The order of the table. Pure. Unknown values come last in either direction; the id decides between equal ones."

  alias Aerie.Console.Pages.Fleet.Board.Row
  alias Aerie.Vehicle.Firmware

  @columns ~w(id state mode battery gps height speed link age problems)
  @states %{lost: 0, failsafe: 1, stale: 2, armed: 3, disarmed: 4}

  @type t :: {column :: String.t(), :asc | :desc}

  @doc "The order in an address: `battery` or `-battery`; by id for anything else."
  @spec parse(term()) :: t()
  def parse("-" <> column) when column in @columns, do: {column, :desc}
  def parse(column) when column in @columns, do: {column, :asc}
  def parse(_other), do: {"id", :asc}

  @doc "The order as written in an address; nil for the default."
  @spec param(t()) :: String.t() | nil
  def param({"id", :asc}), do: nil
  def param({column, :asc}), do: column
  def param({column, :desc}), do: "-" <> column

  @doc "The order after a click on a column's header: by that column, or reversed."
  @spec press(t(), term()) :: t()
  def press({column, :asc}, column), do: {column, :desc}
  def press({column, :desc}, column), do: {column, :asc}
  def press(_other, column), do: parse(column)

  @doc "The rows in order."
  @spec sort([Row.t()], t()) :: [Row.t()]
  def sort(rows, {"id", :asc}), do: Enum.sort_by(rows, & &1.order)

  def sort(rows, {column, direction}) do
    rows = sort(rows, {"id", :asc})
    {known, unknown} = Enum.split_with(rows, &(value(&1, column) != nil))
    # Stable in both directions.
    Enum.sort_by(known, &value(&1, column), direction) ++ unknown
  end

  defp value(row, "id"), do: row.order
  defp value(row, "state"), do: Map.fetch!(@states, row.state)
  defp value(row, "mode"), do: row.mode && {Firmware.meaning(row.mode) || row.mode, row.mode}
  defp value(row, "battery"), do: row.battery
  defp value(row, "gps"), do: row.fix && {row.fix, row.satellites || 0}
  defp value(row, "height"), do: row.height
  defp value(row, "speed"), do: row.speed
  defp value(row, "link"), do: row.link
  defp value(row, "age"), do: row.silent_us

  # The worst first.
  defp value(%{readiness: state} = row, "problems") when state in [:not_ready, :unknown, :check],
    do: {Enum.find_index([:not_ready, :unknown, :check], &(&1 == state)), List.first(row.open)}

  defp value(%{problems: []}, "problems"), do: nil
  defp value(%{problems: [{:bad, text} | _]}, "problems"), do: {0, text}
  defp value(%{problems: [{:warn, text} | _]}, "problems"), do: {1, text}
end
