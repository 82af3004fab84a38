defmodule Aerie.Router.Endpoint do
  @moduledoc """
  Anything that frames come from or go to, as one end: a peer of a link, a peer or a connection of a client endpoint, a
  WebSocket. Each is an endpoint of its own (`key` is `{owner, peer}`); the rules (`Aerie.Router.Owner`) belong to its
  owner, the link or client that it is a peer of.

  ## An endpoint of your own

      {:ok, endpoint} = Aerie.Router.Endpoint.attach(gateway, id: "ws-7", text: "10.0.0.9:51234", side: :client)

      # what the other end says
      Aerie.Router.Endpoint.ingress(endpoint, frames)

      # what goes to it
      receive do
        {:forward, bytes, class} ->
          Aerie.Router.Endpoint.taken(endpoint, length(bytes))
          write(bytes)
      end

  `bytes` is a list of whole frames as they were received, of one class (`Aerie.Router.Classify`); one message for each
  read at most, mostly. Until `taken/2` is told, frames count as waiting: at #{4_096} of them further ones are dropped and counted.
  A process that cannot write at once keeps them in an `Aerie.Router.Outlet` (or a `Queue`), which drops the oldest of the
  least important class; a new connection is a new endpoint, so that nothing old waits for it. The endpoint is gone with
  its process, or with `detach/1`.
  """

  alias Aerie.Names
  alias Aerie.Router.Asked
  alias Aerie.Router.Endpoints
  alias Aerie.Router.Owner
  alias Aerie.Router.Rules
  alias Aerie.Router.Tables
  alias Aerie.Router.Tally

  @max_waiting 4_096
  # As much of a transfer as `Aerie.Router.Asked` has room for, in small frames.
  @max_asked 65_536

  @enforce_keys [:key, :gateway]
  defstruct [
    :key,
    :gateway,
    :text,
    :kind,
    :side,
    :out,
    :tally,
    :waiting,
    :pid,
    :since,
    heard_vehicle: false,
    listens: true,
    high_latency: false
  ]

  @typedoc """
  - `side`: nil where it is its owner's; a ground station on a link to vehicles is a `:client`
  - `out`: `{:udp, socket, address}` (written to directly by whoever forwards) or `{:pid, pid, tag}`, which gets
    `{:forward, bytes, class}`, or `{:forward, tag, bytes, class}` when the tag is not nil
  - `waiting`: frames in the mailbox of that process, and until when (monotonic ms) it is in a transfer that it asked for
  - `since`: unix microseconds
  - `listens`: whether it gets broadcasts though it is no vehicle's (`Aerie.Router.Endpoints.listens?/3`)
  - `high_latency`: summaries of vehicles come by it and no heartbeats (X6)
  """
  @type t :: %__MODULE__{
          key: key,
          gateway: Names.gateway(),
          text: String.t() | nil,
          kind: atom,
          side: :vehicle | :client | nil,
          out: out,
          tally: Tally.t(),
          waiting: :atomics.atomics_ref(),
          pid: pid | nil,
          since: integer,
          heard_vehicle: boolean,
          listens: boolean,
          high_latency: boolean
        }
  @type key :: {owner :: String.t(), peer :: term}
  @type out :: {:udp, :socket.socket(), map} | {:pid, pid, term} | nil

  @doc "How many frames may wait in the mailbox of an endpoint's process."
  @spec max_waiting() :: pos_integer
  def max_waiting, do: @max_waiting

  @doc """
  Whether a frame of a class has room in the mailbox of an endpoint's process when so many wait: an answer to what the
  endpoint asked for (`asked/2`) when others have none any more.
  """
  @spec room?(:atomics.atomics_ref(), Aerie.Router.Classify.class(), integer) :: boolean
  def room?(_waiting, _class, n) when n <= @max_waiting, do: true

  def room?(waiting, class, n) when class in [:transfer, :bulk] and n <= @max_asked,
    do: :atomics.get(waiting, 2) > clock(System.monotonic_time(:millisecond))

  def room?(_waiting, _class, _n), do: false

  @doc "The endpoint asked a vehicle for something, or gets what it asked for: at monotonic ms."
  @spec asked(t, integer) :: :ok
  def asked(%__MODULE__{waiting: waiting}, now), do: :atomics.put(waiting, 2, clock(now) + Asked.lasts_ms())

  # Above 0, which is never.
  defp clock(now),
    do: now - :erlang.convert_time_unit(:erlang.system_info(:start_time), :native, :millisecond)

  @doc "An endpoint of the calling process that is not known to anyone yet."
  @spec new(Names.gateway(), key, keyword) :: t
  def new(gateway, key, fields) do
    fields = [gateway: gateway, key: key, pid: self(), since: System.os_time(:microsecond)] ++ fields
    struct!(%__MODULE__{key: key, gateway: gateway, tally: Tally.new(), waiting: :atomics.new(2, [])}, fields)
  end

  @doc """
  Makes the calling process an endpoint.

  Options: `:id` (required; of its owner, unique among links and clients), `:text` (who is at the other end, for people),
  `:kind` (an atom, for people: `:websocket`) and those of `Aerie.Router.Owner`, of which `:side` is `:client` unless said.
  """
  @spec attach(Names.gateway(), keyword) :: {:ok, t} | {:error, String.t() | :not_running}
  def attach(gateway, options) do
    {own, rules} = Keyword.split(options, [:id, :text, :kind])
    id = Keyword.fetch!(own, :id)

    with tables when is_map(tables) <- Tables.of(gateway),
         {:ok, owner} <- Owner.new(id, Keyword.put_new(rules, :side, :client)),
         owner = Rules.restore(gateway, owner),
         endpoint = new(gateway, {id, :self}, [out: {:pid, self(), nil}] ++ Keyword.delete(own, :id)),
         :ok <- Endpoints.attach(gateway, tables, owner, endpoint) do
      {:ok, endpoint}
    else
      nil -> {:error, :not_running}
      {:error, words} -> {:error, words}
    end
  end

  @doc "Frames that the other end said; as `Aerie.Router.deliver/3`."
  @spec ingress(t, [MavCodec.Frame.t()]) :: Aerie.Router.outcome()
  def ingress(%__MODULE__{key: {owner, peer}} = endpoint, frames) do
    Aerie.Router.deliver(endpoint.gateway, %{id: owner, network: nil, peer: peer}, frames)
  end

  @doc "Tells that so many frames left the mailbox."
  @spec taken(t, pos_integer) :: :ok
  def taken(%__MODULE__{waiting: waiting}, n), do: :atomics.sub(waiting, 1, n)

  @doc "Counts frames that the endpoint's process had to drop, as `Aerie.Router.Queue` gives them."
  @spec dropped(t, Aerie.Router.Queue.dropped()) :: :ok
  def dropped(%__MODULE__{tally: tally}, dropped) do
    Enum.each(dropped, fn {class, n} -> Tally.dropped(tally, class, n) end)
  end

  @doc "Ends an endpoint made by `attach/2`."
  @spec detach(t) :: :ok
  def detach(%__MODULE__{key: {owner, _peer}, gateway: gateway}) do
    with tables when is_map(tables) <- Tables.of(gateway), do: Endpoints.close(gateway, tables, owner)
    :ok
  end
end
