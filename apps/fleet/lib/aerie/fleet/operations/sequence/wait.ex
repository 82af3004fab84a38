defmodule Aerie.Fleet.Operations.Sequence.Wait do
  @moduledoc "Whether what a step of a sequence waits for is there, by the vehicles as they are seen just now."

  alias Aerie.Base.Geo.Earth
  alias Aerie.Base.Names
  alias Aerie.Fleet.Remote.Merge
  alias Aerie.Fleet.Operations.Sequence
  alias Aerie.Vehicle.Snapshot

  # Farther off than this, height does not keep two vehicles apart.
  @near_m 20

  @doc "Whether a vehicle of an operation on `vehicles` may go on, or what it waits for."
  @spec look(Names.gateway(), String.t(), [String.t()], Sequence.wait()) :: :ok | {:waiting, String.t()}
  def look(gateway, vehicle, vehicles, wait) do
    read = &Merge.vehicle(gateway, &1)

    case read.(vehicle) do
      nil -> {:waiting, "nobody hears it"}
      %{status: :lost} -> {:waiting, "it is lost"}
      snapshot -> look(wait, snapshot, Stream.map(vehicles -- [vehicle], read))
    end
  end

  defp look(%{for: :above, m: m}, snapshot, _others) do
    case Snapshot.data(snapshot, :position)[:alt_rel] do
      height when is_number(height) and height > m -> :ok
      height when is_number(height) -> {:waiting, "#{round(height)} m high, not above #{m} m"}
      _unknown -> {:waiting, "its height is not known"}
    end
  end

  defp look(%{for: :landed}, snapshot, _others),
    do: if(in_air(snapshot) == false, do: :ok, else: {:waiting, "not known to be on the ground"})

  defp look(%{for: :alone}, _snapshot, others) do
    case Enum.find(others, &(&1 != nil and armed?(&1) and in_air(&1) != true)) do
      nil -> :ok
      other -> {:waiting, "#{other.id} stands armed on the ground"}
    end
  end

  defp look(%{for: :apart, m: m}, snapshot, others) do
    case height(snapshot) do
      nil ->
        {:waiting, "its height is not known"}

      height ->
        near =
          Enum.find(
            others,
            &(&1 != nil and in_air(&1) != false and near?(&1, snapshot) and level?(&1, height, m))
          )

        if near == nil, do: :ok, else: {:waiting, "not yet #{m} m above or below #{near.id}"}
    end
  end

  # What is not known counts as near.
  defp near?(other, snapshot) do
    with %{lat: lat, lon: lon} when is_number(lat) and is_number(lon) <- Snapshot.data(other, :position),
         %{lat: own_lat, lon: own_lon} when is_number(own_lat) and is_number(own_lon) <-
           Snapshot.data(snapshot, :position) do
      Earth.distance(Earth.point(own_lat, own_lon), Earth.point(lat, lon)) <= @near_m
    else
      _unknown -> true
    end
  end

  defp level?(other, height, m), do: with(nil <- height(other), do: true, else: (at -> abs(at - height) < m))

  defp height(snapshot) do
    position = Snapshot.data(snapshot, :position)
    position[:alt_msl] || position[:alt_rel]
  end

  defp in_air(snapshot), do: Snapshot.data(snapshot, :mode)[:in_air]
  defp armed?(snapshot), do: Snapshot.data(snapshot, :mode)[:armed] == true
end
