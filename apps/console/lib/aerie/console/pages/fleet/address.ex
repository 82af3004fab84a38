defmodule Aerie.Console.Pages.Fleet.Address do
  @moduledoc "The address of the page: filter and order. Pure."

  alias Aerie.Console.Pages.Fleet.{Filter, Order}

  @doc "The address; `Aerie.Console.Pages.Fleet.Filter.parse/1` and `Order.parse/1` read it."
  @spec of(Filter.t(), Order.t()) :: String.t()
  def of(filter, order) do
    case Filter.params(filter) ++ for(column <- List.wrap(Order.param(order)), do: {"sort", column}) do
      [] -> "/"
      params -> "/?" <> URI.encode_query(params)
    end
  end
end
