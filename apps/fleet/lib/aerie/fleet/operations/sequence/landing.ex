defmodule Aerie.Fleet.Operations.Sequence.Landing do
  @moduledoc """
  The steps of a vehicle that lands at a place: it flies there as by `goto`, and lands when it has arrived. If it does
  not arrive, if somebody commands it on the way, or if its mode is changed, it does not land. Pure.
  """

  alias Aerie.Vehicle.Snapshot

  @near_m 3
  # Firmwares fly faster, climb and descend faster, and have wind against them.
  @usual_m_s 2
  @least_s 60
  @most_s 3_600

  @doc "The vehicle of a sequence, with the parameters of its `goto`; or why it cannot land there."
  @spec steps(Snapshot.t(), goto :: %{String.t() => term()}) :: {:ok, map()} | {:error, String.t()}
  def steps(%{id: id} = snapshot, %{"lat" => lat, "lon" => lon} = goto) do
    case {refusal(snapshot), Snapshot.distance(snapshot, {lat, lon})} do
      {nil, nil} ->
        {:error, "its position is not known"}

      {nil, metres} ->
        way_s = metres / min(goto["speed"] || @usual_m_s, @usual_m_s) + climb_m(snapshot, goto)
        near = %{"wait" => "near", "lat" => lat, "lon" => lon, "m" => @near_m}
        near = Map.put(near, "timeout_s", min(@least_s + ceil(way_s), @most_s))

        {:ok,
         %{"vehicle" => id, "steps" => [%{"type" => "goto", "params" => goto}, near, %{"type" => "land"}]}}

      {why, _metres} ->
        {:error, why}
    end
  end

  # A metre a second.
  defp climb_m(snapshot, goto) do
    case Snapshot.data(snapshot, :position)[:alt_rel] do
      height when is_number(height) -> abs(height - goto["altitude"])
      _unknown -> 0
    end
  end

  @doc "Why a vehicle cannot land at a place now, whatever its firmware has; nil if nothing speaks against it."
  @spec refusal(Snapshot.t()) :: String.t() | nil
  def refusal(%{vehicle_type: kind}) when kind in ["plane", "vtol"],
    do: "what has wings circles around a place: fly a mission with a landing, or return"

  def refusal(%{status: :lost}), do: "it is lost"

  def refusal(snapshot) do
    case Snapshot.data(snapshot, :mode)[:in_air] do
      true -> nil
      false -> "it is on the ground"
      nil -> "it is not known to be in the air"
    end
  end
end
