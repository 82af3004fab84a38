defmodule Aerie.Vehicle.Firmware.Room do
  @moduledoc """
  How much room a vehicle of a firmware takes around the places of its way, and how high it may climb there by itself: a
  plane circles where a copter stands, turns before or after a waypoint, and climbs when a landing is aborted.

  One that is not known takes the most that any of them would. Radii that a message leaves open come from the vehicle's
  parameters (`MavCodec.Meaning.Shaping`); one that is not known is assumed to be larger than people set it.
  """

  alias Aerie.Vehicle.Firmware
  alias MavCodec.Meaning.Shaping

  @typedoc "Metres around a place, what makes it so many, and how many metres above the place it may climb."
  @type t :: %{metres: number(), why: String.t(), climb: number()}
  @type params :: %{String.t() => number()}

  @typedoc """
  What happens at a place: it stays or circles there with a radius, if one is given; it passes it with these radii of
  acceptance and so far beyond; it lands, and climbs so high if that is aborted; it takes off and rises so many metres.
  """
  @type stop ::
          {:stay | :turns, number() | nil}
          | {:pass, acceptance :: number(), beyond :: number()}
          | {:land, number()}
          | {:takeoff, rise :: number()}

  @doc "The parameters that say how much room a kind of vehicle takes, in the order in which they are read."
  @callback params(kind :: String.t()) :: [String.t()]

  @doc "The room for what happens at a place."
  @callback room(stop(), kind :: String.t(), params()) :: t()

  # What hovers, or stands on the ground or in water, wherever it is.
  @hovering ~w(copter sub rover boat blimp balloon tracker)
  # What a plane needs to enter its circle, and for the wind.
  @circles 1.5
  @entry_m 30
  # Metres that a plane flies for each that it climbs.
  @climb 4

  # How far a curve leaves the straight line between its ends, at most, as a share of that line: its speeds at both
  # ends together are at most four times its length (`SplineCurve`), which count a seventh.
  @curve 0.6
  # Assumed where nothing is known.
  @curve_m 300
  @rise_m 120

  @doc "The room of a vehicle at a place. `:long` - how long the way to it is; `:rise` - how high it is above home."
  @spec around(stop() | nil | :curve | :takeoff, %{long: number() | nil, rise: number() | nil}, map()) :: t()
  def around(nil, _way, _vehicle), do: none()
  # Not a vehicle that was heard, but a description that leaves its firmware open.
  def around(_stop, _way, %{autopilot: nil}), do: none()
  def around(:curve, way, _vehicle), do: given((way.long || @curve_m) * @curve, "the way there is a curve")
  def around(:takeoff, way, vehicle), do: around({:takeoff, max(way.rise || @rise_m, 0)}, way, vehicle)

  def around(stop, _way, vehicle) do
    vehicle.autopilot
    |> Firmware.rooms()
    |> Enum.map(& &1.room(stop, vehicle.vehicle_type || "unknown", vehicle.params))
    |> larger()
  end

  @doc "No room at all."
  @spec none() :: t()
  def none, do: %{metres: 0, why: "", climb: 0}

  @doc "Whether a kind of vehicle has to keep moving, as far as is known."
  @spec winged?(String.t()) :: boolean()
  def winged?(kind), do: kind not in @hovering

  @doc "The room that a number asks for."
  @spec given(number(), String.t()) :: t()
  def given(metres, why), do: %{none() | metres: abs(metres), why: why}

  @doc "The circle of a plane: of a radius that is given, or of the first parameter that is known."
  @spec circle(number() | nil, [String.t(), ...], params()) :: t()
  def circle(radius, names, params) do
    circle =
      if is_number(radius) and radius != 0,
        do: given(radius, "it circles there with a radius of #{round(abs(radius))} m"),
        else: by("it circles there with ", names, params)

    %{circle | metres: circle.metres * @circles + @entry_m}
  end

  @doc "The room by the first parameter that is known; `assumed` metres, if they are others than the row's, otherwise."
  @spec by(String.t(), [String.t(), ...], params(), assumed :: number() | nil) :: t()
  def by(what, [first | _] = names, params, assumed \\ nil) do
    name = Enum.find(names, first, &is_map_key(params, &1))

    case Shaping.metres(name, params, assumed) do
      {:known, metres} ->
        given(metres, "#{what}#{name}, #{round(metres)} m")

      {:assumed, metres} ->
        given(metres, "#{what}#{name}, which is not known yet and counts as #{round(metres)} m")
    end
  end

  @doc "More room, because it flies on so many metres beyond the place."
  @spec beyond(t(), number()) :: t()
  def beyond(room, metres) when metres == 0, do: room

  def beyond(room, metres),
    do: %{
      room
      | metres: room.metres + abs(metres),
        why: "it flies on for #{round(abs(metres))} m, and " <> room.why
    }

  @doc "The room of a plane's take-off that climbs `rise` metres: on rotors (`vtol`) it climbs where it is."
  @spec climbing(number(), kind :: String.t(), circle :: t()) :: t()
  def climbing(_rise, "vtol", circle), do: circle

  def climbing(rise, _kind, circle) do
    way = given(rise * @climb, "a plane flies about #{@climb} m for each metre that it climbs")
    larger([circle, way])
  end

  @doc "The largest of rooms, with the highest climb of any."
  @spec larger([t(), ...]) :: t()
  def larger(rooms),
    do: %{Enum.max_by(rooms, & &1.metres) | climb: rooms |> Enum.map(& &1.climb) |> Enum.max()}
end
