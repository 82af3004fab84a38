defmodule Aerie.Fleet.Operations.Sequence.Ending do
  @moduledoc """
  The operation that ends the flights of vehicles, all at once: in the air by the command; armed on the ground, or
  commanded just now, they are disarmed, and get the command if they fly after all. Those at rest are left alone.

  Several that return climb or descend first, to heights 3 m apart from 30 m on, the nearest to its home lowest. Each
  begins at once and waits for itself only: for 10 s and one more for each metre, 90 s at most. A vehicle that is not
  there then returns all the same, as one whose firmware takes no height does at once; at home each firmware's own
  height counts.
  """

  alias Aerie.Base.Names
  alias Aerie.Fleet.Operations.Sequence.Returning
  alias Aerie.Fleet.Remote.Merge
  alias Aerie.Vehicle.{Firmware, Snapshot}

  @lowest_m 30
  @apart_m 3
  # Those that obey climb and descend faster than a metre a second.
  @least_s 10
  @most_s 90
  @words %{"hold" => "Hold all", "rtl" => "Return all", "land" => "Land all"}

  @doc "The commands that it can be, with their names on the pages."
  @spec words() :: %{String.t() => String.t()}
  def words, do: @words

  @doc "The request for `ids`, of which those in `under_way` were being commanded; nil if all of them are at rest."
  @spec request(Names.gateway(), [String.t()], MapSet.t(String.t()), type :: String.t()) :: map() | nil
  def request(gateway, ids, under_way, type) do
    vehicles = for id <- ids, do: {id, Merge.vehicle(gateway, id)}
    {flying, grounded} = Enum.split_with(vehicles, fn {_id, snapshot} -> in_air(snapshot) != false end)

    grounded =
      for {id, snapshot} <- grounded,
          Snapshot.data(snapshot, :mode)[:armed] != false or id in under_way,
          do: %{"vehicle" => id, "steps" => [%{"type" => "disarm"}], "else" => [%{"type" => type}]}

    case flying(flying, type) ++ grounded do
      [] -> nil
      all -> %{"name" => @words[type], "sequence" => all, "step" => 100, "halt_ratio" => 1}
    end
  end

  defp flying([_one, _two | _more] = vehicles, "rtl") do
    vehicles
    |> Enum.sort_by(fn {_id, snapshot} -> home_m(snapshot) end)
    |> Enum.with_index(fn {id, snapshot}, i ->
      home = [%{"type" => "rtl"}]
      %{"vehicle" => id, "steps" => climb(snapshot, @lowest_m + i * @apart_m) ++ home, "else" => home}
    end)
  end

  defp flying(vehicles, type),
    do: for({id, _snapshot} <- vehicles, do: %{"vehicle" => id, "steps" => [%{"type" => type}]})

  defp climb(nil, _height), do: []

  defp climb(snapshot, height) do
    if Firmware.of(snapshot.autopilot).gap("set_altitude", snapshot.vehicle_type) == nil do
      way = abs(height - (Snapshot.data(snapshot, :position)[:alt_rel] || 0))
      Returning.climb(height, %{"go_on" => true, "timeout_s" => min(@least_s + way, @most_s)})
    else
      []
    end
  end

  # What is not known is far away.
  defp home_m(nil), do: :unknown

  defp home_m(snapshot) do
    case Snapshot.data(snapshot, :home) do
      %{lat: lat, lon: lon} when is_number(lat) and is_number(lon) ->
        Snapshot.distance(snapshot, {lat, lon}) || :unknown

      _unknown ->
        :unknown
    end
  end

  defp in_air(nil), do: nil
  defp in_air(snapshot), do: Snapshot.data(snapshot, :mode)[:in_air]
end
