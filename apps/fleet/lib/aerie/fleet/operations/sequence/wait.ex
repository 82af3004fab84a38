defmodule Aerie.Fleet.Operations.Sequence.Wait do
  @moduledoc "Whether what a step of a sequence waits for is there, by the vehicles as they are seen just now."

  alias Aerie.Base.Names
  alias Aerie.Fleet.Remote.Merge
  alias Aerie.Fleet.Operations.Sequence
  alias Aerie.Vehicle.Snapshot

  @level_m Sequence.level_m()

  @typedoc "What it waits for, and the vehicle whose change may end that."
  @type waiting :: {:waiting, String.t(), vehicle :: String.t()}

  @doc "Whether a vehicle of an operation on `vehicles` may go on, or what it waits for."
  @spec look(Names.gateway(), String.t(), [String.t()], Sequence.wait()) :: :ok | waiting()
  def look(gateway, vehicle, vehicles, wait) do
    read = &Merge.vehicle(gateway, &1)
    vehicle = wait.of || vehicle

    case read.(vehicle) do
      nil -> {:waiting, "nobody hears it", vehicle}
      %{status: :lost} -> {:waiting, "it is lost", vehicle}
      snapshot -> look(wait, snapshot, Stream.map(vehicles -- [vehicle], read))
    end
  end

  @doc "The same of a snapshot, and those of the other vehicles."
  @spec look(Sequence.wait(), Snapshot.t(), Enumerable.t(Snapshot.t() | nil)) :: :ok | waiting()
  def look(%{for: :above, m: m}, %{id: id} = snapshot, _others) do
    case Snapshot.data(snapshot, :position)[:alt_rel] do
      height when is_number(height) and height > m -> :ok
      height when is_number(height) -> {:waiting, "#{round(height)} m high, not above #{m} m", id}
      _unknown -> {:waiting, "its height is not known", id}
    end
  end

  def look(%{for: :at, m: m}, %{id: id} = snapshot, _others) do
    case Snapshot.data(snapshot, :position)[:alt_rel] do
      height when is_number(height) and abs(height - m) <= @level_m -> :ok
      height when is_number(height) -> {:waiting, "#{round(height)} m high, not at #{m} m", id}
      _unknown -> {:waiting, "its height is not known", id}
    end
  end

  def look(%{for: :time}, %{id: id}, _others), do: {:waiting, "its time is not over", id}

  def look(%{for: :landed}, %{id: id} = snapshot, _others),
    do: if(in_air(snapshot) == false, do: :ok, else: {:waiting, "#{id} is not known to be on the ground", id})

  def look(%{for: :alone}, _snapshot, others) do
    case Enum.find(others, &(&1 != nil and armed?(&1) and in_air(&1) != true)) do
      nil -> :ok
      other -> {:waiting, "#{other.id} stands armed on the ground", other.id}
    end
  end

  defp in_air(snapshot), do: Snapshot.data(snapshot, :mode)[:in_air]
  defp armed?(snapshot), do: Snapshot.data(snapshot, :mode)[:armed] == true
end
