defmodule SimVehicle.Params.Table do
  @moduledoc false
  # Reads the parameter tables at compile time: a line each, "NAME value type".

  @spec parse(String.t()) :: [SimVehicle.Params.definition()]
  def parse(text) do
    for line <- String.split(text, "\n", trim: true) do
      [name, value, type] = String.split(line)
      {name, number(value), String.to_integer(type)}
    end
  end

  defp number(text),
    do: if(String.contains?(text, "."), do: String.to_float(text), else: String.to_integer(text))
end
