defmodule Aerie.Fleet.Bridge.Hub.Report do
  @moduledoc "What a person has to do after `aerie nats-setup`: what to copy where, and what to restart. Pure."

  alias Aerie.Fleet.Bridge.Hub.Members

  @doc "What is to be done with the files, as lines for a person."
  @spec lines(Path.t(), Members.t(), Members.changes()) :: [String.t()]
  def lines(dir, fleet, changes) do
    made = for name <- Enum.sort(changes.made), do: made(dir, name, Members.place(fleet, name))
    there = changes.vehicles -- changes.made

    lines =
      made ++
        for(
          name <- changes.revoked,
          do: "#{name}: its key opens nothing any more, once the servers have done what is below"
        ) ++
        aboard(dir, there, changes) ++ servers(dir, fleet, changes)

    if lines == [], do: ["nothing has changed: all keys are there, and everyone has them"], else: lines
  end

  defp made(dir, name, {:vehicle, _id}),
    do: "#{name}: copy #{Path.join([dir, "vehicles", name])} to the vehicle"

  defp made(dir, name, place) do
    folder = if place == :hub, do: Path.join(dir, "hub"), else: Path.join([dir, "hubs", name])
    "#{name}: its key is new; copy gateway.yaml, gateway.nk and ca.pem of #{folder} to its gateway"
  end

  defp aboard(_dir, [], _changes), do: []

  defp aboard(dir, there, changes) do
    what =
      for {true, text} <- [
            {changes.sources?, "policy.sources, which lists the keys of the hubs"},
            {changes.hosts?, "nats.leaf.url, which names the hub's servers"}
          ],
          do: text

    [
      "#{Enum.join(there, ", ")}: bring aboard what is new in #{Path.join([dir, "vehicles", "ID", "gateway.yaml"])} (#{Enum.join(what, "; ")}); " <>
        "until then #{if changes.sources?, do: "a hub with a new key shows the vehicle, and commands nothing there", else: "the vehicle knows the former servers only"}"
    ]
  end

  defp servers(_dir, _fleet, %{servers: :none}), do: []

  defp servers(dir, fleet, changes) do
    copy =
      for host <- fleet["hosts"],
          do: "#{host}: copy #{Path.join([dir, "hub", host])} to this server of the hub"

    copy ++
      pair(fleet["hosts"]) ++
      clustered(changes) ++
      case changes.servers do
        :first ->
          ["start each server in the folder of its files: nats-server -c hub.conf"]

        :restart ->
          ["then restart nats-server, one server after the other; for a new account a reload is not enough"]

        :reload ->
          ["then let each server read accounts.conf: nats-server --signal reload=nats-server.pid"]
      end
  end

  defp clustered(%{clustered?: true}),
    do: ["the cluster does not have what a server stored alone; docs/fleet.md says what that means"]

  defp clustered(_changes), do: []

  defp pair([_one, _other]), do: ["two servers store nothing while one of them is away: take one, or three"]
  defp pair(_hosts), do: []
end
