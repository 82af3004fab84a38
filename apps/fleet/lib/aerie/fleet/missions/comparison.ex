defmodule Aerie.Fleet.Missions.Comparison do
  @moduledoc """
  Plans of several vehicles against each other over time, with what the gateway knows of the vehicles: where they are,
  how high their homes are, and how fast they fly by their parameters.
  """

  alias Aerie.Base.Names
  alias Aerie.Fleet.Missions.{Course, Separation, Variant}
  alias Aerie.Fleet.Remote.Merge
  alias Aerie.Vehicle.Events.Journal
  alias Aerie.Vehicle.Snapshot
  alias MavCodec.Meaning.Pilot
  alias Protocols.Mission.{Item, Plan}

  # Where GPS of both is a metre or two off, they may meet. Not a setting: nothing is refused below it, somebody has to
  # agree.
  @limit_m 5.0
  # ArduPilot's and PX4's own for copters, where a vehicle's parameters are not known.
  @usual %{speed: 5.0, climb: 2.5, descent: 1.5}
  @meanings %{
    speed: "speed along a mission",
    climb: "speed of a climb",
    descent: "speed of a descent"
  }
  @params for {key, meaning} <- @meanings,
              {name, _least, _most, unit, ^meaning} <- Pilot.all(),
              do: {key, name, if(unit == "cm/s", do: 0.01, else: 1.0)}

  @typedoc """
    * `:assumed` - its speed is not known, and is taken as #{@usual.speed} m/s
    * `:nearest` - of the passes that it is part of; `:place` in degrees
  """
  @type vehicle :: %{
          metres: float(),
          seconds: float(),
          speed: float(),
          assumed: boolean(),
          notes: [String.t()],
          nearest: Separation.pair() | nil
        }
  @type t :: %{
          vehicles: %{String.t() => vehicle()},
          nearest: Separation.pair() | nil,
          error: String.t() | nil
        }

  @type plan :: Plan.t()
  @type offset :: Variant.offset()

  @doc "A plan moved for a vehicle before which `n` others go (`Aerie.Fleet.Missions.Variant.offset/3`)."
  @spec offset(plan(), non_neg_integer(), offset()) :: {:ok, plan()} | {:error, String.t()}
  defdelegate offset(plan, n, offset), to: Variant

  @doc "Which file is for which vehicle (`Aerie.Fleet.Missions.Variant.assign/2`)."
  @spec assign([String.t()], [{String.t(), [String.t()]}]) ::
          {%{String.t() => {:ok, String.t()} | {:error, String.t()}}, spare :: [String.t()]}
  defdelegate assign(names, vehicles), to: Variant

  @doc "Nearer to each other than so many metres they should not come."
  @spec limit_m() :: float()
  def limit_m, do: @limit_m

  @doc "The plans of vehicles that start in this order, one after `interval_s` the next."
  @spec of(Names.gateway(), [{String.t(), Plan.t()}], interval_s :: number()) :: t()
  def of(gateway, plans, interval_s) do
    vehicles = for {id, _plan} <- plans, do: vehicle(gateway, id)
    origin = origin(plans, vehicles)

    courses =
      for {{{_id, plan}, vehicle}, n} <- plans |> Enum.zip(vehicles) |> Enum.with_index(),
          do: {Course.of(plan, vehicle, origin), n * interval_s, vehicle.up != nil}

    {pairs, error} =
      case Separation.pairs(courses) do
        {:ok, pairs} -> {for(pair <- pairs, do: %{pair | place: Course.degrees(pair.place, origin)}), nil}
        {:error, why} -> {[], why}
      end

    # The nearest come first.
    nearest =
      for pair <- pairs, id <- [pair.one, pair.other], reduce: %{}, do: (own -> Map.put_new(own, id, pair))

    %{
      nearest: List.first(pairs),
      error: error,
      vehicles:
        for {{course, _start, _waits?}, vehicle} <- Enum.zip(courses, vehicles), into: %{} do
          {course.id,
           %{
             metres: course.metres,
             seconds: Course.seconds(course),
             speed: vehicle.speed,
             assumed: vehicle.assumed?,
             notes: course.notes,
             nearest: nearest[course.id]
           }}
        end
    }
  end

  defp vehicle(gateway, id) do
    snapshot = Merge.vehicle(gateway, id)
    data = fn group -> if snapshot, do: Snapshot.data(snapshot, group), else: %{} end

    place =
      with %{lat: lat, lon: lon} when is_number(lat) and is_number(lon) <- data.(:position), do: {lat, lon}

    known =
      for {key, name, factor} <- @params,
          {:ok, value} when is_number(value) and value > 0 <- [Journal.param(gateway, id, name)],
          into: %{},
          do: {key, value * factor}

    @usual
    |> Map.merge(known)
    |> Map.merge(%{
      id: id,
      place: if(is_tuple(place), do: place),
      up: if(data.(:mode)[:in_air] == true, do: data.(:position)[:alt_rel]),
      home_m: data.(:home)[:alt_msl],
      assumed?: not is_map_key(known, :speed),
      circles?: snapshot != nil and snapshot.vehicle_type in ["plane", "vtol"]
    })
  end

  # A place near all of them.
  defp origin(plans, vehicles) do
    item = Enum.find_value(plans, fn {_id, plan} -> Enum.find(plan.items, &Item.flown?/1) end)

    if item,
      do: {item.x / 1.0e7, item.y / 1.0e7},
      else: Enum.find_value(vehicles, {0.0, 0.0}, & &1.place)
  end
end
