defmodule MavRouter.LinkProcess do
  @moduledoc """
  What parts on which links depend ask of a link's process, which they know only by name. Nothing here waits.
  """

  alias Aerie.Base.Names

  @typedoc "One peer of the link, or every peer."
  @type to :: {:peer, term} | :all

  @doc "Writes whole frames, or bytes marked by `MavRouter.Signing.mark/3`; see `MavRouter.Link.send_bytes/4`."
  @spec write(Names.gateway(), String.t(), iodata | MavRouter.Signing.marked(), to) ::
          :ok | {:error, :no_link}
  def write(gateway, link, bytes, to) do
    case Names.whereis(gateway, :link, link) do
      nil -> {:error, :no_link}
      pid -> GenServer.cast(pid, {:send, to, bytes})
    end
  end

  @doc """
  Sends our heartbeat, unless it is off, and a TIMESYNC request to a peer of a link, signed with the key of a scope.
  `system` is the system that is heard there: a gateway that does not have a system id yet sends as a part of it
  (`MavRouter.Link.Announcer`).
  """
  @spec announce(Names.gateway(), String.t(), peer :: term, MavRouter.Signing.Scope.t(), non_neg_integer) ::
          :ok
  def announce(gateway, link, peer, scope, system),
    do: GenServer.cast(Names.via(gateway, :link_announcer), {:speak, link, peer, scope, system})
end
