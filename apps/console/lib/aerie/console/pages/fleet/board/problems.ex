defmodule Aerie.Console.Pages.Fleet.Board.Problems do
  @moduledoc "The problems of a vehicle, in a few words each, the worst first. Pure."

  alias Aerie.Vehicle.Snapshot

  @type problem :: {:bad | :warn, String.t()}

  @low 0.3
  @empty 0.15

  @doc "The problems that a snapshot shows."
  @spec of(map()) :: [problem()]
  def of(vehicle) do
    [
      status(vehicle.status),
      failsafe(Snapshot.data(vehicle, :mode)),
      collision(vehicle.collision),
      fence(Snapshot.data(vehicle, :mission)),
      battery(Snapshot.data(vehicle, :battery)),
      gps(Snapshot.data(vehicle, :gps), Snapshot.data(vehicle, :mode)),
      health(Snapshot.data(vehicle, :health))
    ]
    |> List.flatten()
    |> Enum.sort_by(fn {severity, _text} -> severity == :warn end)
  end

  defp status(:lost), do: [{:bad, "lost"}]
  defp status(:stale), do: [{:warn, "not heard"}]
  defp status(:online), do: []

  defp failsafe(%{failsafe: true}), do: [{:bad, "failsafe"}]
  defp failsafe(_mode), do: []

  defp collision(nil), do: []
  defp collision(%{sign: "claim"}), do: [{:bad, "somebody else sends under its id"}]
  defp collision(_seen), do: [{:bad, "two vehicles with one id"}]

  defp fence(%{fence_breach: true}), do: [{:bad, "outside its fence"}]
  defp fence(_mission), do: []

  defp battery(%{charge_state: state}) when state in ["CRITICAL", "EMERGENCY", "FAILED", "UNHEALTHY"],
    do: [{:bad, "battery " <> String.downcase(state)}]

  defp battery(%{remaining: left}) when is_number(left) and left <= @empty,
    do: [{:bad, "battery #{round(left * 100)} %"}]

  defp battery(%{charge_state: "LOW"}), do: [{:warn, "battery low"}]

  defp battery(%{remaining: left}) when is_number(left) and left <= @low,
    do: [{:warn, "battery #{round(left * 100)} %"}]

  defp battery(_data), do: []

  # Indoors and on the ground this is not unusual.
  defp gps(%{fix: fix}, %{in_air: true}) when is_integer(fix) and fix < 3, do: [{:bad, "no GPS fix"}]
  defp gps(_gps, _mode), do: []

  defp health(%{unhealthy: [_ | _] = names}),
    do: [{:warn, "unhealthy: " <> (names |> Enum.take(3) |> Enum.map_join(", ", &name/1))}]

  defp health(_data), do: []

  # MAV_SYS_STATUS_SENSOR_3D_GYRO and similar names.
  defp name(name) do
    name
    |> to_string()
    |> String.replace(~r/^(MAV_SYS_STATUS_)?(SENSOR_)?/, "")
    |> String.downcase()
    |> String.replace("_", " ")
  end
end
