defmodule Aerie.Fleet.Health do
  @moduledoc """
  Says whether a gateway is ready, part by part from the read model, so that a failing probe gives the reason.

  Ready means that the gateway's parts run and its code is loaded (`Aerie.Base.Store.starting?/1`), that NATS stores
  events (or is switched off by the configuration), that no autopilot has the gateway's own ids (its vehicle would be
  invisible), that the processes which its own heartbeat needs answer (`MavRouter.Identity.status/1`, as for
  `Aerie.Systemd`; those of one vehicle do not count), that the ledger admits commands
  (`Aerie.Control.Ledger.problem/1`), and that no link, no endpoint for clients and no session of a vehicle drops what
  comes faster than it takes it (what the gateway shows would be incomplete). Links that are down are listed but do not
  make it unready, because a gateway that waits for a radio to return does its work. Nor do an audit log that cannot be
  written (the gateway then refuses commands, and shows everything), a policy that could not be loaded again (the old
  one is in force), and a leaf node's hub that is away or stores nothing (events are stored aboard).
  """

  alias Aerie.Base.{Names, Store}
  alias MavRouter.{Client, Identity}

  @parts [store: :store, vehicles: :vehicles]

  @doc "Returns `{ready?, report}`; the report is a map for JSON."
  @spec ready(Names.gateway()) :: {boolean(), map()}
  def ready(gateway) do
    parts = for {name, role} <- @parts, into: %{}, do: {name, Names.whereis(gateway, role) != nil}
    nats = Aerie.Fleet.Bridge.info(gateway)
    problem = nats_problem(gateway, nats)
    identity = MavRouter.Router.identity(gateway)
    links = for link <- Store.links(gateway), do: link(link)
    clients = for client <- Client.endpoints(gateway), do: link(client)

    problems =
      silent(gateway) ++
        ledger(Aerie.Control.Ledger.problem(gateway)) ++
        starting(Store.starting?(gateway)) ++
        Enum.flat_map(links, &overloaded(&1, "link")) ++
        Enum.flat_map(clients, &overloaded(&1, "client endpoint"))

    ready? =
      problem == nil and identity.alarm == nil and problems == [] and
        Enum.all?(parts, fn {_name, running?} -> running? end)

    {ready?,
     %{
       status: if(ready?, do: "ready", else: "not ready"),
       parts: parts,
       identity: identity,
       nats: %{
         connected: nats != nil and nats.connected,
         url: nats[:url],
         outbox: nats[:outbox][:events],
         stalled_s: nats[:outbox][:stalled_s],
         problem: problem || nats[:outbox][:problem],
         hub: hub(nats[:hub])
       },
       policy: %{problem: policy_problem(gateway)},
       audit: %{problem: Aerie.Control.Policy.Audit.failing(gateway)},
       links: links,
       problems: problems,
       vehicles: Store.vehicle_count(gateway)
     }}
  end

  @doc "Whether the processes that the gateway's own heartbeat needs answer, and which do not."
  @spec heartbeat(Names.gateway()) :: %{
          alive: boolean(),
          silent: [{atom(), term()}],
          deadman_ms: pos_integer() | nil
        }
  def heartbeat(gateway), do: Identity.status(gateway)

  # A process that has never answered counts as well: a gateway that has just started is not ready yet.
  defp silent(gateway) do
    for {role, nil} <- heartbeat(gateway).silent,
        do:
          "#{role} does not answer, so the gateway sends no heartbeat: if this lasts, restart it and keep its log"
  end

  defp starting(true), do: ["the gateway still starts: its code is loaded, which delays frames"]
  defp starting(false), do: []

  defp ledger(nil), do: []
  defp ledger(reason), do: ["no command is accepted, because the ledger fails: #{reason}"]

  # The hub of a leaf node; nil without one.
  defp hub(nil), do: nil

  defp hub(hub),
    do: %{
      connected: hub.status == :up,
      stores: hub[:stalled] == nil,
      waiting: hub.waiting,
      problem: hub.problem
    }

  # A policy that could not be loaded again: the old one is in force.
  defp policy_problem(gateway) do
    with %{problem: %{errors: lines}} <- Aerie.Control.Policy.Store.status(gateway),
         do: Enum.join(lines, "; "),
         else: (_none -> nil)
  end

  defp link(link),
    do: %{
      id: link.id,
      status: link.status,
      text: link.text,
      overload: dated(link[:overload]),
      behind: dated(link[:behind])
    }

  defp dated(nil), do: nil

  defp dated(%{since: since} = dropped),
    do: %{dropped | since: since |> DateTime.from_unix!(:microsecond) |> DateTime.to_iso8601()}

  defp overloaded(%{id: id, overload: overload, behind: behind}, kind) do
    datagrams =
      with %{datagrams: n, since: since} <- overload,
           do:
             "#{kind} #{id} dropped #{n} datagrams since #{since}, because they come faster than it reads them: " <>
               "give the gateway more CPU, or spread what sends them over more links"

    frames =
      with %{frames: n, since: since} <- behind,
           do:
             "#{kind} #{id} dropped #{n} frames since #{since}, because a vehicle's session does not keep up with them: " <>
               "give the gateway more CPU, or lower the stream rates"

    Enum.reject([datagrams, frames], &is_nil/1)
  end

  # The reason why events cannot be stored, or nil. A problem of the outbox is shown, but does not stop them.
  defp nats_problem(gateway, nil),
    do: if(not Aerie.Fleet.Bridge.off?(gateway), do: "the bridge to NATS does not run")

  defp nats_problem(_gateway, nats), do: nats.problem
end
