defmodule MavRouter.Link.Peers.Fragments do
  @moduledoc """
  Senders of datagrams that have sent no frame yet, but what may be the beginning of one: some programs cut their frames over several
  datagrams. A bounded value: the earliest make room for new ones, and each has a few seconds for its first frame.
  """

  alias MavRouter.Link.Peers.Peer

  @max 256
  @wait_ms 5_000

  @enforce_keys [:order]
  defstruct [:order, peers: %{}]

  @type t :: %__MODULE__{peers: %{term => Peer.t()}, order: :gb_sets.set({integer, term})}

  @doc "None."
  @spec new() :: t
  def new, do: %__MODULE__{order: :gb_sets.new()}

  @doc "The sender, which is kept no longer; nil if it is not kept."
  @spec take(t, term) :: {Peer.t() | nil, t}
  def take(%__MODULE__{peers: peers} = fragments, id) do
    case peers do
      %{^id => peer} ->
        order = :gb_sets.del_element({peer.since, id}, fragments.order)
        {peer, %{fragments | peers: Map.delete(peers, id), order: order}}

      _unknown ->
        {nil, fragments}
    end
  end

  @doc "Keeps a sender; returns those that have to go for it."
  @spec put(t, Peer.t()) :: {[Peer.t()], t}
  def put(%__MODULE__{peers: peers} = fragments, peer) do
    {gone, fragments} = if map_size(peers) < @max, do: {[], fragments}, else: earliest(fragments)
    order = :gb_sets.add_element({peer.since, peer.id}, fragments.order)
    {gone, %{fragments | peers: Map.put(fragments.peers, peer.id, peer), order: order}}
  end

  @doc "Those whose time is over."
  @spec expire(t, now :: integer) :: {[Peer.t()], t}
  def expire(fragments, now) do
    with false <- :gb_sets.is_empty(fragments.order),
         {since, _id} when now - since >= @wait_ms <- :gb_sets.smallest(fragments.order) do
      {[peer], fragments} = earliest(fragments)
      {more, fragments} = expire(fragments, now)
      {[peer | more], fragments}
    else
      _none_or_young -> {[], fragments}
    end
  end

  defp earliest(fragments) do
    {_since, id} = :gb_sets.smallest(fragments.order)
    {peer, fragments} = take(fragments, id)
    {[peer], fragments}
  end
end
