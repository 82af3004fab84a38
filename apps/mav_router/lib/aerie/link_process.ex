defmodule Aerie.LinkProcess do
  @moduledoc """
  What the parts below links ask of a link's process, which they know by its name only. Nothing here waits.
  """

  alias Aerie.Names

  @typedoc "One peer of the link, or every peer."
  @type to :: {:peer, term} | :all

  @doc "Has whole frames written, or bytes marked by `Aerie.Signing.mark/3`; see `Aerie.Link.send_bytes/4`."
  @spec write(Names.gateway(), String.t(), iodata | Aerie.Signing.marked(), to) :: :ok | {:error, :no_link}
  def write(gateway, link, bytes, to) do
    case Names.whereis(gateway, :link, link) do
      nil -> {:error, :no_link}
      pid -> GenServer.cast(pid, {:send, to, bytes})
    end
  end

  @doc """
  Has a heartbeat, if there are any of ours, and a TIMESYNC request said to a peer of a link, signed with the key of a scope;
  `system` is what is heard there, for a gateway that does not know its own yet (`Aerie.Link.Announcer`).
  """
  @spec announce(Names.gateway(), String.t(), peer :: term, Aerie.Signing.Scope.t(), non_neg_integer) :: :ok
  def announce(gateway, link, peer, scope, system),
    do: GenServer.cast(Names.via(gateway, :link_announcer), {:speak, link, peer, scope, system})
end
