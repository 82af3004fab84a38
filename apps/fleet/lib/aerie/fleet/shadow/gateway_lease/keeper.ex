defmodule Aerie.Fleet.Shadow.GatewayLease.Keeper do
  @moduledoc """
  Decides which gateway acts on a vehicle, by `Aerie.Fleet.Shadow.GatewayLease` and the bucket of leases: functions of
  the state of `Aerie.Fleet.Shadow.Documents.Server`, their only caller.
  """

  alias Aerie.Base.Store
  alias Aerie.Fleet.Bridge
  alias Aerie.Fleet.Shadow.{GatewayLease, Metrics}
  alias Aerie.Vehicle.Command.Refusal
  alias Aerie.Fleet.Shadow.Store.Buckets
  alias Aerie.Fleet.Shadow.GatewayLease.Numbers
  alias Aerie.Fleet.Shadow.Store.LeaseSeal

  require Logger

  @max_claims 50
  @log_ms 60_000
  @max_names 256

  @type state :: map()

  @doc "Handles a gateway's heartbeat."
  @spec peer(state(), String.t(), value :: binary(), seal :: String.t() | nil) :: state()
  def peer(%{lease: %{me: me}} = state, instance, value, seal) do
    case read(state, {:gateway, instance}, value, seal) do
      {:new, state} when instance != me -> heard(state, instance, value)
      {:refused, state} -> state
      {_own_or_known, state} -> state
    end
  end

  defp heard(state, instance, value) do
    {name, echo} = sign(value, state.lease.me)
    {alive?, numbers} = Numbers.alive(state.numbers, instance, echo, monotonic())
    state = %{state | numbers: numbers}

    if alive? do
      names = if map_size(state.names) > @max_names, do: %{}, else: state.names
      lease = GatewayLease.peer(state.lease, instance, monotonic())
      %{state | lease: lease, names: Map.put(names, instance, name)}
    else
      refused(state, {:gateway, instance}, "is old: it knows none of this gateway's last signs of life")
    end
  end

  defp sign(value, me) do
    case JSON.decode(value) do
      {:ok, %{"gateway" => name} = sign} when is_binary(name) and byte_size(name) <= 64 ->
        {name, with(%{^me => number} <- sign["seen"], do: number, else: (_none -> nil))}

      _unnamed ->
        {"unnamed", nil}
    end
  end

  # `:new`, `:same` as before, or `:refused`, which is counted.
  defp read(state, subject, value, seal) do
    case LeaseSeal.read(state.kept.keys, state.kept.environment, subject, value, seal) do
      {:ok, number} ->
        {age, numbers} = Numbers.seen(state.numbers, subject, number)
        state = %{state | numbers: numbers}

        if age == :old,
          do: {:refused, refused(state, subject, "is older than the known one")},
          else: {age, state}

      :unsealed ->
        {:refused,
         refused(state, subject, "has no seal: another program or an earlier version of Aerie wrote it")}

      :forged ->
        {:refused, refused(state, subject, "has a seal by another key (shadow.key, shadow.vehicle_key)")}
    end
  end

  defp refused(state, {kind, name}, why) do
    Metrics.count(state.gateway, :leases_refused)

    if Store.claim(state.gateway, {__MODULE__, :refused}, @log_ms) do
      what = if kind == :gateway, do: "the sign of life of the gateway", else: "the lease of"
      Logger.warning("shadow: #{what} #{inspect(name, printable_limit: 64)} in NATS is not heeded: it #{why}")
    end

    state
  end

  @doc "Handles the owner of a vehicle from the bucket, nil for nobody."
  @spec owner(state(), String.t(), String.t() | nil, seal :: String.t() | nil) :: state()
  def owner(state, vehicle, owner, seal) do
    case read(state, {:vehicle, vehicle}, owner || "", seal) do
      {:refused, state} when owner == nil and seal == nil -> removed(state, vehicle)
      {:refused, state} -> %{state | repairs: MapSet.put(state.repairs, vehicle)}
      {_new_or_same, state} -> owner(state, vehicle, owner)
    end
  end

  defp owner(state, vehicle, nil),
    do:
      %{state | lease: GatewayLease.owner(state.lease, vehicle, nil, monotonic())} |> claim() |> authorities()

  defp owner(state, vehicle, instance),
    do: authorities(%{state | lease: owned(state.lease, vehicle, instance, monotonic())})

  # This gateway knows its own vehicles from its claims; a notice from the bucket may be old.
  defp owned(%{me: me} = lease, vehicle, me, now),
    do:
      if(match?(%{^vehicle => ^me}, lease.owners),
        do: lease,
        else: GatewayLease.owner(lease, vehicle, nil, now)
      )

  defp owned(lease, vehicle, other, now), do: GatewayLease.owner(lease, vehicle, other, now)

  # A removal without a seal (by an operator, an earlier version, the server) ends no lease of a gateway that lives.
  defp removed(%{lease: %{me: me} = lease} = state, vehicle) do
    case lease.owners do
      %{^vehicle => ^me} -> %{state | repairs: MapSet.put(state.repairs, vehicle)}
      %{^vehicle => other} -> if lives?(lease, vehicle, other), do: state, else: owner(state, vehicle, nil)
      _none -> owner(state, vehicle, nil)
    end
  end

  defp lives?(lease, vehicle, other),
    do: not GatewayLease.aboard?(vehicle, other) and not GatewayLease.gone?(lease, other, monotonic())

  @doc """
  Writes this gateway's sign of life. On a server of its own it only reads while no other gateway is there and its last
  sign is still the last word in the bucket, because the signs would be most of what an idle companion writes to flash.
  """
  @spec renew(state()) :: {:ok | {:error, String.t()}, state()}
  def renew(state) do
    own_server? = state.settings.bridge.nats.mode == :embedded

    if own_server? and GatewayLease.alone?(state.lease, monotonic()) and last_word?(state),
      do: {:ok, state},
      else: sign(state)
  end

  defp last_word?(%{sign: nil}), do: false
  defp last_word?(%{sign: seal, conn: conn}), do: Buckets.last_seal(conn) == seal

  defp sign(%{kept: kept, lease: %{me: me}} = state) do
    {echo, numbers} = Numbers.echo(state.numbers)
    value = JSON.encode!(%{"gateway" => state.name, "seen" => echo})
    {[{_header, sign}] = seal, number, state} = seal(%{state | numbers: numbers}, {:gateway, me}, value)
    state = %{state | numbers: Numbers.sent(state.numbers, number, monotonic())}
    result = Buckets.renew(state.conn, kept.environment, me, value, seal)
    {result, %{state | sign: if(result == :ok, do: sign)}}
  end

  @doc "This gateway's sign of life, sent at `sent_at`, was confirmed."
  @spec renewed(state(), sent_at :: integer()) :: state()
  def renewed(%{lease: lease} = state, sent_at) do
    gap? = lease.renewed_at != nil and sent_at - lease.renewed_at >= lease.ttl_ms
    numbers = if gap?, do: Numbers.gap(state.numbers), else: state.numbers
    %{state | lease: GatewayLease.renewed(lease, sent_at), numbers: numbers}
  end

  defp seal(%{kept: kept} = state, subject, value) do
    {number, numbers} = Numbers.next(state.numbers, subject, System.os_time(:millisecond))
    seal = LeaseSeal.headers(kept.keys, kept.environment, subject, value, number)
    {seal, number, %{state | numbers: numbers}}
  end

  @doc "Writes what somebody overwrote or removed: our leases once more, and that we do not hold those that name us."
  @spec repair(state()) :: state()
  def repair(%{conn: nil} = state), do: state

  def repair(%{repairs: repairs} = state) do
    Enum.reduce(repairs, %{state | repairs: MapSet.new()}, fn vehicle, state ->
      case Buckets.owner(state.conn, state.kept.environment, vehicle) do
        {:ok, owner, _seal, revision} -> repair(state, vehicle, owner, revision)
        {:error, _next_time} -> %{state | repairs: MapSet.put(state.repairs, vehicle)}
      end
    end)
  end

  defp repair(%{lease: %{me: me}} = state, vehicle, owner, revision) do
    case state.lease.owners do
      %{^vehicle => ^me} -> own(state, vehicle, revision)
      _others when owner == me -> disown(state, vehicle, revision)
      _not_ours -> state
    end
  end

  @doc "Claims vehicles that are heard here and have no owner."
  @spec claim(state()) :: state()
  def claim(%{conn: nil} = state), do: state

  def claim(state) do
    state.lease |> GatewayLease.claims(monotonic()) |> Enum.take(@max_claims) |> Enum.reduce(state, &take/2)
  end

  # What no gateway of ours wrote, or what is old, does not keep it.
  defp take(vehicle, %{kept: kept, lease: %{me: me} = lease} = state) do
    with {:ok, owner, seal, revision} <- Buckets.owner(state.conn, kept.environment, vehicle) do
      {age, state} = if owner, do: read(state, {:vehicle, vehicle}, owner, seal), else: {:same, state}
      now = monotonic()

      if owner in [nil, me] or age == :refused or
           (not GatewayLease.aboard?(vehicle, owner) and GatewayLease.gone?(lease, owner, now)),
         do: own(state, vehicle, revision),
         else: %{state | lease: GatewayLease.owner(lease, vehicle, owner, now)}
    else
      {:error, _next_time} -> state
    end
  end

  defp own(%{kept: kept, lease: %{me: me}} = state, vehicle, revision) do
    {seal, _number, state} = seal(state, {:vehicle, vehicle}, me)

    case Buckets.own(state.conn, kept.environment, vehicle, me, seal, revision) do
      :ok -> %{state | lease: GatewayLease.owner(state.lease, vehicle, me, monotonic())}
      {:error, _next_time} -> state
    end
  end

  defp disown(%{kept: kept} = state, vehicle, revision) do
    {seal, _number, state} = seal(state, {:vehicle, vehicle}, "")
    :ok = Buckets.disown(state.conn, kept.environment, vehicle, seal, revision)
    state
  end

  @doc "Gives a vehicle up, so that another gateway need not wait for the lease to expire."
  @spec release(state(), String.t()) :: state()
  def release(%{lease: %{me: me}} = state, vehicle) do
    case Buckets.owner(state.conn, state.kept.environment, vehicle) do
      {:ok, ^me, _seal, revision} -> disown(state, vehicle, revision)
      _others -> state
    end
  end

  @doc "See `Aerie.Fleet.Shadow.GatewayLease.holder/3`."
  @spec holder(state(), String.t()) :: {:mine, until :: integer()} | {:other, String.t()} | :none
  def holder(state, vehicle), do: GatewayLease.holder(state.lease, vehicle, monotonic())

  @doc "Records who may act; loops read this before they act."
  @spec authorities(state()) :: state()
  def authorities(state) do
    # Nothing is known of a vehicle whose loop has not said yet whether it is heard.
    vehicles = for {vehicle, _heard?} <- state.contact, is_map_key(state.loops, vehicle), do: vehicle
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

  # The gateway that holds a vehicle, for commands (`Aerie.Control.Commands.Gateways`).
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
        if own_server? and state.conn == nil and GatewayLease.gone?(state.lease, id, now),
          do: :alone,
          else: {:other, Map.get(state.names, id, id)}

      :none ->
        unheld(state, vehicle, own_server?)
    end
  end

  # The other users of our own server are known once the lease was requested.
  defp unheld(state, vehicle, true) do
    if state.conn != nil and MapSet.member?(state.lease.wanted, vehicle),
      do: {:unknown, Refusal.text(:lease_asked_for)},
      else: :alone
  end

  defp unheld(%{conn: nil}, _vehicle, false), do: {:unknown, Refusal.text(:holder_without_nats)}

  defp unheld(state, vehicle, false) do
    if MapSet.member?(state.lease.wanted, vehicle),
      do: {:unknown, Refusal.text(:holder_not_known)},
      else: {:unknown, Refusal.text(:not_heard_here)}
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
