defmodule Aerie.Api.Rest.Operations.Events.List do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Access.HTTP.Error
  alias Aerie.Base.Json.Object
  alias Aerie.Fleet

  # The end of year 9999, the last one that ISO 8601 writes with four digits.
  @last_s 253_402_300_799
  @event Object.fields([
           {:id, :text, nil, "of two events with one id, the second is a copy"},
           {:vehicle, :text, nil, "the vehicle's id"},
           {:type, :text, nil, "type of the event"},
           {:epoch, :integer, nil, "the start of the gateway that it is of"},
           {:seq, :integer, nil, "1, 2, 3 … for each vehicle in an epoch"},
           {:time, :time, nil, "when the gateway received what shows it"},
           {:time_boot_ms, :integer, "ms", "the vehicle's own clock"},
           {:data, {:map, :any}, nil, "the fields of its type"}
         ])
  @answer Object.fields([
            {:events, {:list, {:shown, @event}}, nil, "oldest first"},
            {:more, :boolean, nil,
             "whether there are further ones: later ones with `since`, earlier ones without"}
          ])

  @impl true
  def operation do
    %Operation{
      name: "event.list",
      meaning: "Lists the latest events of a vehicle, or of all.",
      transfer?: false,
      closed?: true,
      fields: [field(:limit, {:integer, 1, 1000}, "how many, the latest ones", default: 100), since()],
      answer: @answer,
      routes: [
        get("/api/events", "The latest events of all vehicles."),
        get("/api/vehicles/:id/events", "The latest events of a vehicle.")
      ]
    }
  end

  defp since do
    words = "a time such as 2026-11-22T10:15:00Z, or unix seconds"
    meaning = "only those after this time: ISO 8601 with its offset, or unix seconds"
    schema = %{anyOf: [time(), number(0, @last_s)]}
    field(:since, {:term, &read_since/1, words}, meaning, schema: schema)
  end

  defp read_since(text) do
    with {:error, _no_date} <- DateTime.from_iso8601(text),
         {seconds, ""} when seconds >= 0 and seconds <= @last_s <- Float.parse(text) do
      {:ok, round(seconds * 1_000_000)}
    else
      {:ok, time, _offset} -> {:ok, DateTime.to_unix(time, :microsecond)}
      _neither -> :error
    end
  end

  @impl true
  def run(%{limit: limit, since: since}, %{gateway: gateway, vehicle: vehicle}) do
    found = Fleet.events(gateway, vehicle || :all, limit: limit + 1, since: since)
    shown = if since, do: Enum.take(found, limit), else: Enum.take(found, -limit)

    with :ok <- if(found == [] and vehicle != nil, do: known(gateway, vehicle), else: :ok) do
      events = Enum.map(shown, &Fleet.show_event(gateway, &1))
      {:ok, %{events: events, more: length(found) > limit}}
    end
  end

  # The gateway that hears the vehicle has its events; here are those from before it did.
  defp known(gateway, vehicle) do
    case Fleet.vehicle(gateway, vehicle) do
      nil ->
        {:error, {:unknown, "no vehicle has this name; see /api/vehicles"}}

      %{via: via} when via != nil ->
        if Fleet.events(gateway, vehicle, limit: 1) == [], do: {:error, Error.misdirected(via)}, else: :ok

      _heard_here ->
        :ok
    end
  end
end
