defmodule Aerie.Vehicle.Fields.Round do
  @moduledoc "Rounds the numbers of a nested object by the names of its fields."

  @typedoc "Decimals by field name; 0 gives whole numbers."
  @type decimals :: %{optional(atom() | String.t()) => non_neg_integer()}

  @doc "The rounded object. A field that has no decimals of its own uses those of the field above it."
  @spec object(map(), decimals()) :: map()
  def object(map, decimals), do: object(map, decimals, nil)

  defp object(map, decimals, above),
    do: Map.new(map, fn {name, value} -> {name, value(value, decimals, Map.get(decimals, name, above))} end)

  defp value(float, _decimals, 0) when is_float(float), do: round(float)
  defp value(float, _decimals, n) when is_float(float) and is_integer(n), do: Float.round(float, n)
  defp value(map, decimals, n) when is_map(map) and not is_struct(map), do: object(map, decimals, n)
  defp value(list, decimals, n) when is_list(list), do: Enum.map(list, &value(&1, decimals, n))
  defp value(other, _decimals, _n), do: other
end
