defmodule Aerie.Console.Pages.Fleet.Address do
  @moduledoc "The address of the page: filter, order and the part that a phone shows. Pure."

  alias Aerie.Console.Pages.Fleet.{Filter, Order}

  @doc "The address; `Aerie.Console.Pages.Fleet.Filter.parse/1` and `Order.parse/1` read it."
  @spec of(Filter.t(), Order.t(), view :: String.t()) :: String.t()
  def of(filter, order, view) do
    sort = if column = Order.param(order), do: [{"sort", column}], else: []
    view = if view == "table", do: [{"view", view}], else: []

    case Filter.params(filter) ++ sort ++ view do
      [] -> "/"
      params -> "/?" <> URI.encode_query(params)
    end
  end
end
