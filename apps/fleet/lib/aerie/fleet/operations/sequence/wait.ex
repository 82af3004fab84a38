defmodule Aerie.Fleet.Operations.Sequence.Wait do
  @moduledoc "Whether what a step of a sequence waits for is there, by the vehicles as they are seen just now."

  alias Aerie.Base.Names
  alias Aerie.Fleet.Remote.Merge
  alias Aerie.Fleet.Operations.Sequence
  alias Aerie.Vehicle.{Firmware, Snapshot}
  alias Aerie.Vehicle.Command.Refusal

  @level_m Sequence.level_m()
  # It has arrived, and does not only pass by.
  @still_m_s 1
  @by_place [:guided, :hold]

  @typedoc "What it waits for, and the vehicle whose change may end that."
  @type waiting :: {:waiting, String.t(), vehicle :: String.t()}

  @doc "The wait as it begins: one for a place keeps the vehicle's mode."
  @spec begin(Names.gateway(), String.t(), Sequence.wait()) :: map()
  def begin(gateway, vehicle, %{for: :near} = wait),
    do: Map.put(wait, :mode, with(%{} = seen <- Merge.vehicle(gateway, vehicle), do: mode(seen)[:mode]))

  def begin(_gateway, _vehicle, wait), do: wait

  @doc "Whether a vehicle of an operation on `vehicles` may go on, what it waits for, or why that comes no more."
  @spec look(Names.gateway(), String.t(), [String.t()], map()) :: :ok | waiting() | {:failed, String.t()}
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
  @spec look(map(), Snapshot.t(), Enumerable.t(Snapshot.t() | nil)) ::
          :ok | waiting() | {:failed, String.t()}
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

  def look(%{for: :near, m: m, place: place, mode: mode}, %{id: id} = snapshot, _others) do
    metres = Snapshot.distance(snapshot, place)
    speed = Snapshot.data(snapshot, :velocity)[:groundspeed]
    now = mode(snapshot)[:mode]

    cond do
      now == nil -> {:waiting, "its mode is not known", id}
      taken_over?(mode, now) -> {:failed, Refusal.text(:mode_changed, mode: now)}
      metres == nil -> {:waiting, "its position is not known", id}
      metres > m -> {:waiting, "#{round(metres)} m from the place, not within #{m} m", id}
      is_number(speed) and speed < @still_m_s -> :ok
      true -> {:waiting, "it is not known to be slower than #{@still_m_s} m/s", id}
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

  # The mode in which it flies there may be seen late.
  defp taken_over?(mode, now) when mode == now, do: false

  defp taken_over?(mode, now),
    do: Firmware.action(mode) in @by_place or Firmware.action(now) not in @by_place

  defp in_air(snapshot), do: mode(snapshot)[:in_air]
  defp armed?(snapshot), do: mode(snapshot)[:armed] == true
  defp mode(snapshot), do: Snapshot.data(snapshot, :mode)
end
