defmodule MavRouter.Link.Server.Writer do
  @moduledoc """
  Writes to a link's peers, in the process of the link (`MavRouter.Link.Server`, whose state it takes and returns): signs, writes,
  records and counts. What cannot be written is dropped and counted as `dropped_out`.
  """

  alias MavRouter.Link.Core
  alias MavRouter.Link.Core.Counters
  alias MavRouter.Link.Server.Egress
  alias MavRouter.Link.Spec
  alias MavRouter.Recorder
  alias MavRouter.Signing
  alias Aerie.Base.Store

  @typedoc "What this module needs of the state of the link's process."
  @type state :: %{
          :gateway => Aerie.Base.Names.gateway(),
          :spec => Spec.t(),
          :home => module,
          :transport => module,
          :core => Core.t(),
          :conn => term,
          :egress => Egress.t(),
          optional(atom) => term
        }

  @doc "Writes bytes of our own, or marked ones (`MavRouter.Signing.mark/3`), to a peer or to all."
  @spec send(state, MavRouter.LinkProcess.to(), iodata | Signing.marked()) :: state
  def send(%{conn: nil} = state, _to, _bytes), do: dropped(state)
  def send(state, {:peer, peer}, bytes), do: send_to(state, peer, bytes)

  def send(state, :all, bytes),
    do: Enum.reduce(Map.keys(state.core.peers.map), state, &send_to(&2, &1, bytes))

  defp send_to(state, peer, given) do
    bytes = Signing.sign(state.gateway, state.spec.id, peer, given)

    case state.transport.write(state.conn, peer, bytes) do
      {:ok, conn} -> written(%{state | conn: conn}, Signing.without_key(given, bytes), true)
      {:busy, conn} -> dropped(%{state | conn: conn})
      {:error, _reason, conn} -> dropped(%{state | conn: conn})
    end
  end

  @doc "Writes forwarded bytes to a peer, for `MavRouter.Link.Server.Egress`, which keeps what is `:busy`."
  @spec forward(state, term, iodata) :: {:ok | :busy | :error, state}
  def forward(%{conn: nil} = state, _peer, _bytes), do: {:error, dropped(state)}

  def forward(state, peer, bytes) do
    bytes = Signing.fill(state.gateway, state.spec, peer, bytes)

    case state.transport.write(state.conn, peer, bytes) do
      # For a peer that senders write to directly, they count.
      {:ok, conn} -> {:ok, written(%{state | conn: conn}, bytes, not Egress.direct?(state.egress, peer))}
      {:busy, conn} -> {:busy, %{state | conn: conn}}
      {:error, _reason, conn} -> {:error, dropped(%{state | conn: conn})}
    end
  end

  defp written(state, bytes, count?) do
    if state.home == Store, do: Recorder.sent(state.gateway, state.spec.id, state.spec.network, bytes)
    if count?, do: state |> count(:bytes_out, IO.iodata_length(bytes)) |> count(:writes_out, 1), else: state
  end

  defp dropped(state), do: count(state, :dropped_out, 1)

  defp count(state, name, n), do: put_in(state.core.counters, Counters.add(state.core.counters, name, n))
end
