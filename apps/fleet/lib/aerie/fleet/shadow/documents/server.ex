defmodule Aerie.Fleet.Shadow.Documents.Server do
  @moduledoc """
  Keeps the desired documents of `Aerie.Fleet.Shadow.Documents`: copies in memory and on disk of the documents in NATS
  (`Aerie.Fleet.Shadow.Documents.Desired`), and the lease by which one of several gateways acts
  (`Aerie.Fleet.Shadow.GatewayLease.Keeper`).

  The bucket is authoritative, with three exceptions: a document that no gateway with our key wrote, an older one than
  we know (Z5), and none at all. In the last two cases our copy is written back, so a deleted bucket is restored.
  """
  use GenServer

  alias Aerie.Base.Names
  alias Aerie.Fleet.{Bridge, Nats}
  alias Aerie.Fleet.Bridge.State.LastPublished
  alias Aerie.Fleet.Shadow.{GatewayLease, Settings}
  alias Aerie.Fleet.Shadow.Store.{Buckets, LocalStore}
  alias Aerie.Fleet.Shadow.Keys
  alias Aerie.Fleet.Shadow.Documents.Desired
  alias Aerie.Fleet.Shadow.GatewayLease.{Keeper, Numbers}
  alias Aerie.Fleet.Shadow.Store.LeaseSeal
  alias Aerie.Base.PubSub
  alias Aerie.Base.Timing.TokenBucket

  require Logger

  @rate_ms 100
  @burst 50
  @max_sources 1_000
  # How often the buckets are checked. A lease that cannot be renewed is a reason to do it at once.
  @look_ms 10_000

  @spec start_link(gateway: Names.gateway(), settings: Settings.t()) :: GenServer.on_start()
  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :shadow_documents))

  @impl GenServer
  def init(options) do
    Process.flag(:trap_exit, true)
    gateway = options[:gateway]
    %Settings{bridge: bridge} = settings = options[:settings]
    Process.set_label({:shadow_documents, gateway})
    Logger.metadata(gateway: inspect(gateway))
    dir = Path.expand(settings.dir)
    {folder, problem} = open(gateway, dir, settings.key)
    keys = %Keys{common: folder.key, former: settings.former_key, own: own(settings)}
    table = :ets.new(:shadow, [:set, :protected, read_concurrency: true])
    local? = bridge.nats.mode == :off

    kept = %{table: table, local?: local?, environment: bridge.environment, keys: keys, dir: dir}
    Names.put_value(gateway, :shadow_documents, kept)
    :ok = PubSub.subscribe(gateway, :bridge)

    me = LeaseSeal.name(folder.instance, keys)
    :ets.insert(table, {:instance, me})

    state = %{
      gateway: gateway,
      settings: settings,
      dir: dir,
      kept: kept,
      table: table,
      name: LastPublished.name(bridge.vehicle.identity),
      names: %{},
      lease: GatewayLease.new(me, settings.lease_ms),
      numbers: Numbers.new(me, settings.lease_ms),
      # The seal of this gateway's last sign of life.
      sign: nil,
      # Vehicles whose lease in the bucket is not what it should be.
      repairs: MapSet.new(),
      loops: %{},
      contact: %{},
      reports: %{},
      rates: %{},
      conn: nil,
      watchers: [],
      differs: [],
      looked_at: monotonic(),
      problem: nil
    }

    schedule(state)
    {:ok, state |> Desired.problem(problem) |> Keeper.authorities(), {:continue, :connect}}
  end

  defp own(%{vehicle_key: nil}), do: %{}
  defp own(%{vehicle_key: key, bridge: %{vehicle: %{identity: %{vehicle_id: id}}}}), do: %{id => key}

  defp open(gateway, dir, key) do
    case LocalStore.open(gateway, dir, key) do
      {:ok, folder} -> {folder, nil}
      {:error, why} -> {LocalStore.without_folder(key), why}
    end
  end

  defp schedule(%{settings: %{lease_ms: ttl}}), do: Process.send_after(self(), :renew, max(div(ttl, 3), 50))

  @impl GenServer
  def handle_continue(:connect, state), do: {:noreply, connect(state)}

  @impl GenServer
  def handle_call({:change, vehicle, fun}, _from, state) do
    state = Desired.load(state, vehicle)

    case fun.(Desired.known(state, vehicle)) do
      {:ok, document} -> {:reply, {:ok, document}, Desired.accept(state, document)}
      error -> {:reply, error, state}
    end
  end

  def handle_call({:rate, actor}, _from, state) do
    now = monotonic()
    rates = if map_size(state.rates) >= @max_sources, do: %{}, else: state.rates

    case TokenBucket.take(rates[actor], now, @rate_ms, @burst) do
      {:ok, full} -> {:reply, :ok, %{state | rates: Map.put(rates, actor, full)}}
      :none -> {:reply, :none, state}
    end
  end

  # The watchers call this and wait, so that a flood of writes waits in NATS.
  def handle_call({:kv, bucket, key, change, headers}, _from, state),
    do: {:reply, :ok, changed(bucket, key, change, headers, state)}

  # For vehicles that are not heard here only the tags are kept.
  def handle_call({:written, document}, _from, state) do
    if is_map_key(state.loops, document.vehicle),
      do: {:reply, :ok, Desired.accept(state, document)},
      else: {:reply, :ok, Desired.tagged(state, document)}
  end

  @impl GenServer
  def handle_cast({:join, vehicle, loop}, state) do
    Process.monitor(loop)
    state = Desired.load(%{state | loops: Map.put(state.loops, vehicle, loop)}, vehicle)
    send(loop, {:desired, Desired.known(state, vehicle)})
    # Which gateway may act is not known before the loop says whether the vehicle is heard.
    {:noreply, state}
  end

  def handle_cast({:heard, vehicle, heard?}, state) do
    lease = GatewayLease.want(state.lease, vehicle, heard?)
    state = %{state | lease: lease, contact: Map.put(state.contact, vehicle, heard?)}

    {:noreply, if(heard?, do: state |> Keeper.claim() |> Keeper.authorities(), else: give_up(state, vehicle))}
  end

  def handle_cast({:report, vehicle, fields, reported}, state) do
    :ets.insert(state.table, {{:reported, vehicle}, {fields, reported}})
    {:noreply, publish(%{state | reports: Map.put(state.reports, vehicle, reported)}, vehicle)}
  end

  @impl GenServer
  def handle_info(:renew, state) do
    schedule(state)
    state = state |> connect() |> renew() |> Keeper.repair() |> Keeper.claim()
    {:noreply, Keeper.authorities(state)}
  end

  def handle_info({:fleet, :bridge, {:connection, _info}}, state), do: {:noreply, connect(state)}

  def handle_info({:DOWN, _ref, :process, loop, _reason}, state) do
    case Enum.find(state.loops, &match?({_vehicle, ^loop}, &1)) do
      {vehicle, ^loop} -> {:noreply, left(state, vehicle)}
      nil -> {:noreply, state}
    end
  end

  # A watcher ends with its connection.
  def handle_info({:EXIT, watcher, _reason}, state) do
    if watcher in state.watchers, do: {:noreply, disconnected(state)}, else: {:noreply, state}
  end

  def handle_info(_late, state), do: {:noreply, state}

  @impl GenServer
  def terminate(_reason, %{conn: conn} = state) when conn != nil do
    for vehicle <- state.lease.wanted,
        match?({:mine, _until}, Keeper.holder(state, vehicle)),
        do: Keeper.release(state, vehicle)
  end

  def terminate(_reason, _state), do: :ok

  ## The connection

  defp connect(%{kept: %{local?: true}} = state), do: state

  defp connect(state) do
    conn = Bridge.connection(state.gateway)

    cond do
      conn == nil -> state |> disconnected() |> Keeper.authorities()
      conn == state.conn and length(state.watchers) == 2 -> state
      true -> begin(disconnected(state), conn)
    end
  end

  defp disconnected(state) do
    Enum.each(state.watchers, &Process.exit(&1, :kill))
    Desired.away(%{state | conn: nil, watchers: [], sign: nil})
  end

  defp begin(state, conn) do
    with {:ok, _made, state} <- buckets(state, conn),
         {:ok, watchers} <- watch(conn, [Buckets.desired(), Buckets.leases()], []) do
      %{state | conn: conn, watchers: watchers}
      |> Desired.problem(nil)
      |> all()
      |> renew()
      |> Keeper.claim()
      |> Keeper.authorities()
    else
      {:error, why} -> Desired.problem(state, Nats.text(why))
    end
  end

  # Synchronises everything in both directions.
  defp all(state) do
    state = Enum.reduce(Map.keys(state.loops), state, &Desired.load(&2, &1))
    Enum.reduce(Map.keys(state.reports), state, &publish(&2, &1))
  end

  defp buckets(state, conn) do
    with {:ok, %{made: made, differs: differs}} <-
           Buckets.ensure(conn, state.settings.bridge, state.settings.buckets) do
      for text <- differs -- state.differs, do: Logger.warning("shadow: the bucket #{text}")
      state = if Buckets.leases() in made, do: %{state | lease: GatewayLease.forget(state.lease)}, else: state
      {:ok, made, %{state | differs: differs, looked_at: monotonic()}}
    end
  end

  # All of them or none: a watcher that nobody knows would go on until the connection ends.
  defp watch(_conn, [], watchers), do: {:ok, watchers}

  defp watch(conn, [bucket | others], watchers) do
    documents = self()
    call = fn message -> GenServer.call(documents, message, :infinity) end
    changed = fn key, change, headers -> call.({:kv, bucket, key, change, headers}) end

    case Nats.KV.watch(conn, bucket, changed) do
      {:ok, watcher} ->
        watch(conn, others, [watcher | watchers])

      error ->
        Enum.each(watchers, &Process.exit(&1, :kill))
        error
    end
  end

  ## Changes in the buckets

  defp changed("fleet_desired", key, change, _headers, state) do
    case Buckets.vehicle(key, state.kept.environment) do
      nil -> state
      vehicle -> Desired.changed(state, vehicle, change)
    end
  end

  defp changed("fleet_leases", key, change, headers, state) do
    seal = headers[String.downcase(LeaseSeal.header())]

    case {Buckets.lease(key, state.kept.environment), change} do
      {{:gateway, instance}, {:put, value}} -> Keeper.peer(state, instance, value, seal)
      {{:vehicle, vehicle}, {:put, value}} -> Keeper.owner(state, vehicle, value, seal)
      {{:vehicle, vehicle}, :removed} -> Keeper.owner(state, vehicle, nil, seal)
      _other -> state
    end
  end

  ## The gateway that acts

  defp renew(%{conn: nil} = state), do: state

  defp renew(%{looked_at: looked_at} = state) do
    sent_at = monotonic()
    {renewed, state} = if sent_at - looked_at < @look_ms, do: Keeper.renew(state), else: {:look, state}
    if renewed == :ok, do: Keeper.renewed(state, sent_at), else: look(state)
  end

  # Somebody may have deleted a bucket.
  defp look(state) do
    sent_at = monotonic()

    with {:ok, made, state} <- buckets(state, state.conn),
         {:ok, state} <- Keeper.renew(state) do
      state = Keeper.renewed(state, sent_at)
      if made == [], do: state, else: all(state)
    else
      {{:error, why}, state} -> Desired.problem(disconnected(state), why)
      {:error, why} -> Desired.problem(disconnected(state), why)
    end
  end

  defp left(state, vehicle) do
    lease = GatewayLease.want(state.lease, vehicle, false)
    state = give_up(%{state | lease: lease}, vehicle)
    for what <- [:document, :reported, :authority, :holder], do: :ets.delete(state.table, {what, vehicle})

    [:loops, :contact, :reports]
    |> Enum.reduce(state, fn part, state -> Map.update!(state, part, &Map.delete(&1, vehicle)) end)
  end

  defp give_up(state, vehicle) do
    held? = state.conn != nil and match?({:mine, _until}, Keeper.holder(state, vehicle))
    state = if held?, do: Keeper.release(state, vehicle), else: state
    Keeper.authorities(%{state | lease: GatewayLease.owner(state.lease, vehicle, nil, monotonic())})
  end

  # The owner of a vehicle reports it; if the owner is not known, every gateway that hears it does.
  defp publish(%{conn: nil} = state, _vehicle), do: state

  defp publish(state, vehicle) do
    # A report that is lost with the connection is published with the next one.
    _ =
      unless match?({:other, _id}, Keeper.holder(state, vehicle)),
        do: Buckets.report(state.conn, state.kept.environment, vehicle, state.reports[vehicle])

    state
  end

  defp monotonic, do: System.monotonic_time(:millisecond)
end
