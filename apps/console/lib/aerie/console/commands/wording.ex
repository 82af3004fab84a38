defmodule Aerie.Console.Commands.Wording do
  @moduledoc """
  A command's parameters as an operator would say them: `47.39833, 8.54430 at 10 m above home`, `GUIDED`. What is as the table of
  commands has it by default, and what only programs compare (digests), is left out. Pure.
  """

  alias Aerie.Base.Json
  alias Aerie.Vehicle.Command

  @above %{"home" => "above home", "msl" => "above mean sea level", "terrain" => "above the ground"}
  # Names of parameters whose value says enough.
  @plain ~w(standard_mode sensor position action to enabled receiver)
  @hidden ~w(digest opaque_id)

  @doc "Parameters in one line."
  @spec params(String.t(), map()) :: String.t()
  def params(type, params) do
    params = Map.new(params, fn {name, value} -> {to_string(name), value} end)
    given = params |> Map.drop(@hidden) |> Map.reject(&default?(type, &1))
    {place, given} = place(given, params)

    [place | given |> Enum.sort() |> Enum.map(&one/1)]
    |> Enum.reject(&(&1 == ""))
    |> Enum.join(", ")
  end

  defp default?(type, {name, value}) do
    with %{params: params} <- Command.type(type),
         %{default: default} when default != nil <- Enum.find(params, &(Atom.to_string(&1.name) == name)),
         do: default == value,
         else: (_without -> value == nil)
  end

  defp place(given, all) do
    where =
      with %{"lat" => lat, "lon" => lon} when is_number(lat) and is_number(lon) <- given,
           do: "#{degrees(lat)}, #{degrees(lon)}",
           else: (_nowhere -> "")

    {text, names} =
      case {where, height(all)} do
        {"", nil} -> {"", []}
        {"", height} -> {"#{height}", ~w(altitude altitude_msl altitude_reference)}
        {where, nil} -> {where, ~w(lat lon)}
        {where, height} -> {"#{where} at #{height}", ~w(lat lon altitude altitude_msl altitude_reference)}
      end

    {text, Map.drop(given, names)}
  end

  defp height(%{"altitude_msl" => metres}) when is_number(metres),
    do: "#{value(metres)} m above mean sea level"

  defp height(%{"altitude" => metres} = all) when is_number(metres),
    do: "#{value(metres)} m #{@above[to_string(all["altitude_reference"] || "home")]}"

  defp height(_without), do: nil

  # A decimetre on the ground.
  defp degrees(number), do: :erlang.float_to_binary(number / 1, decimals: 5)

  defp one({"enabled", on?}), do: if(on?, do: "on", else: "off")
  defp one({"mode", mode}), do: value(mode)
  defp one({name, value}) when name in @plain, do: value |> value() |> String.replace("_", " ")
  defp one({name, value}), do: "#{String.replace(name, "_", " ")} #{value(value)}"

  defp value(number) when is_float(number), do: number |> Float.round(7) |> Json.number()
  defp value(list) when is_list(list), do: Enum.map_join(list, " ", &value/1)
  defp value(true), do: "yes"
  defp value(false), do: "no"
  defp value(other) when is_binary(other) or is_atom(other) or is_integer(other), do: to_string(other)
  defp value(other), do: inspect(other, limit: 5, printable_limit: 60)
end
