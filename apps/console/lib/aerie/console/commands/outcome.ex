defmodule Aerie.Console.Commands.Outcome do
  @moduledoc """
  What the vehicle makes of a command that is completed as soon as it has begun (docs/commands.md): a landing, a return, a flight to a place
  or to a height, a mission. Pure.

  A command is *going* until its end shows (*there*), or something else ends it (*ended*): another command, another mode, the ground. What has
  ended stays so: `keep/4` keeps it, whatever the vehicle does later (`Aerie.Console.Commands.Courses`).
  """

  alias Aerie.Control.Commands
  alias Aerie.Console.Commands.Catalog
  alias Aerie.Console.UI.Age
  alias Aerie.Vehicle.Snapshot

  @typedoc "`:at`: when it ended, nil while it is going or where the time is not known."
  @type t :: %{
          stage: :going | :there | :ended,
          label: String.t(),
          text: String.t() | nil,
          at: integer() | nil
        }

  # Texts during a command, and at its end.
  @words %{
    "land" => {"Landing", "Landed"},
    "rtl" => {"Returning", "Arrived"},
    "goto" => {"On its way", "Arrived"},
    "takeoff" => {"Climbing", "At height"},
    "set_altitude" => {"Changing height", "At height"},
    "orbit" => {"Circling", "Circled"},
    "mission_start" => {"Flying the mission", "Mission completed"},
    "resume" => {"Flying the mission", "Mission completed"}
  }
  @replacing ~w(hold set_mode mission_pause land_start jump force_disarm terminate vtol_transition) ++
               Map.keys(@words)
  @ends_on_the_ground ~w(land rtl)
  @accepted [:completed, :accepted]

  # Planes arrive on a circle around the place.
  @near_m 5
  @near_circling_m 150
  @near_height_m 2
  @least_speed 0.5

  @doc "The courses of the commands of a vehicle (the latest first) by id; `known` are those of the last time."
  @spec keep(%{String.t() => t()}, [Commands.entry()], map(), {[map()], integer()}) :: %{
          String.t() => t()
        }
  def keep(known, entries, vehicle, {events, now}) do
    for entry <- entries, is_map_key(@words, entry.type), into: %{} do
      before = known[entry.id]
      later = Enum.filter(entries, &(&1.at > entry.at))

      if before && before.stage != :going,
        do: {entry.id, before},
        else: {entry.id, dated(of(entry, later, vehicle, events), before, entry, now)}
    end
    |> Map.reject(fn {_id, course} -> course == nil end)
  end

  # An end that was not seen when it came is as old as the command.
  defp dated(%{stage: stage, at: nil} = course, before, entry, now) when stage != :going,
    do: %{course | at: if(before, do: now, else: entry.done_at)}

  defp dated(course, _before, _entry, _now), do: course

  @doc "The course of a command; `later` are the vehicle's commands after it. Nil if it has not begun, or has no course."
  @spec of(Commands.entry(), later :: [Commands.entry()], vehicle :: map(), [map()]) :: t() | nil
  def of(%{type: type, result: %{status: :completed}} = entry, later, vehicle, events)
      when is_map_key(@words, type) do
    {going, there} = @words[type]

    case first_end(entry, later, events) do
      {at, :there, label} ->
        course(:there, label || there, nil, at)

      {at, :ended, text} ->
        course(:ended, "Ended", text, at)

      # A firmware that has arrived may change its mode by itself.
      mode ->
        cond do
          arrived?(entry, vehicle) -> course(:there, there, nil, nil)
          mode != nil -> course(:ended, "Ended", elem(mode, 2), elem(mode, 0))
          true -> course(:going, going, progress(entry, vehicle), nil)
        end
    end
  end

  def of(_entry, _later, _vehicle, _events), do: nil

  defp course(stage, label, text, at), do: %{stage: stage, label: label, text: text, at: at}

  defp first_end(entry, later, events) do
    by_events = for event <- events, found = ending(entry, event), do: found

    by_commands =
      for %{type: type, at: at, result: %{status: status}} <- later,
          type in @replacing and status in @accepted,
          do: {at, :ended, "by the command #{Catalog.title(type)}"}

    Enum.min_by(by_events ++ by_commands, &elem(&1, 0), fn -> nil end)
  end

  # The vehicle may have landed before the result was known, but not before the command came.
  defp ending(%{type: type, at: begun}, %{type: ended, time: at})
       when ended in ["landed", "disarmed"] and at >= begun,
       do:
         if(type in @ends_on_the_ground,
           do: {at, :there, "Landed"},
           else: {at, :ended, "the vehicle #{ended}"}
         )

  defp ending(%{type: type, at: begun}, %{type: "mission.completed", time: at})
       when type in ["mission_start", "resume"] and at >= begun,
       do: {at, :there, nil}

  defp ending(%{type: type, done_at: done}, %{type: "mode_change", time: at, data: %{"to" => mode}})
       when at > done and is_binary(mode) do
    # A return ends in a landing, and some firmwares show that as a mode.
    if type in @ends_on_the_ground and String.contains?(mode, ["LAND", "RTL"]),
      do: nil,
      else: {at, :mode, "mode changed to #{mode}"}
  end

  defp ending(_entry, _event), do: nil

  defp arrived?(%{type: "land"}, vehicle), do: Snapshot.data(vehicle, :mode)[:in_air] == false

  # A flying vehicle continues to land at home, which an event reports.
  defp arrived?(%{type: "rtl"} = entry, vehicle) do
    not Snapshot.flies?(vehicle) and
      near?(Snapshot.distance(vehicle, target(entry, vehicle)), vehicle.vehicle_type)
  end

  defp arrived?(%{type: "goto"} = entry, vehicle) do
    near?(Snapshot.distance(vehicle, target(entry, vehicle)), vehicle.vehicle_type) and
      height_left(entry, vehicle) in [nil, 0]
  end

  defp arrived?(%{type: type} = entry, vehicle) when type in ["takeoff", "set_altitude"],
    do: height_left(entry, vehicle) == 0

  defp arrived?(_entry, _vehicle), do: false

  defp near?(nil, _kind), do: false
  defp near?(metres, kind) when kind in ["plane", "vtol"], do: metres <= @near_circling_m
  defp near?(metres, _kind), do: metres <= @near_m

  # Metres between the height that is asked for and the present one, 0 when it is reached; nil where one of them is not known.
  defp height_left(%{params: %{altitude: wanted} = params}, vehicle) when is_number(wanted) do
    position = Snapshot.data(vehicle, :position)

    height =
      case params[:altitude_reference] do
        reference when reference in [nil, "home"] -> position[:alt_rel]
        "msl" -> position[:alt_msl]
        _terrain -> nil
      end

    cond do
      not is_number(height) -> nil
      abs(wanted - height) <= @near_height_m -> 0
      true -> wanted - height
    end
  end

  defp height_left(_entry, _vehicle), do: nil

  @doc "The progress of a course: `118 m from home, 20 s`. Where its type says all, a command needs no more."
  @spec progress(%{:type => String.t(), optional(atom()) => term()}, map()) :: String.t() | nil
  def progress(%{type: type} = entry, vehicle) when type in ["goto", "rtl"] do
    case Snapshot.distance(vehicle, target(entry, vehicle)) do
      nil ->
        nil

      metres ->
        way(
          metres,
          if(type == "rtl", do: " from home", else: " to go"),
          Snapshot.data(vehicle, :velocity)[:groundspeed]
        )
    end
  end

  def progress(%{type: type}, vehicle) when type in ["land", "hold"], do: now_at(vehicle)

  def progress(%{type: type, params: %{altitude: wanted}}, vehicle)
      when type in ["takeoff", "set_altitude"] do
    with text when is_binary(text) <- now_at(vehicle), do: "#{text}, to #{round(wanted)} m"
  end

  def progress(%{type: type}, vehicle) when type in ["mission_start", "resume"],
    do: item(Snapshot.data(vehicle, :mission))

  def progress(_entry, _vehicle), do: nil

  @doc "Where a mission is: `item 3 of 7`; nil if it is not known."
  @spec item(map()) :: String.t() | nil
  def item(%{seq: seq, total: total}) when is_integer(seq) and is_integer(total),
    do: "item #{seq} of #{total}"

  def item(%{seq: seq}) when is_integer(seq), do: "item #{seq}"
  def item(_unknown), do: nil

  defp now_at(vehicle) do
    with height when is_number(height) <- Snapshot.data(vehicle, :position)[:alt_rel],
         do: "#{round(height)} m above home",
         else: (_unknown -> nil)
  end

  @doc "A distance with words about it, and how long it takes at this speed if that is one: `118 m to go, 20 s`."
  @spec way(number(), String.t(), number() | nil) :: String.t()
  def way(metres, words, speed), do: metres(metres) <> words <> time(metres, speed)

  defp time(metres, speed) when is_number(speed) and speed >= @least_speed,
    do: ", " <> Age.text(round(metres / speed) * 1_000_000)

  defp time(_metres, _still), do: ""

  @doc "A distance in words: `118 m`, `1.2 km`."
  @spec metres(number()) :: String.t()
  def metres(metres) when metres < 1000, do: "#{round(metres)} m"
  def metres(metres), do: :erlang.float_to_binary(metres / 1000, decimals: 1) <> " km"

  @doc "Where a command sends the vehicle, `{lat, lon}`; nil if nowhere."
  @spec target(%{:type => String.t(), optional(atom()) => term()}, map()) :: {float(), float()} | nil
  def target(%{type: "goto", params: %{lat: lat, lon: lon}}, _vehicle) when is_number(lat) and is_number(lon),
    do: {lat, lon}

  def target(%{type: "rtl"}, vehicle) do
    case Snapshot.data(vehicle, :home) do
      %{lat: lat, lon: lon} when is_number(lat) and is_number(lon) -> {lat, lon}
      _unknown -> nil
    end
  end

  def target(_entry, _vehicle), do: nil
end
