defmodule Aerie.Api.Rest.Operations.Events.List do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Access.HTTP.Error
  alias Aerie.Api.Rest.Operations.Time
  alias Aerie.Base.Json.Object
  alias Aerie.Fleet

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
    since = Time.field(:since, "only those after this time")

    %Operation{
      name: "event.list",
      meaning: "Lists the latest events of a vehicle, or of all.",
      transfer?: false,
      closed?: true,
      fields: [field(:limit, {:integer, 1, 1000}, "how many, the latest ones", default: 100), since],
      answer: @answer,
      routes: [
        get("/api/events", "The latest events of all vehicles."),
        get("/api/vehicles/:id/events", "The latest events of a vehicle.")
      ]
    }
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
