defmodule Aerie.Fleet.Operations.Guard do
  @moduledoc """
  What speaks against vehicles that are about to begin, whatever a page has shown:

    * one of them is not as `shown` said
    * one of them has two lists of steps
    * several that arm or take off would begin at once
    * a vehicle that is to arm or take off is not known, flies already or may, is not ready (unless `anyway` says so),
      or is in the charge of somebody else
    * two that are to take off stand, or have their homes, nearer than twice `radius_m`
  """

  alias Aerie.Base.Geo.Earth
  alias Aerie.Base.Names
  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.{ControlLease, Roles}
  alias Aerie.Fleet.Remote.Merge
  alias Aerie.Fleet.Operations.{Readiness, Request, Sequence}
  alias Aerie.Vehicle.Snapshot

  # So many reasons are named.
  @named 5
  # A degree of latitude, a little less than the shortest.
  @degree_m 110_000

  @doc "Whether those of an operation's vehicles that have not begun may begin now."
  @spec check(Names.gateway(), Request.t(), [String.t()], Roles.source()) ::
          :ok | {:error, {:conflict, String.t()}}
  def check(gateway, request, vehicles, source) do
    waiting = MapSet.new(vehicles)

    lifting =
      for vehicle <- lifting(request),
          vehicle.vehicle in waiting,
          do: {vehicle, Merge.vehicle(gateway, vehicle.vehicle)}

    changed =
      for {id, word} <- request.shown,
          id in waiting,
          now = word(gateway, id, source),
          now != word,
          do: "#{id} is #{now} now, not #{word}"

    refused =
      for {vehicle, snapshot} <- lifting,
          why = refusal(gateway, vehicle, snapshot, source),
          do: "#{vehicle.vehicle} #{why}"

    seen = for {_vehicle, %{} = snapshot} <- lifting, do: snapshot

    together =
      if lifting != [] and request.plan.step > 1,
        do: ["step is #{request.plan.step}, but of vehicles that arm or take off one begins at a time"],
        else: []

    near = near(seen, :position, "stand", request) ++ near(seen, :home, "have their homes", request)

    case twice(request) ++ together ++ Enum.uniq(changed ++ refused) ++ near do
      [] -> :ok
      reasons -> {:error, {:conflict, "nothing was begun: " <> words(reasons)}}
    end
  end

  defp words(reasons) do
    {named, more} = Enum.split(reasons, @named)
    Enum.join(named, "; ") <> if(more == [], do: "", else: "; and #{length(more)} more")
  end

  defp lifting(%{what: {:sequence, vehicles}}), do: Enum.filter(vehicles, &Sequence.lifts?/1)
  defp lifting(_other), do: []

  defp twice(%{what: {:sequence, vehicles}}) do
    ids = for vehicle <- vehicles, do: vehicle.vehicle
    for id <- Enum.uniq(ids -- Enum.uniq(ids)), do: "#{id} is in the sequence twice"
  end

  defp twice(_other), do: []

  defp refusal(_gateway, _vehicle, nil, _source), do: "is not known"

  defp refusal(gateway, vehicle, snapshot, source) do
    lease = Policy.control_lease(gateway, snapshot.key)
    mode = Snapshot.data(snapshot, :mode)

    cond do
      mode[:in_air] == true -> "is in the air"
      mode[:in_air] == nil and mode[:armed] != false -> "is not known to be on the ground"
      lease != nil and lease.holder != ControlLease.who(source) -> "is in the charge of #{lease.holder}"
      vehicle.anyway? -> nil
      true -> unready(gateway, vehicle.vehicle, source)
    end
  end

  defp unready(gateway, id, source) do
    case Readiness.of(gateway, id, ControlLease.who(source)) do
      %{state: state} when state in [:ready, :check] -> nil
      %{state: :not_ready, points: points} -> "is not ready" <> why(points, :not_ready)
      %{state: :unknown, points: points} -> "is not known to be ready" <> why(points, :unknown)
    end
  end

  defp why(points, state),
    do: with(%{text: text} <- Enum.find(points, &(&1.state == state)), do: ": " <> text, else: (nil -> ""))

  defp word(gateway, id, source) do
    with %{state: state} <- Readiness.of(gateway, id, ControlLease.who(source)),
         do: Atom.to_string(state),
         else: (nil -> "unknown")
  end

  # Sorted from south to north, only neighbours can be near.
  defp near(snapshots, group, verb, %{radius_m: radius}) do
    least = 2 * radius

    places =
      for snapshot <- snapshots,
          %{lat: lat, lon: lon} when is_number(lat) and is_number(lon) <- [Snapshot.data(snapshot, group)],
          do: {lat, lon, snapshot.id}

    places
    |> Enum.sort()
    |> pairs(least)
    |> Enum.map(fn {one, other, metres} ->
      "#{one} and #{other} #{verb} #{:erlang.float_to_binary(metres, decimals: 1)} m apart, nearer than #{least} m"
    end)
  end

  defp pairs([], _least), do: []

  defp pairs([{lat, lon, id} | rest], least) do
    here = Earth.point(lat, lon)

    near =
      for {other_lat, other_lon, other} <-
            Enum.take_while(rest, fn {other, _lon, _id} -> (other - lat) * @degree_m < least end),
          metres = Earth.distance(here, Earth.point(other_lat, other_lon)),
          metres < least,
          do: {id, other, metres}

    near ++ pairs(rest, least)
  end
end
