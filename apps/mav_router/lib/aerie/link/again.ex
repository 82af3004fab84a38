defmodule Aerie.Link.Again do
  @moduledoc """
  Tells the vehicles of a link that it is connected again, so that their sessions ask for the streams that they want: the
  vehicle may have been restarted meanwhile, or be on another of its ports, where other rates are set.
  """

  alias Aerie.Store
  alias Aerie.Link.Spec
  alias Aerie.Names

  @doc "Sends `{:link_again, link_id}` to the sessions of the vehicles that were heard on this link."
  @spec tell(Names.gateway(), Spec.t()) :: :ok
  def tell(gateway, %Spec{id: id, network: network}) do
    for %{network: ^network, links: links, key: key} <- Store.vehicles(gateway), id in links do
      with session when is_pid(session) <- Names.whereis(gateway, :session, key),
           do: send(session, {:link_again, id})
    end

    :ok
  end
end
