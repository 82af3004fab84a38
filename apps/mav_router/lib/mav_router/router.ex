defmodule MavRouter.Router do
  @moduledoc """
  From links to vehicles and back: plain functions that run in the process of their caller, over shared tables.

  - `deliver/4`: frames of a link go to other endpoints and to the sessions of their vehicles, and teach who is heard where
  - `send/4`: bytes for a vehicle go out by the endpoint that brings it
  - `routes/1`, `systems/1`: what was learned

  Frames are forwarded unchanged, as the bytes that came in (R3).

  ## Telemetry

  | event | measurements | metadata |
  |---|---|---|
  | `[:aerie, :router, :vehicle_found]` | | `gateway`, `network`, `system` |
  | `[:aerie, :router, :vehicle_refused]` | | and `reason`: `:too_many`, `:not_running` |
  | `[:aerie, :router, :reboot]` | | `gateway`, `network`, `system`: its boot time started over (R6) |
  | `[:aerie, :router, :collision]` | | `gateway`, `network`, `system`, `links`, by which another vehicle with that id is heard (`MavRouter.Routes.Collisions`); none: it is over |
  | `[:aerie, :router, :carrier]` | `score` | `gateway`, `group`, `link`: another link of the group carries |
  | `[:aerie, :router, :denied]` | `frames` | `gateway`, `network`, `link`, `peer`, `system`, `component`, `message`: an order from an endpoint that may not command (`MavRouter.Forward.Refusal`); at most one a minute for each link |
  | `[:aerie, :router, :dropped]` | `frames` | `gateway`, `network`, `system`, `reason`: `:overload`, or `:refused` for what was kept of a vehicle that could not be started |
  """

  alias Aerie.Base.Names
  alias MavRouter.Router.Deliver
  alias MavRouter.Forward.Dispatch
  alias MavRouter.Router.Echo
  alias MavRouter.Endpoints.Counters
  alias MavRouter.Endpoints.Endpoint
  alias MavRouter.Endpoints.Owner.Renumber
  alias MavRouter.Endpoints
  alias MavRouter.Routes
  alias MavRouter.Forward.Holders
  alias MavRouter.Forward.Table
  alias MavRouter.Endpoints.Rules
  alias MavRouter.Tables
  alias Aerie.Base.Store
  alias MavCodec.Frame

  @typedoc """
  Where frames come from: the link's id, its network (nil: that of the endpoint), the peer that sent them, how far the link is
  trusted (`MavRouter.Signing.trust/1`), and whether it is one of high latency.
  """
  @type origin :: %{
          required(:id) => String.t(),
          required(:network) => String.t() | nil,
          required(:peer) => term,
          optional(:trust) => MavRouter.Signing.Verifiers.Verifier.trust(),
          optional(:high_latency) => boolean
        }

  @typedoc "What a process that delivers frames keeps between two reads (`MavRouter.Forward.Cache`)."
  @type cache :: MavRouter.Forward.Cache.t()

  @type vehicle_key :: {network :: String.t(), system :: non_neg_integer}

  @typedoc """
  What became of frames, in frames: `delivered` to sessions, `unclaimed` (of a system without a vehicle), `refused` (there is no
  room for the vehicle), `overload` (the session does not keep up), `looped` (they are our own). `sessions` got some of them.
  """
  @type outcome :: %{
          delivered: non_neg_integer,
          unclaimed: non_neg_integer,
          refused: non_neg_integer,
          overload: non_neg_integer,
          looped: non_neg_integer,
          sessions: [pid]
        }

  @doc """
  Delivers the frames of one read of one peer, in order. The session of each vehicle gets one message, `{:frames, link_id,
  [frame]}`, or `{:frames, {link_id, peer}, [frame]}` while several endpoints bring a system of the read.

  An autopilot's heartbeat of an unknown vehicle starts the vehicle, and the frames of the read are its first ones (H2, H4).
  `cache` is what the call before gave, nil for the first one: a process that delivers again and again keeps it. Never raises because
  of a frame.
  """
  @spec deliver(Names.gateway(), origin, [Frame.t()], cache() | nil) :: {outcome, cache() | nil}
  defdelegate deliver(gateway, origin, frames, cache), to: Deliver, as: :frames

  @doc """
  Takes the frames by which a vehicle was found, if it was started beside the link that heard it: a message of `deliver/4`, or nil. A
  session asks for it when it starts, before it reads its mailbox, where newer frames may be already.
  """
  @spec first_frames(Names.gateway(), vehicle_key) :: {:frames, term, [Frame.t()]} | nil
  defdelegate first_frames(gateway, key), to: MavRouter.Router.Starter

  @doc """
  Sends bytes (one or more whole frames) to a vehicle, by the endpoint that brings it (`MavRouter.Forward.Holders`), or
  to any other system, by the endpoint where it was heard last; of redundant
  links by the one that carries their class (`MavRouter.Routes.LinkSelector`).

  `component:` prefers endpoints where that component was heard, `link:` allows that link only. `{:error, :no_route}` for a system
  that was never heard, or not for a long time. `:ok` means handed to the link, which counts what it cannot send.
  """
  @spec send(Names.gateway(), vehicle_key, iodata, keyword) :: :ok | {:error, :no_route}
  defdelegate send(gateway, key, bytes, options \\ []), to: Dispatch

  @doc "Sends bytes, such as our own heartbeat, to every endpoint of a network (default: `:all` networks), clients included."
  @spec broadcast(Names.gateway(), iodata, network :: String.t() | :all) :: :ok
  defdelegate broadcast(gateway, bytes, network \\ :all), to: Dispatch

  @doc "The endpoint by which `send/4` sends, the first of several; nil for none. `link:` and `component:` as there."
  @spec route(Names.gateway(), vehicle_key, keyword) :: Endpoint.key() | nil
  def route(gateway, key, options \\ []) do
    with tables when is_map(tables) <- Tables.of(gateway),
         do: tables |> Holders.way(key, options, System.monotonic_time(:millisecond)) |> List.first()
  end

  @doc """
  Whether a vehicle that is not lost is reached by an endpoint: its link keeps the path open, however long it is silent.
  """
  @spec needed?(Names.gateway(), Endpoint.key()) :: boolean
  def needed?(gateway, key) do
    case Tables.of(gateway) do
      nil -> false
      tables -> Holders.needed?(tables, gateway, key, System.monotonic_time(:millisecond))
    end
  end

  @doc "Whether an endpoint gets only what links of high latency carry (X6)."
  @spec high_latency?(Names.gateway(), Endpoint.key()) :: boolean
  def high_latency?(gateway, key) do
    tables = Tables.of(gateway)
    tables != nil and Holders.slow?(tables, key)
  end

  @doc "All learned routes, with their ages in ms."
  @spec routes(Names.gateway()) :: [Routes.route()]
  def routes(gateway) do
    case Tables.of(gateway) do
      nil -> []
      tables -> Routes.list(tables, System.monotonic_time(:millisecond))
    end
  end

  @doc """
  All endpoints, links' peers and clients, in the order of their ids:

  | key | |
  |---|---|
  | `:id` | `{owner, peer}`: the link or client, and which of its peers |
  | `:owner`, `:side`, `:kind`, `:peer` | the same for people: `:vehicle` or `:client`; `:link`, `:websocket` …; text |
  | `:networks`, `:group`, `:role`, `:sniffer` | rules of its owner (`MavRouter.Endpoints.Owner`) |
  | `:high_latency` | whether it gets only what links of high latency carry (X6): configured, or found out |
  | `:id_offsets` | what is added to the system ids of a network for it (`MavRouter.Endpoints.Owner.Renumber`) |
  | `:hidden` | `[{network, system}]` that it does not get, because an earlier one of its networks has a system that it sees under that id |
  | `:since` | unix microseconds |
  | `:waiting` | frames in the mailbox of its process |
  | `:counters` | `MavRouter.Endpoints.Counters` |
  | `:rates` | of the last seconds, per second: `frames_in`, `frames_out`, `bytes_out` |
  """
  @spec endpoints(Names.gateway()) :: [map]
  def endpoints(gateway) do
    case Tables.of(gateway) do
      nil -> []
      tables -> endpoint_maps(tables)
    end
  end

  defp endpoint_maps(tables) do
    paths = Table.read(tables).paths
    heard = Routes.systems(tables)

    for endpoint <- Enum.sort_by(Endpoints.list(tables), & &1.key), path = paths[endpoint.key] do
      %{
        id: endpoint.key,
        owner: path.owner,
        side: path.side,
        kind: endpoint.kind,
        peer: endpoint.text,
        networks: path.networks,
        group: path.group,
        role: path.role,
        sniffer: path.sniffer,
        high_latency: path.high_latency,
        id_offsets: path.renumber || %{},
        hidden: hidden(heard, path),
        since: endpoint.since,
        waiting: max(:atomics.get(endpoint.waiting, 1), 0),
        counters: Counters.read(endpoint.counters),
        rates:
          :ets.lookup_element(tables.scores, {:rates, endpoint.key}, 2, %{
            frames_in: 0.0,
            frames_out: 0.0,
            bytes_out: 0.0
          })
      }
    end
  end

  # If two networks have a system with the same id, the one named first is seen.
  defp hidden(_heard, %{networks: [_one]}), do: []

  defp hidden(heard, path) do
    systems = fn network ->
      for {system, key} <- Map.get(heard, network, []), key != path.key, uniq: true, do: system
    end

    seen = fn network -> Enum.map(systems.(network), &Renumber.seen(path.renumber, network, &1)) end

    for {network, i} <- Enum.with_index(path.networks),
        earlier = path.networks |> Enum.take(i) |> Enum.flat_map(seen),
        system <- systems.(network),
        Renumber.seen(path.renumber, network, system) in earlier,
        do: {network, system}
  end

  @doc """
  Changes rules of a link, a client or any other owner of endpoints while it runs, by keys of the configuration
  (`MavRouter.Endpoints.Owner.RuleKeys.changeable/0`); nil removes a rule, keys that are not given stay. The change
  holds from the next frame on, for this owner only, until `reset/3`, or until the owner is removed or the gateway
  ends. It survives a restart of the owner's process and of the router.
  """
  @spec configure(Names.gateway(), String.t(), map | keyword) :: :ok | {:error, Aerie.Base.Error.t()}
  defdelegate configure(gateway, id, changes), to: Rules, as: :change

  @doc "As `configure/3`, for changes as a program writes them (`rules_schema/0`)."
  @spec change_rules(Names.gateway(), String.t(), map) ::
          :ok | {:error, Aerie.Base.Error.t() | {:invalid, String.t()}}
  defdelegate change_rules(gateway, id, object), to: Rules, as: :write

  @doc "The JSON schema of changes of rules."
  @spec rules_schema() :: Aerie.Base.Json.Schema.t()
  defdelegate rules_schema, to: Rules, as: :schema

  @doc "Whether a client that restricts itself to these networks can ever see something; the error names those that there are."
  @spec known_networks(Names.gateway(), [String.t()]) :: :ok | {:error, Aerie.Base.Error.t()}
  def known_networks(gateway, names) do
    case Tables.of(gateway) do
      nil -> Aerie.Base.Error.new({:unavailable, "the router does not run"})
      tables -> Endpoints.known_networks(tables, names)
    end
  end

  @doc "Undoes changes that `configure/3` made to an owner: of these keys (default: all)."
  @spec reset(Names.gateway(), String.t(), [atom] | :all) :: :ok | {:error, Aerie.Base.Error.t()}
  defdelegate reset(gateway, id, keys \\ :all), to: Rules

  @doc "What differs from the configuration, by owner and key: `%{now: value, configured: value}`."
  @spec changes(Names.gateway()) :: %{String.t() => %{atom => %{now: term, configured: term}}}
  defdelegate changes(gateway), to: Rules, as: :list

  @doc "Which endpoints of a link count as clients now (`MavRouter.Endpoints.Access`)."
  @spec command_permission(Names.gateway(), String.t()) :: :auto | :allow | :deny
  def command_permission(gateway, link) do
    with tables when is_map(tables) <- Tables.of(gateway), %{gcs: gcs} <- Endpoints.owner(tables, link) do
      gcs
    else
      _unknown -> :auto
    end
  end

  @doc """
  The gateway's own ids: `%{system, component, alarm}`, nil for ids that are not known yet. `alarm` is a text while an autopilot is
  heard that has the same ids, and is therefore not seen as a vehicle.
  """
  @spec identity(Names.gateway()) :: %{
          system: non_neg_integer | nil,
          component: 0..255 | nil,
          alarm: String.t() | nil
        }
  def identity(gateway) do
    tables = Tables.of(gateway)
    {system, component} = (tables && Tables.setting(tables, :own, nil)) || {nil, nil}
    %{system: system, component: component, alarm: Echo.alarm(gateway)}
  end

  @doc "Whether an endpoint is there."
  @spec connected?(Names.gateway(), MavRouter.Endpoints.Endpoint.key()) :: boolean
  def connected?(gateway, key) do
    case Tables.of(gateway) do
      nil -> false
      tables -> Endpoints.get(tables, key) != nil
    end
  end

  @doc "All systems that sent a heartbeat, vehicles or not (`MavRouter.Forward.HeartbeatLearner`)."
  @spec systems(Names.gateway()) :: %{vehicle_key => map}
  def systems(gateway), do: Store.systems(gateway)

  @doc "Forgets the routes by a link."
  @spec forget(Names.gateway(), String.t()) :: :ok
  def forget(gateway, link), do: with_tables(gateway, &Routes.forget(&1, link))

  @doc "Forgets a link that was removed: its endpoints, routes, rules and changes of rules."
  @spec close(Names.gateway(), String.t()) :: :ok
  def close(gateway, link), do: with_tables(gateway, &Endpoints.close(gateway, &1, link))

  @doc "Forgets the routes by one peer of a link."
  @spec forget(Names.gateway(), String.t(), term) :: :ok
  def forget(gateway, link, peer), do: with_tables(gateway, &Routes.forget(&1, link, peer))

  defp with_tables(gateway, fun) do
    case Tables.of(gateway) do
      nil -> :ok
      tables -> fun.(tables)
    end
  end
end
