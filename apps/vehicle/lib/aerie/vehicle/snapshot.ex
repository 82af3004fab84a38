defmodule Aerie.Vehicle.Snapshot do
  @moduledoc "Reads a vehicle's snapshot, as `Aerie.Base.Store` keeps it."

  @doc "The data of a group; empty if the group was never heard."
  @spec data(map(), atom()) :: map()
  def data(%{groups: groups}, group) do
    case groups do
      %{^group => %{data: data}} -> data
      _unheard -> %{}
    end
  end
end
