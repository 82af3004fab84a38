defmodule MavRouter.Link.Server.Reconnected do
  @moduledoc """
  Tells the vehicles of a link that it is connected again, so that their sessions request their streams: the vehicle may have
  been restarted, or be on another of its ports, which has other rates.
  """

  alias MavRouter.Link.Spec
  alias Aerie.Base.Names
  alias Aerie.Base.Store

  @doc "Sends `{:link_reconnected, link_id}` to the sessions of the vehicles that were heard on this link."
  @spec notify(Names.gateway(), Spec.t()) :: :ok
  def notify(gateway, %Spec{id: id, network: network}) do
    for %{network: ^network, links: links, key: key} <- Store.vehicles(gateway), id in links do
      with session when is_pid(session) <- Names.whereis(gateway, :session, key),
           do: send(session, {:link_reconnected, id})
    end

    :ok
  end
end
