defmodule MavRouter.Link.Core.Reads do
  @moduledoc "From what a transport read to deliveries for the router. Pure; every received byte goes through here."

  alias MavRouter.Link.Peers

  @typedoc "Frames of one peer, in order."
  @type delivery :: {peer :: term, [MavCodec.Frame.t()]}

  @doc """
  Parses reads that came at `mono` (monotonic ms) and `at` (unix microseconds). Reads of the same peer become one delivery;
  deliveries are in the order in which the peers spoke.
  """
  @spec push(Peers.t(), [{term, binary | [MavCodec.Frame.t()]}], integer, integer) ::
          {[delivery], [Peers.change()], Peers.t()}
  # Nearly always one datagram.
  def push(peers, [{id, bytes}], mono, at) do
    case Peers.push(peers, id, bytes, mono, at) do
      {[], changes, peers} -> {[], changes, peers}
      {frames, changes, peers} -> {[{id, frames}], changes, peers}
    end
  end

  def push(peers, reads, mono, at) do
    {peers, spoken, frames, changes} =
      Enum.reduce(reads, {peers, [], %{}, []}, fn {peer, bytes}, {peers, spoken, frames, changes} ->
        {new, change, peers} = Peers.push(peers, peer, bytes, mono, at)

        case frames do
          _any when new == [] -> {peers, spoken, frames, change ++ changes}
          %{^peer => before} -> {peers, spoken, %{frames | peer => [new | before]}, change ++ changes}
          _first -> {peers, [peer | spoken], Map.put(frames, peer, [new]), change ++ changes}
        end
      end)

    deliveries = for peer <- Enum.reverse(spoken), do: {peer, join(frames[peer])}
    {deliveries, Enum.reverse(changes), peers}
  end

  defp join([frames]), do: frames
  defp join(lists), do: lists |> Enum.reverse() |> Enum.concat()

  @doc """
  Parses the records of a recording, each with its own time (unix microseconds). A record is like a datagram: damage in one
  says nothing about the next.
  """
  @spec replay(Peers.t(), [{integer, binary}], integer) :: {[delivery], Peers.t()}
  def replay(peers, records, mono) do
    {frames, peers} =
      Enum.flat_map_reduce(records, peers, fn {recorded, bytes}, peers ->
        {frames, _changes, peers} = Peers.push(peers, :remote, bytes, mono, recorded)
        {frames, peers}
      end)

    {if(frames == [], do: [], else: [{:remote, frames}]), peers}
  end
end
