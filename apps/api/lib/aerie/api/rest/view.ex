defmodule Aerie.Api.Rest.View do
  @moduledoc "The objects that `/api` returns, made from the read model. Pure apart from reading it."

  alias MavRouter.Client
  alias Aerie.Fleet.Client.StateForm
  alias Aerie.Fleet.Bridge.Message
  alias Aerie.Base.Json
  alias Aerie.Vehicle.Snapshot.Age
  alias Aerie.Vehicle.Journal
  alias Aerie.Base.Store
  alias Aerie.Control.Policy
  alias Aerie.Fleet
  alias Aerie.Fleet.Shadow
  alias MavRouter.Endpoints.Counters
  alias Aerie.Vehicle.Fields
  alias Aerie.Api.Rest.View.{VehicleDetails, Recordings}
  alias Aerie.Api.Rest.EventsQuery

  @link_keys [
    :id,
    :network,
    :kind,
    :url,
    :label,
    :status,
    :quality,
    :text,
    :reason,
    :retry_in_ms,
    :local,
    :port,
    :peer,
    :rates,
    :signing
  ]

  @doc "The whole status: one object per vehicle, one per link, NATS, and the gateway's identity."
  @spec status(term()) :: map()
  def status(gateway) do
    now = System.os_time(:microsecond)
    links = Store.links(gateway)
    by_id = Map.new(links, &{&1.id, &1})
    tags = Shadow.tags(gateway)

    %{
      timestamp: Float.round(now / 1_000_000, 3),
      epoch: Journal.epoch(gateway),
      vehicles: for(vehicle <- Fleet.vehicles(gateway), do: vehicle(vehicle, by_id, tags, now)),
      links: for(link <- links, do: Json.plain(Map.take(link, [:id, :network, :status, :text]))),
      nats: nats(Aerie.Fleet.Bridge.info(gateway)),
      identity: MavRouter.Router.identity(gateway),
      recorder: Recordings.status(gateway)
    }
  end

  defp vehicle(vehicle, links, tags, now) do
    vehicle
    |> StateForm.of(links, now)
    |> Map.merge(%{
      recording: Recordings.one(vehicle.recording),
      via: vehicle.via,
      gateways: vehicle.gateways,
      tags: Map.get(tags, vehicle.id, [])
    })
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
    with %{} = vehicle <- Fleet.vehicle(gateway, id) do
      now = System.os_time(:microsecond)
      all = Store.links(gateway)
      links = Map.new(all, &{&1.id, &1})
      clock = Age.now(vehicle, all, now)

      vehicle
      |> vehicle(links, Shadow.tags(gateway), now)
      |> Map.merge(%{
        firmware: Json.plain(vehicle.firmware),
        capabilities: vehicle.capabilities,
        time_boot_ms: vehicle.time_boot_ms,
        uid: Json.plain(vehicle.uid),
        collision: collision(vehicle.collision),
        component: vehicle.component,
        last_heard: Json.time(vehicle.last_heard),
        links: Json.plain(vehicle.links),
        signing: signed(vehicle.signing),
        groups: Map.new(vehicle.groups, fn {name, group} -> {name, group(name, group, clock)} end)
      })
      |> Map.merge(VehicleDetails.of(vehicle))
    end
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

  defp collision(nil), do: nil

  defp collision(%{at: at} = collision),
    do: %{time: Json.time(at), sign: collision.sign, links: collision.links}

  @doc "All signing keys by name, without the keys themselves, and the vehicles whose key is not confirmed."
  @spec signing(term()) :: map()
  def signing(gateway),
    do: Map.new(MavRouter.Signing.list(gateway), fn {name, value} -> {name, Json.plain(value)} end)

  @doc "The state of a vehicle's signing (`t:MavRouter.Signing.status/0`); nil without a key."
  @spec signed(map() | nil) :: map() | nil
  def signed(nil), do: nil

  def signed(signing) do
    times = Map.new([:verified_at, :unsigned_at], &{&1, Json.time(signing[&1])})
    Map.new(Map.merge(signing, times), fn {name, value} -> {name, Json.plain(value)} end)
  end

  @doc "The conditions of `Aerie.Fleet.Diagnosis`, the most serious first."
  @spec diagnosis(term()) :: map()
  def diagnosis(gateway),
    do: %{conditions: Enum.map(Aerie.Fleet.Diagnosis.list(gateway), &Aerie.Fleet.Diagnosis.Condition.plain/1)}

  @doc "All links with their counters and rates."
  @spec links(term()) :: map()
  def links(gateway), do: %{links: Enum.map(MavRouter.Link.list(gateway), &link/1)}

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

  defp link(link) do
    link
    |> Map.take(@link_keys)
    |> Map.merge(%{
      since: Json.time(link[:since]),
      last_heard: Json.time(link[:last_heard]),
      recording: Recordings.one(link[:recording]),
      overload: dated(link[:overload]),
      behind: dated(link[:behind]),
      peers: for(peer <- link[:peers] || [], do: Map.take(peer, [:text, :silent_ms, :frames_in, :bytes_in])),
      counters: counters(link[:counters])
    })
    |> Fields.Object.rounded_link()
    |> Json.plain()
  end

  defp dated(nil), do: nil
  defp dated(%{since: since} = dropped), do: %{dropped | since: Json.time(since)}

  # Counters by message id are only for the metrics.
  defp counters(nil), do: %{}
  defp counters(%_{} = counters), do: counters |> Map.from_struct() |> counters()

  defp counters(counters),
    do: counters |> Map.delete(:messages) |> Map.filter(fn {_name, n} -> is_number(n) end)

  defp group(name, group, now) do
    %{
      time: Json.time(group.at),
      age: Float.round(max(now - group.at, 0) / 1_000_000, 2),
      via: group[:via],
      time_boot_ms: group[:time_boot_ms],
      data: Json.plain(Fields.rounded(name, group.data))
    }
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
