defmodule Aerie.Fleet.Shadow.Documents.Uplink do
  @moduledoc """
  On a leaf node: keeps the vehicle's documents in the hub's buckets and those aboard the same, over every cut.

  | what | way |
  |---|---|
  | the desired document | both ways; what was changed on both sides meanwhile is merged (`Aerie.Fleet.Shadow.Document.Merge`) |
  | the reported document | to the hub, the last value, at most once a second |
  | who acts on the vehicle | to the hub: `gateway-{vehicle}` while a gateway aboard does (`Aerie.Fleet.Shadow.GatewayLease.aboard?/2`) |

  What the hub desires needs the permissions that its commands would need aboard: those of the source `shadow.hub` of
  the policy there. Other changes are taken back at the hub, with the reason in the history.

  Both buckets are written with compare-and-set, the hub's first. The last document that both had is in `hub/` in the
  shadow's folder, so that a change is recognised after a restart.

  The value of its name is why the documents differ, or nil (`Aerie.Fleet.Shadow.Documents.problem/1`). It works for the
  vehicle of `vehicle_id`: the hub lets nobody read or write other keys.
  """
  use GenServer

  alias Aerie.Base.Files.Private
  alias Aerie.Base.Names
  alias Aerie.Fleet.Bridge
  alias Aerie.Fleet.Bridge.Connection.Subscriber
  alias Aerie.Fleet.Nats.KV
  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.Roles
  alias Aerie.Control.Policy.Roles.Sources

  alias Aerie.Fleet.Shadow.{Document, Documents, Metrics, Settings}
  alias Aerie.Fleet.Shadow.Document.{Field, Merge, Sealed}
  alias Aerie.Fleet.Shadow.Store.{HubBuckets, LocalStore}

  alias Aerie.Base.PubSub
  alias Aerie.Fleet.Shadow.Store.LeaseSeal

  require Logger

  @desired "fleet_desired"
  @reported "fleet_reported"
  @leases "fleet_leases"
  @tick_ms 1_000
  # A word of the hub may be lost.
  @look_ms 60_000
  @again_ms 5_000

  @doc "The vehicle for which a gateway needs this process; nil for none."
  @spec vehicle(Settings.t()) :: String.t() | nil
  def vehicle(%Settings{bridge: %{nats: %{leaf: %{url: [_ | _]}}, vehicle: %{identity: %{vehicle_id: id}}}}),
    do: id

  def vehicle(_no_leaf), do: nil

  @spec start_link(gateway: Names.gateway(), settings: Settings.t()) :: GenServer.on_start()
  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :shadow_uplink))

  @impl GenServer
  def init(gateway: gateway, settings: settings) do
    Process.set_label({:shadow_uplink, gateway})
    Logger.metadata(gateway: inspect(gateway))
    :ok = PubSub.subscribe(gateway, :bridge)
    vehicle = vehicle(settings)
    environment = settings.bridge.environment
    key = "#{environment}.#{vehicle}"

    state = %{
      gateway: gateway,
      environment: environment,
      vehicle: vehicle,
      key: key,
      lease: "#{environment}.vehicles.#{vehicle}",
      source: settings.hub,
      base: nil,
      conn: nil,
      hub: :down,
      # The change to bring to the hub; nil for none.
      desired?: true,
      reported: nil,
      owner: nil,
      looked_at: nil,
      again_at: nil
    }

    Process.send_after(self(), :tick, @tick_ms)
    {:ok, state, {:continue, :connect}}
  end

  @impl GenServer
  def handle_continue(:connect, state), do: {:noreply, connect(state)}

  @impl GenServer
  def handle_info({:msg, %{topic: "$KV.fleet_reported." <> _key, body: body}}, state),
    do: {:noreply, %{state | reported: body}}

  def handle_info({:msg, %{topic: "$KV.fleet_leases." <> _key, body: body} = message}, state) do
    seal = Map.new(Map.get(message, :headers, []))[String.downcase(LeaseSeal.header())]
    {:noreply, work(%{state | owner: who(state, body, seal) || state.owner})}
  end

  # Written aboard, or at the hub.
  def handle_info({:msg, _desired}, state), do: {:noreply, work(%{state | desired?: true})}

  def handle_info({:fleet, :bridge, {:connection, _info}}, state), do: {:noreply, connect(state)}
  def handle_info({:fleet, :bridge, {:hub, info}}, state), do: {:noreply, hub(state, info[:status])}

  def handle_info(:tick, state) do
    Process.send_after(self(), :tick, @tick_ms)
    state = if due?(state.looked_at, @look_ms), do: check(state), else: state
    {:noreply, state |> connect() |> report() |> work()}
  end

  def handle_info(_late, state), do: {:noreply, state}

  defp connect(%{conn: before} = state) do
    subjects =
      ["$KV.#{@desired}.#{state.key}", "$KV.#{@reported}.#{state.key}", "$KV.#{@leases}.#{state.lease}"] ++
        [HubBuckets.news(@desired, state.key)]

    state = Subscriber.follow(state, subjects)
    state = if state.conn != before, do: check(%{state | hub: :down}), else: state
    hub(state, with(%{hub: %{status: status}} <- Bridge.info(state.gateway), do: status))
  end

  defp hub(state, :up) when state.hub == :down and state.conn != nil,
    do: %{state | hub: :up, again_at: nil} |> check() |> report() |> work()

  defp hub(state, :up), do: state
  defp hub(state, _down), do: %{state | hub: :down}

  # Everything is compared again.
  defp check(%{conn: nil} = state), do: state

  defp check(%{conn: conn} = state) do
    reported =
      with {:ok, value, _revision} <- KV.get(conn, @reported, state.key), do: value, else: (_none -> nil)

    owner =
      case KV.get_with(conn, @leases, state.lease, LeaseSeal.header()) do
        {:ok, nil, _seal, _revision} -> :nobody
        {:ok, owner, seal, _revision} -> who(state, owner, seal)
        {:error, _no_answer} -> nil
      end

    %{state | desired?: true, reported: state.reported || reported, owner: owner, looked_at: now()}
  end

  # Whether a gateway acts aboard, as one with our key says; nil for what another program wrote.
  defp who(state, owner, seal) do
    case number(state, owner, seal) do
      nil -> nil
      _number when owner == "" -> :nobody
      _number -> :aboard
    end
  end

  defp number(%{environment: environment, vehicle: vehicle} = state, owner, seal) do
    with %{keys: keys} <- Names.value(state.gateway, :shadow_documents),
         {:ok, number} <- LeaseSeal.read(keys, environment, {:vehicle, vehicle}, owner, seal),
         do: number,
         else: (_none -> nil)
  end

  # It comes once a second as long as something changes, and again with the next change, if this notice is lost.
  defp report(%{hub: :up, reported: text, conn: conn} = state) when text != nil and conn != nil do
    case HubBuckets.send(conn, @reported, state.key, text) do
      :ok -> %{state | reported: nil}
      {:error, _lost} -> state
    end
  end

  defp report(state), do: state

  defp work(%{hub: :up, conn: conn} = state) when conn != nil do
    if state.again_at == nil or now() >= state.again_at, do: state |> own() |> desire(), else: state
  end

  defp work(state), do: state

  defp own(%{owner: nil} = state), do: state

  defp own(state) do
    name = "gateway-" <> state.vehicle

    header = String.downcase(LeaseSeal.header())

    with {:ok, present, seal, _revision} <- HubBuckets.get_with(state.conn, @leases, state.lease, header) do
      case {state.owner, present, number(state, present || "", seal)} do
        {:aboard, ^name, number} when number != nil -> %{state | owner: nil}
        # The holder at the hub gives way to the gateway aboard.
        {:aboard, _other, number} -> owner(state, name, number)
        {:nobody, ^name, number} -> owner(state, :delete, number)
        {:nobody, _other, _number} -> %{state | owner: nil}
      end
    else
      {:error, why} -> later(state, why)
    end
  end

  defp owner(%{environment: environment, vehicle: vehicle} = state, value, before) do
    number = max(System.os_time(:millisecond), (before || 0) + 1)
    %{keys: keys} = Names.value(state.gateway, :shadow_documents)
    text = if value == :delete, do: "", else: value
    seal = LeaseSeal.headers(keys, environment, {:vehicle, vehicle}, text, number)

    case HubBuckets.send(state.conn, @leases, state.lease, value, seal) do
      :ok -> %{state | owner: nil}
      {:error, _lost} -> state
    end
  end

  defp desire(%{desired?: false} = state), do: state

  defp desire(state) do
    with %{keys: keys, dir: dir} <- Names.value(state.gateway, :shadow_documents),
         state = %{state | base: state.base || base(dir, keys, state)},
         {:ok, hub, revision} <- at_hub(state, keys),
         {:ok, aboard} <- aboard(state) do
      now = System.os_time(:microsecond)
      source = Sources.named(Policy.Store.get(state.gateway), state.source, now)
      {permitted, refused} = Merge.permitted(state.base, aboard, hub, &may?(source, &1, &2))
      merged = Merge.merge(state.base, aboard, permitted, now, refused)
      seal = &Sealed.encode(&1, state.environment, keys)

      with :ok <- up(state, hub, merged, revision, seal),
           # The hub's document now has all of ours, which is what the next one is compared with if the way back fails.
           state = keep(state, dir, aboard, seal),
           :ok <- down(state, aboard, merged) do
        refuse(state, source, refused)
        put_problem(%{keep(state, dir, merged, seal) | desired?: false}, nil)
      else
        # With the next tick, or sooner if a notice of a change comes.
        :lost_race -> state
        {:error, why} -> later(state, why)
      end
    else
      {:error, why} -> later(state, why)
      nil -> state
    end
  end

  defp may?({:ok, source}, path, value),
    do: Enum.all?(Field.permissions(path, value), &Roles.allowed?(source, &1))

  defp may?({:deny, _rule, _nobody}, _path, _value), do: false

  defp refuse(_state, _source, []), do: :ok

  defp refuse(state, source, paths) do
    why =
      case source do
        {:ok, source} -> "#{source.name} lacks the permissions for it"
        {:deny, :signature, nobody} -> nobody <> " (shadow.hub)"
      end

    text = "what the hub desires of #{Enum.join(paths, ", ")} is refused: #{why}"
    Logger.warning("shadow: " <> text)
    Metrics.count(state.gateway, :updates_refused)

    metadata = %{
      gateway: state.gateway,
      vehicle: state.vehicle,
      actor: state.source,
      via: "leaf",
      reason: text
    }

    :telemetry.execute([:aerie, :shadow, :refused], %{count: 1}, metadata)
  end

  defp base(dir, keys, state) do
    with text when text != nil <- LocalStore.read(folder(dir), state.vehicle),
         {_kind, %Document{} = document} <-
           Sealed.decode(text, state.environment, state.vehicle, keys) do
      document
    else
      _none -> Document.new(state.vehicle)
    end
  end

  defp at_hub(state, keys) do
    case HubBuckets.get(state.conn, @desired, state.key) do
      {:ok, text, revision} ->
        case Sealed.decode(text, state.environment, state.vehicle, keys) do
          {:error, why} -> {:error, "the hub's desired state of #{state.vehicle} is not heeded: #{why}"}
          {_kind, document} -> {:ok, document, revision}
        end

      {:none, revision} ->
        {:ok, Document.new(state.vehicle), revision}

      error ->
        error
    end
  end

  defp aboard(state) do
    with {:error, {:unavailable, why}} <- Documents.fetch(state.gateway, state.vehicle), do: {:error, why}
  end

  defp up(state, hub, merged, revision, seal) do
    if Merge.same?(hub, merged),
      do: :ok,
      else: HubBuckets.put(state.conn, @desired, state.key, seal.(merged), revision)
  end

  defp down(state, aboard, merged) do
    if Merge.same?(aboard, merged), do: :ok, else: down_unless_changed(state, aboard, merged)
  end

  defp down_unless_changed(state, aboard, merged) do
    changed = {:error, {:conflict, "it was changed meanwhile"}}
    take = fn present -> if Merge.same?(present, aboard), do: {:ok, merged}, else: changed end

    case Documents.change(state.gateway, state.vehicle, take) do
      {:ok, _document} -> :ok
      {:error, {:conflict, _why}} -> :lost_race
      {:error, {_kind, why}} -> {:error, why}
    end
  end

  defp keep(%{base: base} = state, dir, document, seal) do
    # Without it the next start takes every difference for a change on both sides.
    _ =
      with false <- Merge.same?(base, document),
           :ok <- Private.folder(Path.join(folder(dir), "desired")),
           do: LocalStore.write(folder(dir), state.vehicle, seal.(document))

    %{state | base: document}
  end

  defp folder(dir), do: Path.join(dir, "hub")

  defp later(state, why), do: put_problem(%{state | again_at: now() + @again_ms}, why)

  defp put_problem(state, why) do
    if why != nil and why != Names.value(state.gateway, :shadow_uplink), do: Logger.warning("shadow: " <> why)
    Names.put_value(state.gateway, :shadow_uplink, why)
    state
  end

  defp due?(nil, _ms), do: true
  defp due?(at, ms), do: now() - at >= ms
  defp now, do: System.monotonic_time(:millisecond)
end
