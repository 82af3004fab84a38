defmodule Aerie.Fleet.Shadow.GatewayLease do
  @moduledoc """
  Decides which of several gateways that hear a vehicle acts on it. A pure value; `Aerie.Fleet.Shadow.Documents` reads and writes the bucket.

  Each gateway renews one heartbeat, however many vehicles it has. A gateway that is alone (`alone?/2`) need not
  write while nobody else writes: another one writes before it acts, and gives those it finds the full time from
  then on. Each vehicle has an owner, written with compare-and-set. An owner acts only within `ttl_ms` of its last
  confirmed renewal, counted from when it was sent; another gateway takes over when it has seen no renewal for one
  and a half times `ttl_ms`. Each counts by its own monotonic clock, so clocks need not agree, and no two act at
  once.

  Times are milliseconds.
  """

  @enforce_keys [:me, :ttl_ms]
  defstruct [:me, :ttl_ms, :renewed_at, peers: %{}, owners: %{}, wanted: MapSet.new()]

  @typedoc """
    * `:peers` - when each gateway's last renewal was seen
    * `:owners` - the gateway that owns each vehicle, if known
    * `:wanted` - the vehicles that this gateway hears
  """
  @type t :: %__MODULE__{
          me: String.t(),
          ttl_ms: pos_integer(),
          renewed_at: integer() | nil,
          peers: %{String.t() => integer()},
          owners: %{String.t() => String.t()},
          wanted: MapSet.t(String.t())
        }

  @max_peers 256
  # Twice as long as a write may be on its way.
  @lone_ttl_ms 4_000

  @spec new(me :: String.t(), ttl_ms :: pos_integer()) :: t()
  def new(me, ttl_ms), do: %__MODULE__{me: me, ttl_ms: ttl_ms}

  @doc "Sets whether this gateway hears a vehicle. If not, it gives the vehicle up, which the caller writes."
  @spec want(t(), String.t(), boolean()) :: t()
  def want(lease, vehicle, true), do: %{lease | wanted: MapSet.put(lease.wanted, vehicle)}
  def want(lease, vehicle, false), do: %{lease | wanted: MapSet.delete(lease.wanted, vehicle)}

  @doc "Records another gateway's heartbeat. Beyond a limit some gateways are forgotten, and count as new when they are seen again."
  @spec peer(t(), String.t(), now :: integer()) :: t()
  def peer(lease, id, now) do
    peers = if map_size(lease.peers) >= @max_peers, do: %{}, else: lease.peers
    %{lease | peers: Map.put(peers, id, now)}
  end

  @doc "Sets a vehicle's owner from the bucket, nil for none."
  @spec owner(t(), String.t(), String.t() | nil, now :: integer()) :: t()
  def owner(lease, vehicle, nil, _now), do: %{lease | owners: Map.delete(lease.owners, vehicle)}

  def owner(lease, vehicle, id, now) do
    # It is unknown how long a gateway that was never seen to renew has been gone, so it gets the full time.
    peers = if id == lease.me, do: lease.peers, else: Map.put_new(lease.peers, id, now)

    if MapSet.member?(lease.wanted, vehicle) or id == lease.me,
      do: %{lease | owners: Map.put(lease.owners, vehicle, id), peers: peers},
      else: %{lease | owners: Map.delete(lease.owners, vehicle)}
  end

  @doc """
  Records that this gateway's renewal, sent at `sent_at`, was confirmed. After a gap in which others may have taken over, it owns nothing
  until the bucket says so again.
  """
  @spec renewed(t(), sent_at :: integer()) :: t()
  def renewed(lease, sent_at) do
    if lease.renewed_at == nil or sent_at - lease.renewed_at >= lease.ttl_ms,
      do: %{after_gap(lease, sent_at) | renewed_at: sent_at},
      else: %{lease | renewed_at: sent_at}
  end

  # The others' renewals were not seen during the gap either, so they get the full time again.
  defp after_gap(lease, now) do
    owners = Map.reject(lease.owners, fn {_vehicle, id} -> id == lease.me end)
    %{lease | owners: owners, peers: Map.new(lease.peers, fn {id, _seen} -> {id, now} end)}
  end

  @doc "The bucket was lost, and with it what it said of owners: this gateway owns nothing until it has claimed it again."
  @spec forget(t()) :: t()
  def forget(lease), do: %{lease | owners: %{}}

  @doc "The vehicles to claim: wanted, and without a living owner."
  @spec claims(t(), now :: integer()) :: [String.t()]
  def claims(lease, now) do
    if current?(lease, now),
      do: for(vehicle <- Enum.sort(lease.wanted), free?(lease, vehicle, now), do: vehicle),
      else: []
  end

  defp free?(lease, vehicle, now) do
    case lease.owners do
      %{^vehicle => me} when me == lease.me -> false
      %{^vehicle => other} -> not aboard?(vehicle, other) and gone?(lease, other, now)
      _none_known -> true
    end
  end

  @doc "Whether another gateway has not renewed for so long that its vehicles may be taken over."
  @spec gone?(t(), String.t(), now :: integer()) :: boolean()
  def gone?(lease, id, now) do
    case lease.peers do
      %{^id => seen} -> now - seen > div(lease.ttl_ms * 3, 2)
      _never_seen -> false
    end
  end

  @doc """
  Whether no other gateway has been seen for so long that none can act by what it saw before: after three times
  `ttl_ms` its own lease has ended. Not with leases so short that the first write of another one may take longer than half of them.
  """
  @spec alone?(t(), now :: integer()) :: boolean()
  def alone?(%{ttl_ms: ttl} = lease, now),
    do: ttl >= @lone_ttl_ms and Enum.all?(lease.peers, fn {_id, seen} -> now - seen > 3 * ttl end)

  @doc """
  Whether the owner is the gateway aboard the vehicle, whose leaf node says so at the hub (`Aerie.Fleet.Shadow.Documents.Uplink`). It goes on while it is cut
  off, so nobody takes its vehicle over.
  """
  @spec aboard?(vehicle :: String.t(), owner :: String.t()) :: boolean()
  def aboard?(vehicle, owner), do: owner == "gateway-" <> vehicle

  @doc "Until when this gateway may act on a vehicle: `{:mine, until}`, `{:other, id}`, or `:none` if nobody owns it yet."
  @spec holder(t(), String.t(), now :: integer()) ::
          {:mine, until :: integer()} | {:other, String.t()} | :none
  def holder(lease, vehicle, now) do
    case lease.owners do
      %{^vehicle => me} when me == lease.me ->
        if current?(lease, now), do: {:mine, lease.renewed_at + lease.ttl_ms}, else: :none

      %{^vehicle => other} ->
        {:other, other}

      _none ->
        :none
    end
  end

  defp current?(lease, now), do: lease.renewed_at != nil and now - lease.renewed_at < lease.ttl_ms
end
