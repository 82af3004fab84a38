defmodule Aerie.Api.Rest.View do
  @moduledoc """
  The objects that `/api` returns, made from the read model. Pure apart from reading it.

  Each is declared here or where it is made (`Aerie.Base.Json.Object`); `answers/0` has the fields of all by the names
  that routes have.
  """

  alias Aerie.Base.Json
  alias Aerie.Base.Store
  alias Aerie.Control.Policy
  alias Aerie.Fleet
  alias Aerie.Fleet.Shadow
  alias Aerie.Base.Json.Object
  alias Aerie.Vehicle.Snapshot
  alias Aerie.Api.Rest.View.Recordings

  @link Enum.filter(MavRouter.Link.fields(), &(&1.name in [:id, :network, :status, :text]))
  @nats Object.fields([
          {:connected, :boolean, nil, "whether there is a connection"},
          {:url, :text, nil, "the server"},
          {:waiting, :integer, nil, "events that wait for it", [:outbox, :events]},
          {:problem, :text, nil, "why there is no connection"}
        ])
  @identity Object.fields([
              {:system, :integer, nil, "the gateway's own system id"},
              {:component, :integer, nil, "its own component id"},
              {:alarm, :text, nil, "that an autopilot has the same ids, while that is so"}
            ])
  @vehicles Object.fields([
              {:timestamp, 3, "s", "unix time of the answer"},
              {:vehicles, {:list, {:shown, Snapshot.fields(:listed)}}, nil, "one object for each"}
            ])
  @status @vehicles ++
            Object.fields([
              {:epoch, :integer, nil, "grows with each start of the gateway"},
              {:links, {:list, {:object, @link}}, nil, "one object for each"},
              {:nats, {:object, @nats}, nil, "the connection to NATS"},
              {:identity, {:object, @identity}, nil, "as what the gateway sends"},
              {:recorder, {:shown, Recordings.status_fields()}, nil, "what is being recorded"}
            ])
  @problem Object.fields([
             {:time, :time, nil, "when it was read", :at},
             {:errors, {:list, :text}, nil, "what is wrong with it"}
           ])
  @policy Object.fields([
            {:since, :time, nil, "since when it is in force"},
            {:problem, {:object, @problem}, nil,
             "what is wrong with the file, so that the former policy stays"}
          ])
  @ids Object.fields([
         {:added, {:list, :text}, nil, "those that are new, by their ids"},
         {:removed, {:list, :text}, nil, "those that were closed"},
         {:changed, {:list, :text}, nil, "those that were opened again because keys of them changed"}
       ])
  @failed Object.fields([
            {:what, :text, nil, "the link or client"},
            {:reason, :text, nil, "why it could not be opened"}
          ])
  @openapi Object.fields([
             {:openapi, :text, nil, "the version of OpenAPI"},
             {:info, {:map, :text}, nil, "what it is, and the version of the gateway"},
             {:servers, {:list, {:map, :text}}, nil, "where it may be served"},
             {:security, {:list, {:map, {:list, :text}}}, nil, "the ways to name a key"},
             {:paths, {:map, :any}, nil, "the methods of each path"},
             {:components, {:map, {:map, :any}}, nil, "the parts that the paths refer to"}
           ])
  @resource Object.fields([
              {:path, :text, nil, "its path"},
              {:methods, {:list, :text}, nil, "the methods that it takes"}
            ])

  @answers %{
    index: Object.fields([{:resources, {:list, {:object, @resource}}, nil, "all of them"}]),
    status: @status,
    vehicles: @vehicles,
    vehicle: Snapshot.fields(:whole),
    vehicle_signing: MavRouter.Signing.fields(),
    diagnosis:
      Object.fields([
        {:conditions, {:list, {:shown, Aerie.Fleet.Diagnosis.fields()}}, nil, "the worst first"}
      ]),
    policy: @policy,
    openapi: @openapi,
    reloaded:
      Object.fields([
        {:links, {:object, @ids}, nil, "what became of links"},
        {:clients, {:object, @ids}, nil, "what became of endpoints for clients"},
        {:needs_restart, {:list, :text}, nil, "keys that changed and count from the next start on"},
        {:failed, {:list, {:object, @failed}}, nil, "what could not be opened"}
      ]),
    ticket:
      Object.fields([
        {:ticket, :text, nil, "what the WebSocket is opened with"},
        {:expires_s, :integer, "s", "how long it is valid"}
      ])
  }

  @doc "The fields of the answers by their names."
  @spec answers() :: %{atom() => [Object.t()]}
  def answers, do: @answers

  @doc "The whole status: one object per vehicle, one per link, NATS, and the gateway's identity."
  @spec status(term()) :: map()
  def status(gateway) do
    vehicles = Fleet.vehicles(gateway)
    context = context(gateway, vehicles)

    Object.show(@status, %{
      timestamp: context.now / 1_000_000,
      epoch: Fleet.epoch(gateway),
      vehicles: for(vehicle <- vehicles, do: Snapshot.show(vehicle, :listed, context)),
      links:
        for(
          {_id, link} <- Enum.sort(context.links),
          do: Json.plain(Map.take(link, [:id, :network, :status, :text]))
        ),
      nats: Aerie.Fleet.Bridge.info(gateway),
      identity: MavRouter.Router.identity(gateway),
      recorder: Recordings.status(gateway)
    })
  end

  defp context(gateway, vehicles) do
    %{
      now: System.os_time(:microsecond),
      links: Map.new(Store.links(gateway), &{&1.id, &1}),
      tags: Shadow.tags(gateway),
      readiness: Fleet.readinesses(gateway, vehicles)
    }
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
         do: Snapshot.show(vehicle, :whole, context(gateway, [vehicle]))
  end

  @doc "The conditions of `Aerie.Fleet.Diagnosis`, the most serious first."
  @spec diagnosis(term()) :: map()
  def diagnosis(gateway),
    do: %{conditions: Aerie.Fleet.Diagnosis.plain(gateway)}

  @doc "Since when the policy is in force, and the errors when it was last read; nil without a policy."
  @spec policy(term()) :: map() | nil
  def policy(gateway) do
    with %{} = status <- Policy.status(gateway), do: Object.show(@policy, status)
  end
end
