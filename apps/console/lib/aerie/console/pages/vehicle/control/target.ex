defmodule Aerie.Console.Pages.Vehicle.Control.Target do
  @moduledoc "A position on the map to which a vehicle may be sent and the command for it. Pure."

  alias Aerie.Console.Pages.Vehicle.View

  # A vehicle that is sent somewhere at the height of the ground would scrape it.
  @lowest_m 10.0

  @typedoc "`:altitude` is the text of its field, metres above home."
  @type t :: %{lat: float(), lon: float(), altitude: String.t()}

  @doc "The place that the vehicle is on its way to (`Aerie.Console.Commands.Outcome`), for the map; nil without one."
  @spec on_its_way([map()], %{String.t() => map()}) :: %{lat: float(), lon: float(), text: String.t()} | nil
  def on_its_way(entries, courses) do
    Enum.find_value(entries, fn
      %{id: id, type: "goto", params: %{lat: lat, lon: lon}} ->
        courses[id][:stage] == :going && %{lat: lat, lon: lon, text: "on its way"}

      _other ->
        nil
    end)
  end

  @doc "A position that was clicked, at the vehicle's height, but at least #{@lowest_m} m."
  @spec new(View.t(), term()) :: t() | nil
  def new(view, %{"lat" => lat, "lon" => lon})
      when is_number(lat) and is_number(lon) and abs(lat) <= 90 and abs(lon) <= 360 do
    height = max(View.get(view, [:position, :alt_rel]) || 0.0, @lowest_m)

    %{
      lat: Float.round(lat * 1.0, 7),
      lon: Float.round(wrapped(lon * 1.0), 7),
      altitude: View.number(height, 0)
    }
  end

  def new(_view, _no_place), do: nil

  # Maps repeat the earth.
  defp wrapped(lon) when lon > 180, do: lon - 360
  defp wrapped(lon) when lon < -180, do: lon + 360
  defp wrapped(lon), do: lon

  @doc "The inputs for the form of `goto`."
  @spec fields(t()) :: %{String.t() => String.t()}
  def fields(target),
    do: %{
      "lat" => View.number(target.lat, 7),
      "lon" => View.number(target.lon, 7),
      "altitude" => target.altitude
    }
end
