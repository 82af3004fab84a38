defmodule Aerie.Api.Rest.Operations.Tracks.Get do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Api.Rest.Operations.Time
  alias Aerie.Base.Json.Object
  alias Aerie.Fleet

  # About 1 MB of JSON.
  @samples 10_000
  @max_vehicles 200
  @hour_us 3_600_000_000

  @sample Object.fields([
            {:at, :time, nil, "when the gateway looked"},
            {:lat, 7, "°", "null where it was not known, as all of these"},
            {:lon, 7, "°", "positive is east"},
            {:height, 1, "m", "above home"},
            {:heading, :integer, "°", "direction of the nose, 0 to 359 from north"},
            {:speed, 1, "m/s", "over the ground"},
            {:age, :integer, "s", "since the vehicle had been heard"},
            {:battery, 2, "0..1", "remaining charge"},
            {:mode, :text, nil, "the firmware's word"},
            {:armed, :boolean, nil, "false also where it was not known"},
            {:in_air, :boolean, nil, "false also where it was not known"},
            {:status, {:one_of, [:online, :stale, :lost]}, nil, "of the contact with the vehicle"}
          ])
  @track Object.fields([
           {:vehicle, :text, nil, "the vehicle's id"},
           {:samples, {:list, {:object, @sample}}, nil, "oldest first"}
         ])
  @answer Object.fields([
            {:tracks, {:list, {:object, @track}}, nil, "those of vehicles that have samples in the span"},
            {:next, :time, nil, "the `from` of the next page; null if this is the last one"},
            {:since, :time, nil, "the oldest time that is kept; null if there is none"}
          ])

  @impl true
  def operation do
    meaning = "how far apart the samples of a vehicle are at least; at 60 and more a day is read quickly"

    %Operation{
      name: "tracks.get",
      meaning: "Where vehicles were.",
      transfer?: false,
      closed?: true,
      fields: [
        Time.field(:from, "the beginning of the span; an hour before its end if left out"),
        Time.field(:to, "the end of the span; now if left out"),
        field(
          :vehicles,
          {:term, &names/1, "ids with commas between them, #{@max_vehicles} at most"},
          "which ones; all if left out",
          schema: %{type: :string, pattern: "^[^,]+(,[^,]+){0,#{@max_vehicles - 1}}$"}
        ),
        field(:step, {:integer, 1, 86_400}, meaning, default: 1, unit: "s")
      ],
      answer: @answer,
      routes: [get("/api/tracks", "Where vehicles were in the last 24 hours, page by page.")]
    }
  end

  defp names(text) do
    names = String.split(text, ",")
    if "" not in names and length(names) <= @max_vehicles, do: {:ok, names}, else: :error
  end

  @impl true
  def run(%{from: from, to: to, vehicles: vehicles, step: step}, %{gateway: gateway}) do
    to = to || System.os_time(:microsecond)
    from = from || to - @hour_us

    with {:ok, found} <- Fleet.tracks(gateway, vehicles || :all, from, to, step, limit: @samples) do
      tracks = for {id, samples} <- Enum.sort(found.vehicles), do: %{vehicle: id, samples: samples}
      {:ok, Object.show(@answer, %{tracks: tracks, next: found.next, since: found.since})}
    else
      {:error, text} -> {:error, {:unavailable, text}}
    end
  end
end
