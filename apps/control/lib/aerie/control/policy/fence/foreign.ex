defmodule Aerie.Control.Policy.Fence.Foreign do
  @moduledoc """
  Members of a GeoJSON file that a fence does not read. Most belong to other programs (colours, ids, notes). One that looks as if it
  limited something is refused, because its author relies on it: `type: exclusion`, `maxAltitude`, `ceiling`, a `radius`
  beside the properties instead of in them.
  """

  @keys ~w(fence name radius min_altitude max_altitude altitude_reference)
  # As other programs call what a fence has; in any place of a word, and as a word of its own.
  @parts ~w(fence exclu inclu radius diameter altitude maxalt minalt height ceiling keepout keepin nofly forbid prohib restrict)
  @words ~w(alt floor upper lower limit limits max min maximum minimum agl msl amsl buffer allow allowed deny denied permitted)
  # Given only by the property `fence`.
  @kinds ~w(inclusion inclusive include included exclusion exclusive exclude excluded nofly noflyzone keepout keepin forbidden
            prohibited restricted allowed denied geofence)
  @alike 0.87

  @doc "The properties that are read."
  @spec keys() :: [String.t()]
  def keys, do: @keys

  @doc """
  What is wrong with the members of an object, those that are named left out. `at` gives the place of a member in words; where
  `properties?` is not true, those that a fence reads stand in the wrong place.
  """
  @spec problems(map(), [String.t()], (String.t() -> String.t()), properties? :: boolean()) :: [String.t()]
  def problems(object, own, at, properties?) do
    for {key, value} <- Enum.sort(object),
        key not in own,
        text = problem(key, value, properties?),
        do: "#{at.(key)}: #{text}"
  end

  @doc "Whether a text calls a zone one to keep out of: without `fence` it would be one to stay in."
  @spec excludes?(term()) :: boolean()
  def excludes?(text) when is_binary(text) and byte_size(text) <= 1024 do
    plain = text |> String.downcase() |> String.replace(~r/[^a-z]/u, "")

    Enum.any?(
      ~w(exclusion excluded nofly keepout forbidden prohibited restricted),
      &String.contains?(plain, &1)
    )
  end

  def excludes?(_other), do: false

  defp problem("name", _value, _properties?), do: nil
  defp problem(key, _value, false) when key in @keys, do: "expected it in the properties of a Feature"

  defp problem(key, value, _properties?) do
    like = Enum.find(@keys, &(String.jaro_distance(String.downcase(key), &1) >= @alike))

    cond do
      like ->
        ~s(expected a known property, got one that looks like "#{like}")

      limits?(key, value) ->
        "expected a known property (#{Enum.join(@keys, ", ")}), got one that may be meant as a limit"

      kind?(value) ->
        "expected fence to say what kind of zone it is, got: #{JSON.encode!(value)}"

      true ->
        below(value)
    end
  end

  # OpenStreetMap has an alt_name.
  defp limits?(key, value) do
    words =
      key
      |> String.replace(~r/(?<=[a-z])(?=[A-Z])/, " ")
      |> String.downcase()
      |> String.split(~r/[^a-z]+/u, trim: true)

    joined = Enum.join(words)

    Enum.any?(@parts, &String.contains?(joined, &1)) or
      (Enum.any?(words, &(&1 in @words)) and not (is_binary(value) and not (value =~ ~r/\d/)))
  end

  defp kind?(text) when is_binary(text) and byte_size(text) <= 64 do
    plain = text |> String.downcase() |> String.replace(~r/[^a-z]/u, "")
    plain in @kinds or Enum.any?(~w(inclusion exclusion), &(String.jaro_distance(plain, &1) >= @alike))
  end

  defp kind?(_other), do: false

  defp below(%{} = object),
    do:
      Enum.find_value(object, fn {key, value} ->
        (key in @keys && key != "name" && misplaced(key)) || problem(key, value, true)
      end)

  defp below(list) when is_list(list), do: Enum.find_value(list, &below/1)
  defp below(_scalar), do: nil

  defp misplaced(key), do: "expected #{key} in the properties of a Feature itself"
end
