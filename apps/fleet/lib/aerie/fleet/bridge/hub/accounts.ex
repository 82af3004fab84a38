defmodule Aerie.Fleet.Bridge.Hub.Accounts do
  @moduledoc """
  The accounts of a hub's nats-server, as text of its configuration. Pure.

  The account `FLEET` has the streams and buckets; the hub's gateway and operators are its users. Each vehicle has an
  account of its own, to which its leaf node belongs. Between the two passes what is listed here and nothing else:

  | from a vehicle to the fleet, on the leaf's subject | in the fleet |
  |---|---|
  | `fleet.E.V.state.GROUP` of each group that there is, progress of requests | the same |
  | `hub.fleet.E.V.event.TYPE` of each type that there is, confirmed by the stream | `fleet.E.V.event.TYPE` |
  | `hub.kv.get.BUCKET.KEY`, `hub.kv.put.BUCKET.KEY` of its own keys | the bucket |
  | `hub.info` | whether JetStream is up |

  | from the fleet to a vehicle | on the leaf |
  |---|---|
  | `fleet.E.V.{cmd,params,mission,files,logs}.*`, answered | the same |
  | what is written to its own keys | `hub.kv.new.BUCKET.KEY` |

  Permissions within one account would not be enough: the answer to a request goes to the subject that the request
  names, so a vehicle could have JetStream publish its own text in another one's name. Between accounts, answers have
  subjects of the server's.

  Headers pass from one account to another, so the streams and buckets are such that none has an effect on other
  vehicles: roll-up is off, each vehicle's events have a stream of their own
  (`Aerie.Fleet.Bridge.Events.VehicleStreams`), in which it knows its ids, and sizes are limited. What a vehicle can
  fill is its listed subjects times the size of a message, for which the hub has room (`Aerie.Fleet.Bridge.Hub.Quota`).

  A vehicle has only the lease of the gateway that acts on it. The hub's gateway answers for the desired state:
  documents aboard and at the hub are kept the same (`Aerie.Fleet.Shadow.Documents.Uplink`).

  Events have a subject of their own on the leaf, because the leaf stores them in a stream of its own: the gateway
  forwards them in order (`Aerie.Fleet.Bridge.Forward`).
  """

  @areas ~w(cmd params mission files logs)
  alias Aerie.Fleet.Bridge.Message

  @get "$JS.API.DIRECT.GET.KV_"

  @type vehicle :: {id :: String.t(), public :: String.t()}

  @doc "The text. `gateways` are the public nkeys of the hubs."
  @spec render(String.t(), gateways :: [String.t()], [vehicle()]) :: String.t()
  def render(environment, gateways, vehicles) do
    """
    # Written by bin/nats-setup; changes are lost.
    accounts {
      FLEET {
        jetstream: enabled
        users: [ #{Enum.map_join(gateways, ", ", &"{ nkey: #{&1} }")} ]
        exports: [
    #{lines(for {id, _key} <- vehicles, {kind, subject, _to} <- granted(environment, id), do: export(kind, subject, account(id)))}
        ]
        imports: [
    #{lines(for {id, _key} <- vehicles, subject <- obeyed(environment, id), do: import_(:service, account(id), subject, nil))}
        ]
      }
    #{Enum.map_join(vehicles, "", &vehicle(environment, &1))}}
    """
  end

  defp vehicle(environment, {id, public}) do
    """
      #{account(id)} {
        # Its key opens a leaf node and nothing else.
        users: [ { nkey: #{public}, allowed_connection_types: ["LEAFNODE"] } ]
        exports: [
    #{lines(for subject <- obeyed(environment, id), do: export(:service, subject, "FLEET"))}
        ]
        imports: [
    #{lines(for {kind, subject, to} <- granted(environment, id), do: import_(kind, "FLEET", subject, to))}
        ]
      }
    """
  end

  defp lines(lines), do: Enum.map_join(lines, "\n", &("      " <> &1))

  defp export(kind, subject, account), do: "{ #{kind}: #{quoted(subject)}, accounts: [#{account}] }"

  defp import_(kind, account, subject, to) do
    to = if to, do: ", to: #{quoted(to)}"
    "{ #{kind}: { account: #{account}, subject: #{quoted(subject)} }#{to} }"
  end

  defp account(id), do: quoted("vehicle-" <> id)

  # Requests that a vehicle answers.
  defp obeyed(environment, id), do: for(area <- @areas, do: "fleet.#{environment}.#{id}.#{area}.*")

  # Subjects that the fleet imports from a vehicle, or exports to it: `{kind, subject of the fleet, subject on the leaf,
  # nil for the same}`.
  defp granted(environment, id) do
    vehicle = "fleet.#{environment}.#{id}"

    for(group <- Message.state_groups(), do: {:service, "#{vehicle}.state.#{group}", nil}) ++
      events(vehicle) ++
      events("fleet.#{environment}.gateway-#{id}") ++
      for(area <- @areas, do: {:service, "#{vehicle}.#{area}.*.progress.>", nil}) ++
      [{:service, "$JS.API.INFO", "hub.info"}] ++ buckets(environment, id)
  end

  defp events(publisher),
    do:
      for(
        type <- Message.event_types(),
        subject = "#{publisher}.event.#{type}",
        do: {:service, subject, "hub." <> subject}
      )

  defp buckets(environment, id) do
    document = "#{environment}.#{id}"
    owner = "#{environment}.vehicles.#{id}"

    [
      get("fleet_desired", document),
      put("fleet_desired", document),
      new("fleet_desired", document),
      put("fleet_reported", document),
      get("fleet_leases", owner),
      put("fleet_leases", owner),
      get("fleet_plans", "*")
    ]
  end

  defp get(bucket, key),
    do: {:service, "#{@get}#{bucket}.$KV.#{bucket}.#{key}", "hub.kv.get.#{bucket}.#{key}"}

  defp put(bucket, key), do: {:service, "$KV.#{bucket}.#{key}", "hub.kv.put.#{bucket}.#{key}"}
  defp new(bucket, key), do: {:stream, "$KV.#{bucket}.#{key}", "hub.kv.new.#{bucket}.#{key}"}

  defp quoted(text), do: JSON.encode!(text)
end
