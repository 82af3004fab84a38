defmodule Aerie.Api.Metrics.Vehicles do
  @moduledoc "Metric families of vehicles, from their snapshots. Unknown values are left out."

  alias Aerie.Api.Metrics.Text

  @doc "The families of these vehicles, heard on these links, at a unix time in microseconds."
  @spec families([map()], [map()], integer()) :: [Text.family()]
  def families(vehicles, links, now) do
    [
      {"gateway_vehicles", :gauge, "Vehicles known.", [{[], length(vehicles)}]},
      gauge(vehicles, "gateway_vehicle_online", "1 online, 0 stale or lost.", &(&1.status == :online)),
      gauge(
        vehicles,
        "gateway_vehicle_silent_seconds",
        "Time since it was last heard.",
        &silent(&1, links, now)
      ),
      gauge(
        vehicles,
        "gateway_vehicle_armed",
        "1 while armed, 0 while not; absent while lost.",
        &now(&1, :armed)
      ),
      gauge(
        vehicles,
        "gateway_vehicle_in_air",
        "1 while in the air, 0 while not; absent while lost.",
        &now(&1, :in_air)
      ),
      gauge(
        vehicles,
        "gateway_vehicle_battery_ratio",
        "Remaining charge, 0 to 1.",
        &field(&1, :battery, :remaining)
      ),
      gauge(vehicles, "gateway_vehicle_battery_volts", "Battery voltage.", &field(&1, :battery, :voltage)),
      gauge(vehicles, "gateway_vehicle_satellites", "Satellites in use.", &field(&1, :gps, :satellites)),
      gauge(vehicles, "gateway_vehicle_links", "Links it is heard on.", &length(&1.links)),
      gauge(
        vehicles,
        "gateway_vehicle_gcs_failsafe_quiet",
        "1 while the ground station that its failsafe listens to is heard, 0 while it is gone.",
        &part(&1, :gcs, :quiet?)
      ),
      gauge(
        vehicles,
        "gateway_vehicle_clock_error_seconds",
        "Largest error of its clock's known offset.",
        &seconds(part(&1, :clock, :error_us))
      ),
      gauge(
        vehicles,
        "gateway_vehicle_round_trip_seconds",
        "Shortest round trip of the latest measurements of its clock.",
        &seconds(part(&1, :clock, :rtt_us))
      ),
      gauge(
        vehicles,
        "gateway_vehicle_streams_wanting",
        "Messages that come less often than wanted and are no longer requested.",
        &wanting/1
      ),
      gauge(
        vehicles,
        "gateway_vehicle_high_latency",
        "1 while it is reached by links of high latency only.",
        &part(&1, :high_latency, :only?)
      ),
      gauge(
        vehicles,
        "gateway_vehicle_signed",
        "1 while its frames have valid signatures, 0 if it has a key and they do not.",
        fn vehicle -> part(vehicle, :signing, :state) && vehicle.signing.state == :verified end
      ),
      gauge(vehicles, "gateway_vehicle_collision", "1 while two vehicles use its id.", fn vehicle ->
        vehicle.collision != nil
      end)
    ]
  end

  defp part(vehicle, part, key) do
    with %{^key => value} <- Map.fetch!(vehicle, part), do: value
  end

  defp seconds(us) when is_integer(us), do: us / 1_000_000
  defp seconds(_unknown), do: nil

  defp wanting(%{streams: %{} = streams}),
    do: Enum.count(streams, fn {_id, line} -> line.state in [:short, :yielded] end)

  defp wanting(_unknown), do: nil

  defp gauge(vehicles, name, help, value) do
    {name, :gauge, help, Enum.map(vehicles, &{[vehicle: &1.id], value.(&1)})}
  end

  defp silent(vehicle, links, now) do
    with us when is_integer(us) <- Aerie.Vehicle.Snapshot.Age.silent_us(vehicle, links, now),
         do: us / 1_000_000
  end

  # The last report of a lost vehicle says nothing about now.
  defp now(%{status: :lost}, _key), do: nil
  defp now(vehicle, key), do: field(vehicle, :mode, key)

  defp field(vehicle, group, key) do
    case vehicle.groups do
      %{^group => %{data: %{^key => value}}} -> value
      _unknown -> nil
    end
  end
end
