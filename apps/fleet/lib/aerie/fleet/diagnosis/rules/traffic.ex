defmodule Aerie.Fleet.Diagnosis.Rules.Traffic do
  @moduledoc "Rules for what the router counts: loops, overload, refusals, clients that do not keep up."

  @behaviour Aerie.Fleet.Diagnosis.Rules

  import Aerie.Fleet.Diagnosis.Rules, only: [grown: 3]

  alias Aerie.Fleet.Diagnosis.Condition
  alias MavRouter.Endpoints.Counters

  @impl true
  def names do
    [
      gateway_loop: "the gateway's own frames come back to it",
      overload: "frames arrive faster than the gateway handles them",
      peers_refused: "a link has reached its limit of peers",
      vehicles_refused: "the gateway has reached its limit of vehicles",
      commands_denied: "peers that may not command send commands",
      signing_refused: "frames are refused because they are not signed with the expected key",
      slow_client: "a client reads its frames too slowly"
    ]
  end

  @impl true
  def check(facts) do
    links = for link <- facts.links, condition <- link(link, facts), do: condition
    links ++ unread(facts) ++ clients(facts)
  end

  defp link(%{id: id} = link, facts) do
    n = &grown(facts, {:link, id}, &1)
    new = &Condition.new(&1, &2, {:link, id}, &3)

    Enum.concat([
      when_any(n.(:looped), fn looped ->
        new.(:gateway_loop, :warning,
          title: "the gateway's own frames come back on #{id}",
          evidence: ["#{looped} frames in #{facts.seconds} s with the ids #{ids(facts)}"],
          mend:
            "Routers forward each other's frames in a loop: remove one of the connections. If a second gateway has these ids, give it another mavlink.system_id."
        )
      end),
      overload(link, new, n, facts),
      when_any(n.(:peers_refused), fn refused ->
        new.(:peers_refused, :warning,
          title: "#{id} refuses peers",
          evidence: [
            "#{refused} datagrams or connections in #{facts.seconds} s; #{length(link.peers)} peers are known"
          ],
          mend:
            "If they are yours, raise limits.max_peers; otherwise keep strangers off the port (firewall, bind to one address)."
        )
      end),
      when_any(n.(:refused), fn refused ->
        new.(:vehicles_refused, :error,
          title: "the gateway has reached its limit of vehicles",
          evidence: [
            "#{refused} frames on #{id} in #{facts.seconds} s; #{length(facts.vehicles)} vehicles are known"
          ],
          mend: "Raise limits.max_vehicles, or find out who sends heartbeats with made-up ids."
        )
      end),
      when_any(n.(:denied), fn denied ->
        new.(:commands_denied, :notice,
          title: "commands on #{id} are refused",
          evidence: ["#{denied} commands in #{facts.seconds} s from peers that may not command"],
          mend:
            "Connect ground stations to a client endpoint. If one has to command over this link, configure gcs: allow for the link."
        )
      end),
      when_any(n.(:rejected), fn rejected ->
        new.(:signing_refused, :error,
          title: "frames on #{id} are refused: they are not signed with the expected key",
          evidence: ["#{rejected} frames in #{facts.seconds} s"],
          mend:
            "The vehicle has another key or none: enrol it again, or configure its key under signing. If nobody changed it, somebody may be forging frames."
        )
      end)
    ])
  end

  defp overload(%{overload: %{datagrams: datagrams}, id: id}, new, n, facts) do
    [
      new.(:overload, :error,
        title: "Link #{id} is overloaded: data lost",
        evidence: [
          "#{datagrams} datagrams since it began"
          | when_any(
              n.(:shed_new),
              &"#{&1} in #{facts.seconds} s from senders that were not heard before it; theirs go first"
            )
        ],
        mend: "Give the gateway more CPU, lower the stream rates, or spread the vehicles over several links."
      )
    ]
  end

  defp overload(%{id: id}, new, n, facts) do
    when_any(n.(:overload), fn frames ->
      new.(:overload, :warning,
        title: "A vehicle on #{id} sends too fast: data lost",
        evidence: ["#{frames} frames in #{facts.seconds} s were dropped"],
        mend: "Give the gateway more CPU, or lower the stream rates."
      )
    end)
  end

  # Frames of clients are read from a socket like those of vehicles.
  defp unread(facts) do
    for %{overload: %{datagrams: datagrams}, id: id} <- facts.clients do
      Condition.new(:overload, :error, {:client, id},
        title: "Endpoint #{id} is overloaded: data from clients lost",
        evidence: ["#{datagrams} datagrams since it began"],
        mend: "Give the gateway more CPU, or find out which client sends so much."
      )
    end
  end

  defp ids(%{identity: %{system: system, component: component}}), do: "#{system}/#{component}"

  defp clients(facts) do
    owners = for %{side: :client, owner: owner} <- facts.endpoints, uniq: true, do: owner

    for owner <- owners,
        counts = Map.get(facts.grown, {:endpoints, owner}, %{}),
        dropped = Counters.dropped(counts),
        dropped > 0 do
      Condition.new(:slow_client, :warning, {:client, owner},
        title: "#{owner} reads its frames too slowly",
        evidence: ["#{dropped} frames dropped in #{facts.seconds} s, #{Map.get(counts, :frames_out, 0)} sent"],
        mend: "Give it a rate limit or a filter (rules) or a faster connection, or disconnect it."
      )
    end
  end

  defp when_any(0, _fun), do: []
  defp when_any(n, fun), do: [fun.(n)]
end
