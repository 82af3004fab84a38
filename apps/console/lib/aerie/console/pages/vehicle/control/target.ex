defmodule Aerie.Console.Pages.Vehicle.Control.Target do
  @moduledoc "A place on the map, and the command that is prepared for it (`Aerie.Console.Commands.Guided`). Pure."

  alias Aerie.Console.Commands.{Guided, Outcome}
  alias Aerie.Console.Pages.Vehicle.View
  alias Aerie.Vehicle.Snapshot

  # A vehicle that is sent somewhere at the height of the ground would scrape it.
  @lowest_m 10.0
  @radius_m 20.0
  @radius_circling_m 100.0

  @typedoc "`:fields`: the texts of the command's parameters beside the place."
  @type t :: %{type: String.t(), lat: float(), lon: float(), fields: %{String.t() => String.t()}}

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

  @doc "The command for a position, at the vehicle's height or at least #{@lowest_m} m; nil if the map has no such act."
  @spec new(View.t(), type :: term(), term()) :: t() | nil
  def new(view, type, %{"lat" => lat, "lon" => lon})
      when is_binary(type) and is_number(lat) and is_number(lon) and abs(lat) <= 90 and abs(lon) <= 360 do
    with %{fields: names} <- Guided.act(type) do
      %{
        type: type,
        lat: Float.round(lat * 1.0, 7),
        lon: Float.round(wrapped(lon * 1.0), 7),
        fields: Map.new(names, &{&1, default(type, &1, view)})
      }
    end
  end

  def new(_view, _type, _no_place), do: nil

  defp default("set_roi", "altitude", _view), do: "0"

  defp default(_type, "altitude", view),
    do: View.number(max(View.get(view, [:position, :alt_rel]) || 0.0, @lowest_m), 0)

  # Planes cannot circle as narrowly as copters.
  defp default(_type, "radius", %{vehicle: %{vehicle_type: kind}}),
    do: View.number(if(kind in ["plane", "vtol"], do: @radius_circling_m, else: @radius_m), 0)

  # What is known of the ground: where home lies.
  defp default(_type, "altitude_msl", view) do
    position = Snapshot.data(view.vehicle, :position)

    case {View.get(view, [:home, :alt_msl]), position} do
      {home, _position} when is_number(home) -> View.number(home, 1)
      {nil, %{alt_msl: msl, alt_rel: up}} when is_number(msl) and is_number(up) -> View.number(msl - up, 1)
      _unknown -> ""
    end
  end

  defp default(_type, _optional, _view), do: ""

  # Maps repeat the earth.
  defp wrapped(lon) when lon > 180, do: lon - 360
  defp wrapped(lon) when lon < -180, do: lon + 360
  defp wrapped(lon), do: lon

  @doc "With other texts of its fields."
  @spec change(t(), %{String.t() => term()}) :: t()
  def change(target, texts) do
    fields =
      Map.new(target.fields, fn {name, text} ->
        {name, if(is_binary(texts[name]), do: String.slice(texts[name], 0, 20), else: text)}
      end)

    %{target | fields: fields}
  end

  @doc "The inputs for the form of its command."
  @spec fields(t()) :: %{String.t() => String.t()}
  def fields(target), do: Map.merge(target.fields, place(target))

  @doc "The place as texts, as the form has them hidden."
  @spec place(t()) :: %{String.t() => String.t()}
  def place(target), do: %{"lat" => View.number(target.lat, 7), "lon" => View.number(target.lon, 7)}

  @doc """
  How far it is, with words about it, and if the vehicle flies there, how long it takes at the chosen speed or else its
  present one; nil if not known.
  """
  @spec way(t(), View.t(), String.t()) :: String.t() | nil
  def way(target, view, words) do
    with metres when is_number(metres) <- Snapshot.distance(view.vehicle, {target.lat, target.lon}) do
      speed =
        if Guided.act(target.type).moves?,
          do: number(target.fields["speed"]) || View.get(view, [:velocity, :groundspeed])

      Outcome.way(metres, words, speed)
    end
  end

  @doc "What the map shows of it: the place, the way there, and a circle: of an orbit, or as wide as it will fly high."
  @spec drawn(t(), View.t()) :: map()
  def drawn(target, view) do
    height = number(target.fields["altitude"])
    radius = number(target.fields["radius"])
    act = Guided.act(target.type)

    ring =
      cond do
        not act.moves? or height == nil or height <= 0 -> nil
        radius != nil -> %{metres: radius, text: "#{View.number(height, 0)} m high"}
        true -> %{metres: height, text: "#{View.number(height, 0)} m high"}
      end

    place = %{lat: target.lat, lon: target.lon, text: String.downcase(act.label), from: view.vehicle.id}
    Map.merge(place, %{way: way(target, view, "") || "", ring: ring})
  end

  defp number(text) do
    case Float.parse(text || "") do
      {number, ""} when number > 0 and number < 20_000 -> number
      _other -> nil
    end
  end
end
