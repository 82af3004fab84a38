defmodule Aerie.Api.Metrics.Vehicles do
  @moduledoc "Metric families of vehicles, from their snapshots. Unknown values are left out."

  alias Aerie.Api.Metrics.Text
  alias Aerie.Base.Json.Object
  alias Aerie.Vehicle.Snapshot

  @groups for {group, _title, fields} <- Snapshot.groups(),
              %{path: [key], metric: {name, help}} <- fields,
              do: {group, key, name, help}
  @parts for part <- [:gcs, :clock, :high_latency],
             {field, name, help} <- :whole |> Snapshot.fields() |> Object.inside(part) |> Object.metrics(),
             do: {part, field, name, help}

  @doc "The families of these vehicles, heard on these links, at a unix time in microseconds."
  @spec families([Snapshot.t()], [map()], integer()) :: [Text.family()]
  def families(vehicles, links, now) do
    [
      {"gateway_vehicles", :gauge, "Vehicles known.", [{[], length(vehicles)}]},
      gauge(vehicles, "gateway_vehicle_online", "1 online, 0 stale or lost.", &(&1.status == :online)),
      gauge(
        vehicles,
        "gateway_vehicle_silent_seconds",
        "Time since it was last heard.",
        &silent(&1, links, now)
      )
    ] ++
      for({group, key, name, help} <- @groups, do: gauge(vehicles, name, help, &now(&1, group, key))) ++
      for({part, field, name, help} <- @parts, do: gauge(vehicles, name, help, &shown(&1, part, field))) ++
      [
        gauge(vehicles, "gateway_vehicle_links", "Links it is heard on.", &length(&1.links)),
        gauge(
          vehicles,
          "gateway_vehicle_streams_wanting",
          "Messages that come less often than wanted and are no longer requested.",
          &wanting/1
        ),
        gauge(
          vehicles,
          "gateway_vehicle_signed",
          "1 while its frames have valid signatures, 0 if it has a key and they do not.",
          &(&1.signing && &1.signing.state == :verified)
        ),
        gauge(
          vehicles,
          "gateway_vehicle_collision",
          "1 while two vehicles use its id.",
          &(&1.collision != nil)
        )
      ]
  end

  defp gauge(vehicles, name, help, value) do
    {name, :gauge, help, Enum.map(vehicles, &{[vehicle: &1.id], value.(&1)})}
  end

  defp silent(vehicle, links, now) do
    with us when is_integer(us) <- Snapshot.silent_us(vehicle, links, now), do: us / 1_000_000
  end

  # The last report of a lost vehicle says nothing about now.
  defp now(%{status: :lost}, :mode, _key), do: nil
  defp now(vehicle, group, key), do: Snapshot.data(vehicle, group)[key]

  defp shown(vehicle, part, field),
    do: with(%{} = shown <- Map.fetch!(vehicle, part), do: Object.value(field, shown))

  defp wanting(%{streams: %{} = streams}),
    do: Enum.count(streams, fn {_id, line} -> line.state in [:short, :yielded] end)

  defp wanting(_unknown), do: nil
end
