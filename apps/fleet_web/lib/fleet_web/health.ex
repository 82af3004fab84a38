defmodule FleetWeb.Health do
  @moduledoc """
  Is a gateway ready to do its work? Answered from the read model, part by part, so that a probe that fails says why.

  Ready means: the gateway's parts run and NATS is connected (or switched off by the configuration). Links that are down do not make it unready, because a
  gateway that waits for a radio to come back does its work; they are listed all the same.
  """

  alias Aerie.{Fleet, Names}

  @parts [store: :store, vehicles: :vehicles]

  @doc "`{ready?, report}`; the report is a map for JSON."
  @spec ready(Names.gateway()) :: {boolean(), map()}
  def ready(gateway) do
    parts = for {name, role} <- @parts, into: %{}, do: {name, Names.whereis(gateway, role) != nil}
    nats = Aerie.Bridge.info(gateway)
    connected? = nats != nil and nats.connected
    ready? = (connected? or nats_off?(gateway)) and Enum.all?(parts, fn {_name, running?} -> running? end)

    links =
      for link <- Fleet.Store.links(gateway),
          do: %{id: link.id, status: link.status, text: link.text}

    {ready?,
     %{
       status: if(ready?, do: "ready", else: "not ready"),
       parts: parts,
       nats: %{
         connected: connected?,
         url: nats[:url],
         outbox: nats[:outbox][:events],
         problem: nats[:outbox][:problem]
       },
       links: links,
       vehicles: length(Fleet.Store.vehicles(gateway))
     }}
  end

  defp nats_off?(gateway), do: match?(%{nats: %{mode: :off}}, Aerie.Gateway.config(gateway))
end
