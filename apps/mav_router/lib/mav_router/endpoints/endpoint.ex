defmodule MavRouter.Endpoints.Endpoint do
  @max_waiting 4_096
  # As much of a transfer as `MavRouter.Endpoints.Queue.RequestedData` has room for, in small frames.
  @max_requested 65_536

  @moduledoc """
  Anything that frames come from or go to: a peer of a link, a peer or a connection of a client, a WebSocket. Its key is
  `{owner, peer}`; the rules (`MavRouter.Endpoints.Owner`) are those of its owner, the link or client that it is a peer
  of.

  ## An endpoint of your own

      {:ok, endpoint} = MavRouter.Client.LocalEndpoint.attach(gateway, id: "ws-7", text: "10.0.0.9:51234", side:
      :client)

      # frames from the other end
      MavRouter.Client.LocalEndpoint.ingress(endpoint, frames)

      # frames to it
      receive do
        {:forward, bytes, class} ->
          MavRouter.Endpoints.Endpoint.taken(endpoint, length(bytes))
          write(bytes)
      end

  `bytes` is a list of whole frames as they were received, of one class (`MavRouter.Endpoints.Queue.TrafficClass`);
  usually at most one message for each read. Frames count as waiting until `taken/2` is called: at #{@max_waiting} of
  them further ones are dropped and counted. A process that cannot write at once keeps them in an
  `MavRouter.Endpoints.Queue.SendQueue`, which drops the oldest frames of the least important class. A new connection
  is a new endpoint, so that nothing old waits for it. The endpoint ends with its process or with
  `MavRouter.Client.LocalEndpoint.detach/1`.
  """

  alias Aerie.Base.Names
  alias MavRouter.Endpoints.Queue.RequestedData
  alias MavRouter.Endpoints.Counters

  @enforce_keys [:key, :gateway]
  defstruct [
    :key,
    :gateway,
    :text,
    :kind,
    :side,
    :out,
    :counters,
    :waiting,
    :pid,
    :since,
    :principal,
    heard_vehicle: false,
    listens: true,
    high_latency: false
  ]

  @typedoc """
  - `side`: nil where it is its owner's; a ground station on a link to vehicles is a `:client`
  - `out`: `{:udp, socket, address}` (the forwarding process writes to it directly) or `{:pid, pid, tag}`, which gets
    `{:forward, bytes, class}`, or `{:forward, tag, bytes, class}` when the tag is not nil
  - `waiting`: 1, frames in the mailbox of that process; 2, the end of a transfer that it requested (ms since the start of the
    virtual machine); 3, how many frames may wait there (`limit/2`)
  - `since`: unix microseconds
  - `principal`: who is at the other end, if that was proved by a key or by signing in
  - `listens`: it gets broadcasts although it is not a vehicle's (`MavRouter.Endpoints.listens?/3`)
  - `high_latency`: summaries of vehicles come by it and no heartbeats (X6)
  """
  @type t :: %__MODULE__{
          key: key,
          gateway: Names.gateway(),
          text: String.t() | nil,
          kind: atom,
          side: :vehicle | :client | nil,
          out: out,
          counters: Counters.t(),
          waiting: :atomics.atomics_ref(),
          pid: pid | nil,
          since: integer,
          principal: Aerie.Base.Principal.t() | nil,
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
  Whether a frame of a class has room in the mailbox of an endpoint's process when so many wait. Data that the endpoint
  requested (`requested/2`) has room when other frames have none any more, also while the endpoint takes nothing: a client
  that pauses while it writes to its disk must not have to ask for each lost piece.
  """
  @spec room?(:atomics.atomics_ref(), MavRouter.Endpoints.Queue.TrafficClass.class(), integer) :: boolean
  def room?(waiting, class, n) do
    n <= :atomics.get(waiting, 3) or requested?(waiting, class, n)
  end

  defp requested?(waiting, class, n) when class in [:transfer, :bulk] and n <= @max_requested,
    do: :atomics.get(waiting, 2) > clock(System.monotonic_time(:millisecond))

  defp requested?(_waiting, _class, _n), do: false

  @doc "From now on so many frames may wait in the mailbox beside requested data; 0 for an endpoint that takes nothing."
  @spec limit(t, non_neg_integer) :: :ok
  def limit(%__MODULE__{waiting: waiting}, n), do: :atomics.put(waiting, 3, min(n, @max_waiting))

  @doc "The endpoint requests data of a vehicle, or gets what it requested, at `now` (monotonic ms)."
  @spec requested(t, integer) :: :ok
  def requested(%__MODULE__{waiting: waiting}, now),
    do: :atomics.put(waiting, 2, clock(now) + RequestedData.lasts_ms())

  # Always above 0, which stands for never.
  defp clock(now),
    do: now - :erlang.convert_time_unit(:erlang.system_info(:start_time), :native, :millisecond)

  @doc "An endpoint of the calling process, not yet in the tables."
  @spec new(Names.gateway(), key, keyword) :: t
  def new(gateway, key, fields) do
    fields = [gateway: gateway, key: key, pid: self(), since: System.os_time(:microsecond)] ++ fields

    waiting = :atomics.new(3, [])
    :ok = :atomics.put(waiting, 3, @max_waiting)

    struct!(
      %__MODULE__{key: key, gateway: gateway, counters: Counters.new(), waiting: waiting},
      fields
    )
  end

  @doc "So many frames left the mailbox."
  @spec taken(t, pos_integer) :: :ok
  def taken(%__MODULE__{waiting: waiting}, n), do: :atomics.sub(waiting, 1, n)

  @doc "Counts frames that the endpoint's process dropped, as `MavRouter.Endpoints.Queue.ClassQueue` gives them."
  @spec dropped(t, MavRouter.Endpoints.Queue.ClassQueue.dropped()) :: :ok
  def dropped(%__MODULE__{counters: counters}, dropped) do
    Enum.each(dropped, fn {class, n} -> Counters.dropped(counters, class, n) end)
  end
end
