defmodule Aerie.Api.Rest.View.VehicleDetails do
  @moduledoc """
  What `GET /api/vehicles/ID` shows besides a vehicle's state: streams, ground stations, clock, reports. Pure, from its
  snapshot. A part that is missing in the snapshot is null.
  """

  alias Aerie.Base.Json
  alias MavCodec.Dialects.All

  @doc """
  * `streams` - the requested messages, each with `message`, `id`, `state`, `wanted_hz` (null: the vehicle's own rate),
    `asked_hz`, `measured_hz`
  * `gcs` - the `stations` on its network and whether each keeps its failsafe quiet (`keeps`), the ids that the failsafe
    listens to (`failsafe_gcs`, or both ends in `failsafe_range`), whether one of them keeps it quiet now (`quiet`,
    `heard_gcs`, `last_heard`), `enabled`, `timeout_s`, and the `params` that say so
  * `clock` - `offset_s` (the vehicle's clock minus the gateway's), `error_s`, `round_trip_s`, `boot` (when its clock was
    0), `time`
  * `reports` - its latest reports, newest first, and how many are `lost`
  * `high_latency` - whether it is reached by high-latency links `only`, and which `links` they are
  """
  @spec of(map()) :: map()
  def of(vehicle) do
    %{
      streams: part(vehicle, :streams, &streams/1),
      gcs: part(vehicle, :gcs, &gcs/1),
      clock: part(vehicle, :clock, &clock/1),
      reports: part(vehicle, :reports, &reports/1),
      high_latency: part(vehicle, :high_latency, &%{only: &1.only?, links: Json.plain(&1.links)})
    }
  end

  defp part(vehicle, name, fun), do: with(%{} = part <- Map.fetch!(vehicle, name), do: fun.(part))

  defp streams(lines) do
    for {id, line} <- Enum.sort(lines) do
      %{
        id: id,
        message: message(id),
        state: line.state,
        wanted_hz: rate(line.wanted),
        asked_hz: rate(line.asked),
        measured_hz: rate(line.measured)
      }
    end
  end

  defp message(id), do: All.name(id)

  defp gcs(gcs) do
    plain = Map.take(gcs, [:known_by, :failsafe_gcs, :heard_gcs, :timeout_s, :params])

    Map.merge(Json.plain(plain), %{
      failsafe_range: with({low, high} <- gcs.failsafe_range, do: [low, high]),
      last_heard: Json.time(gcs.last_heard),
      quiet: gcs.quiet?,
      enabled: gcs.enabled?,
      kept_by_gateway: gcs[:by_us?],
      withheld: gcs[:withheld?],
      stations: Enum.map(gcs.stations, &station/1)
    })
  end

  defp station(station) do
    station
    |> Map.take([:system, :component, :type, :via])
    |> Map.merge(%{last_heard: Json.time(station.last_heard), keeps: station[:keeps?]})
    |> Json.plain()
  end

  defp clock(clock) do
    %{
      offset_s: seconds(clock.offset_us),
      error_s: seconds(clock.error_us),
      round_trip_s: seconds(clock.rtt_us),
      boot: Json.time(clock.boot_at),
      time: Json.time(clock.at),
      samples: clock.samples
    }
  end

  defp reports(%{recent: recent, lost: lost}), do: %{recent: Enum.map(recent, &report/1), lost: lost}

  defp report(report) do
    Json.plain(%{
      time: Json.time(report.at),
      time_boot_ms: report.boot_ms,
      component: report.component,
      sequence: report.sequence,
      id: report.id,
      name: report.name,
      severity: report.severity,
      internal_severity: report.internal,
      arguments: report.arguments,
      values: report[:values],
      text: report.text
    })
  end

  defp seconds(us) when is_integer(us), do: Float.round(us / 1_000_000, 6)
  defp seconds(_unknown), do: nil

  defp rate(hz) when is_float(hz), do: Float.round(hz, 2)
  defp rate(hz) when is_integer(hz), do: hz
  defp rate(hz) when is_atom(hz), do: hz
end
