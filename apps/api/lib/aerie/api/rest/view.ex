defmodule Aerie.Api.Rest.View do
  @moduledoc "The objects that `/api` returns, made from the read model. Pure apart from reading it."

  alias MavRouter.Client
  alias Aerie.Fleet.Bridge.Message
  alias Aerie.Base.Json
  alias Aerie.Vehicle.Journal
  alias Aerie.Base.Store
  alias Aerie.Control.Policy
  alias Aerie.Fleet
  alias Aerie.Fleet.Shadow
  alias MavRouter.Endpoints.Counters
  alias Aerie.Base.Json.Object
  alias Aerie.Vehicle.Snapshot
  alias Aerie.Api.Rest.EventsQuery
  alias Aerie.Api.Rest.View.Recordings

  @doc "The whole status: one object per vehicle, one per link, NATS, and the gateway's identity."
  @spec status(term()) :: map()
  def status(gateway) do
    context = context(gateway)

    %{
      timestamp: Float.round(context.now / 1_000_000, 3),
      epoch: Journal.epoch(gateway),
      vehicles: for(vehicle <- Fleet.vehicles(gateway), do: Snapshot.Fields.show(vehicle, :listed, context)),
      links:
        for(
          {_id, link} <- Enum.sort(context.links),
          do: Json.plain(Map.take(link, [:id, :network, :status, :text]))
        ),
      nats: nats(Aerie.Fleet.Bridge.info(gateway)),
      identity: MavRouter.Router.identity(gateway),
      recorder: Recordings.status(gateway)
    }
  end

  defp context(gateway) do
    links = Map.new(Store.links(gateway), &{&1.id, &1})
    %{now: System.os_time(:microsecond), links: links, tags: Shadow.tags(gateway)}
  end

  @doc "All vehicles, as in `status/1`; only those with a tag unless it is nil."
  @spec vehicles(term(), tag :: String.t() | nil) :: map()
  def vehicles(gateway, tag) do
    gateway
    |> status()
    |> Map.take([:timestamp, :vehicles])
    |> Map.update!(:vehicles, &Enum.filter(&1, fn vehicle -> tag == nil or tag in vehicle.tags end))
  end

  @doc "One vehicle with all its state groups, their times, and its streams, clock and so on; nil if no vehicle has this name."
  @spec vehicle(term(), String.t()) :: map() | nil
  def vehicle(gateway, id) do
    with %{} = vehicle <- Fleet.vehicle(gateway, id),
         do: Snapshot.Fields.show(vehicle, :whole, context(gateway))
  end

  @doc """
  The latest events of a vehicle, or of `:all`, as in NATS, oldest first; nil if there is no such vehicle. `more` is true if
  there are further events: later ones if `:since` is given, earlier ones otherwise. Options as in
  `Aerie.Vehicle.Journal.recent/3`.
  """
  @spec events(term(), String.t() | :all, EventsQuery.options()) :: map() | nil
  def events(gateway, vehicle, options) do
    limit = options[:limit]
    found = Journal.recent(gateway, vehicle, Keyword.put(options, :limit, limit + 1))
    shown = if options[:since], do: Enum.take(found, limit), else: Enum.take(found, -limit)

    if found != [] or vehicle == :all or Fleet.vehicle(gateway, vehicle) != nil,
      do: %{
        events: Enum.map(shown, &Message.event_object(&1, Journal.epoch(gateway))),
        more: length(found) > limit
      }
  end

  @doc "All signing keys by name, without the keys themselves, and the vehicles whose key is not confirmed."
  @spec signing(term()) :: map()
  def signing(gateway),
    do: Map.new(MavRouter.Signing.list(gateway), fn {name, value} -> {name, Json.plain(value)} end)

  @doc "The state of a vehicle's signing (`t:MavRouter.Signing.status/0`); nil without a key."
  @spec signed(map() | nil) :: map() | nil
  def signed(signing), do: signing && Object.show(MavRouter.Signing.fields(), signing)

  @doc "The conditions of `Aerie.Fleet.Diagnosis`, the most serious first."
  @spec diagnosis(term()) :: map()
  def diagnosis(gateway),
    do: %{conditions: Enum.map(Aerie.Fleet.Diagnosis.list(gateway), &Aerie.Fleet.Diagnosis.Condition.plain/1)}

  @doc "All links with their counters and rates."
  @spec links(term()) :: map()
  def links(gateway),
    do: %{links: Enum.map(MavRouter.Link.list(gateway), &Object.show(MavRouter.Link.fields(), &1))}

  @doc "The endpoints for clients, and all clients, each with its counters."
  @spec clients(term()) :: map()
  def clients(gateway) do
    %{
      endpoints:
        for(
          link <- Client.endpoints(gateway),
          do: Json.plain(Map.take(link, [:id, :url, :status, :text, :port]))
        ),
      clients: Enum.map(Client.list(gateway), &client/1)
    }
  end

  @doc "Since when the policy is in force, and the errors when it was last read; nil without a policy."
  @spec policy(term()) :: map() | nil
  def policy(gateway) do
    with %{since: since, problem: problem} <- Policy.Store.status(gateway) do
      %{since: Json.time(since), problem: problem && %{time: Json.time(problem.at), errors: problem.errors}}
    end
  end

  @doc "Rules of links and clients that were changed at run time, with the configured ones."
  @spec rules(term()) :: map()
  def rules(gateway), do: %{changed: Json.plain(MavRouter.Router.changes(gateway))}

  defp client(endpoint) do
    Json.plain(%{
      id: endpoint.owner,
      kind: endpoint.kind,
      peer: endpoint.peer,
      networks: endpoint.networks,
      access: if(endpoint.role == :read_only, do: :read, else: :full),
      since: Json.time(endpoint.since),
      waiting: endpoint.waiting,
      frames_in: endpoint.counters.frames_in,
      frames_out: endpoint.counters.frames_out,
      dropped: Counters.dropped(endpoint.counters),
      denied: endpoint.counters.denied
    })
  end

  defp nats(nil), do: nil

  defp nats(nats) do
    Json.plain(%{
      connected: nats.connected,
      url: nats[:url],
      waiting: nats[:outbox][:events],
      problem: nats.problem
    })
  end
end
