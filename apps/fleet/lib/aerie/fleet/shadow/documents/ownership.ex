defmodule Aerie.Fleet.Shadow.Documents.Ownership do
  @moduledoc """
  Decides which gateway acts on a vehicle, by `Aerie.Fleet.Shadow.Lease` and the bucket of leases: functions of the state of
  `Aerie.Fleet.Shadow.Documents.Server`, their only caller.
  """

  alias Aerie.Fleet.Bridge
  alias Aerie.Fleet.Shadow.{Buckets, Lease}

  @max_claims 50
  @max_names 256

  @type state :: map()

  @doc "Handles another gateway's heartbeat."
  @spec peer(state(), String.t(), value :: binary()) :: state()
  def peer(state, instance, value) do
    names = if map_size(state.names) > @max_names, do: %{}, else: state.names
    lease = Lease.peer(state.lease, instance, monotonic())
    %{state | lease: lease, names: Map.put(names, instance, peer_name(value))}
  end

  @doc "Handles the owner of a vehicle from the bucket, nil for nobody."
  @spec owner(state(), String.t(), String.t() | nil) :: state()
  def owner(state, vehicle, nil),
    do: %{state | lease: Lease.owner(state.lease, vehicle, nil, monotonic())} |> claim() |> authorities()

  def owner(state, vehicle, instance),
    do: authorities(%{state | lease: owned(state.lease, vehicle, instance, monotonic())})

  # This gateway knows its own vehicles from its claims; a notice from the bucket may be old.
  defp owned(%{me: me} = lease, vehicle, me, now),
    do: if(match?(%{^vehicle => ^me}, lease.owners), do: lease, else: Lease.owner(lease, vehicle, nil, now))

  defp owned(lease, vehicle, other, now), do: Lease.owner(lease, vehicle, other, now)

  defp peer_name(value) do
    case JSON.decode(value) do
      {:ok, %{"gateway" => name}} when is_binary(name) and byte_size(name) <= 64 -> name
      _unnamed -> "unnamed"
    end
  end

  @doc "Claims vehicles that are heard here and have no owner."
  @spec claim(state()) :: state()
  def claim(%{conn: nil} = state), do: state

  def claim(state) do
    state.lease |> Lease.claims(monotonic()) |> Enum.take(@max_claims) |> Enum.reduce(state, &take/2)
  end

  defp take(vehicle, %{lease: lease} = state) do
    now = monotonic()
    gone? = &(not Lease.aboard?(vehicle, &1) and Lease.gone?(lease, &1, now))

    case Buckets.claim(state.conn, state.kept.environment, vehicle, lease.me, gone?) do
      :mine -> %{state | lease: Lease.owner(lease, vehicle, lease.me, now)}
      {:other, id} -> %{state | lease: Lease.owner(lease, vehicle, id, now)}
      {:error, _next_time} -> state
    end
  end

  @doc "Gives a vehicle up, so that another gateway need not wait for the lease to expire."
  @spec release(state(), String.t()) :: :ok
  def release(state, vehicle) do
    Buckets.release(state.conn, state.kept.environment, vehicle, state.lease.me)
  end

  @doc "See `Aerie.Fleet.Shadow.Lease.holder/3`."
  @spec holder(state(), String.t()) :: {:mine, until :: integer()} | {:other, String.t()} | :none
  def holder(state, vehicle), do: Lease.holder(state.lease, vehicle, monotonic())

  @doc "Records who may act; loops read this before they act."
  @spec authorities(state()) :: state()
  def authorities(state) do
    vehicles = Map.keys(state.loops)
    rows = for vehicle <- vehicles, do: {{:authority, vehicle}, may_act(state, vehicle)}
    holders = for vehicle <- vehicles, do: {{:holder, vehicle}, held(state, vehicle)}
    :ets.insert(state.table, rows ++ holders)

    # Only the gateway that holds the vehicle answers requests over NATS.
    others =
      for {{:holder, vehicle}, holder} <- holders,
          holder != :alone and not match?({:mine, _until, _wall}, holder),
          into: MapSet.new(),
          do: vehicle

    unless state.kept.local?, do: Bridge.Commands.leave(state.gateway, :holder, others)
    state
  end

  # Who holds a vehicle, for commands (`Aerie.Fleet.Shadow.Ownership`).
  defp held(%{kept: %{local?: true}}, _vehicle), do: :alone
  defp held(%{conn: nil, settings: %{without_nats: :act}}, _vehicle), do: :alone

  defp held(state, vehicle) do
    now = monotonic()
    own_server? = state.settings.bridge.nats.mode == :embedded

    case holder(state, vehicle) do
      {:mine, until} ->
        if own_server?, do: :alone, else: {:mine, until, System.os_time(:millisecond) + until - now}

      {:other, id} ->
        # No gateway can renew its lease while this server is away.
        if own_server? and state.conn == nil and Lease.gone?(state.lease, id, now),
          do: :alone,
          else: {:other, Map.get(state.names, id, id)}

      :none ->
        unheld(state, vehicle, own_server?)
    end
  end

  # The other users of our own server are known once the lease was requested.
  defp unheld(state, vehicle, true) do
    if state.conn != nil and MapSet.member?(state.lease.wanted, vehicle),
      do: {:unknown, "the lease of the vehicle is being asked for"},
      else: :alone
  end

  defp unheld(%{conn: nil}, _vehicle, false),
    do:
      {:unknown,
       "NATS is away or has no room for the buckets, so another gateway may hold the vehicle (shadow.without_nats: act, for the only gateway that hears it)"}

  defp unheld(state, vehicle, false) do
    if MapSet.member?(state.lease.wanted, vehicle),
      do: {:unknown, "it is not known yet which gateway holds the vehicle"},
      else: {:unknown, "this gateway does not hear the vehicle, so it does not hold it"}
  end

  # nil, an atom, is greater than any number, and means without end.
  defp may_act(%{kept: %{local?: true}}, _vehicle), do: {:mine, nil}

  defp may_act(%{conn: nil, settings: %{without_nats: :act}}, _vehicle), do: {:mine, nil}

  defp may_act(state, vehicle) do
    case holder(state, vehicle) do
      {:other, id} ->
        {:other, Map.get(state.names, id, id)}

      {:mine, until} ->
        {:mine, until}

      :none when state.conn == nil ->
        {:held, "nats", "NATS is away, so it is not known whether another gateway acts (shadow.without_nats)"}

      :none ->
        {:held, "gateway", "it is not known yet which gateway acts on it"}
    end
  end

  defp monotonic, do: System.monotonic_time(:millisecond)
end
