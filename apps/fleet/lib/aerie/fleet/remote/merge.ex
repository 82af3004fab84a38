defmodule Aerie.Fleet.Remote.Merge do
  @moduledoc "Vehicles of this gateway's links and those of other gateways as one (`Aerie.Fleet`)."

  alias Aerie.Base.{Names, Store}
  alias Aerie.Fleet.Remote.Table
  alias Aerie.Vehicle.Snapshot

  @older_us 10_000_000

  @doc "All vehicles, those on this gateway's links first."
  @spec vehicles(Names.gateway()) :: [Snapshot.t()]
  def vehicles(gateway) do
    local = Store.vehicles(gateway)
    remote = Table.vehicles(gateway, now())
    known = MapSet.new(local, & &1.id)

    Enum.map(local, &merge(&1, remote[&1.id])) ++
      for({id, vehicle} <- Enum.sort(remote), id not in known, do: vehicle)
  end

  @doc "One vehicle by its id; nil if no gateway knows it."
  @spec vehicle(Names.gateway(), String.t()) :: Snapshot.t() | nil
  def vehicle(gateway, id),
    do: merge(Store.vehicle(gateway, id), Table.vehicle(gateway, id, now()))

  @doc "The snapshot of a vehicle that may be heard here (local), there (remote), or both."
  @spec merge(local :: Snapshot.t() | nil, remote :: Snapshot.t() | nil) :: Snapshot.t() | nil
  def merge(nil, remote), do: remote
  def merge(local, nil), do: local

  def merge(%{status: :lost} = local, %{status: status} = remote) when status != :lost,
    do: %{remote | groups: groups(remote.groups, local.groups)}

  def merge(local, remote),
    do: %{local | gateways: remote.gateways, groups: groups(local.groups, remote.groups)}

  defp groups(first, second) do
    Map.merge(first, second, fn _group, one, other ->
      if other.at > one.at + @older_us, do: other, else: one
    end)
  end

  defp now, do: System.os_time(:microsecond)
end
