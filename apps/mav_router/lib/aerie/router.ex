defmodule Aerie.Router do
  @moduledoc """
  From links to vehicles and back: plain functions that run in the process of whoever calls them, over shared tables.

  - `deliver/3`: a link's frames go to the sessions of their vehicles; on the way it is learned who is heard where
  - `send/4`: bytes for a vehicle go out by the link and peer where it was heard last
  - `routes/1`, `systems/1`: what was learned

  Frames are passed on as they are; whoever forwards one sends its original `bytes` (R3).

  ## Telemetry

  | event | measurements | metadata |
  |---|---|---|
  | `[:aerie, :router, :vehicle_found]` | | `gateway`, `network`, `system` |
  | `[:aerie, :router, :vehicle_refused]` | | and `reason`: `:too_many`, `:not_running` |
  | `[:aerie, :router, :reboot]` | | `gateway`, `network`, `system`: its boot time began anew (R6) |
  | `[:aerie, :router, :collision]` | | `gateway`, `network`, `system`, `links`: by these another vehicle with that id is heard (`Aerie.Router.Apart`); none: it is over |
  | `[:aerie, :router, :carrier]` | `score` | `gateway`, `group`, `link`: another link of a group carries |
  | `[:aerie, :router, :denied]` | `frames` | `gateway`, `network`, `link`, `peer`, `system`, `component`, `message`: an order that may not be given (`Aerie.Router.Gate`); at most one a minute for each link |
  | `[:aerie, :router, :dropped]` | `frames` | `gateway`, `network`, `system`, `reason`: `:overload` |
  """

  alias Aerie.Store
  alias Aerie.Names
  alias Aerie.Router.Admission
  alias Aerie.Router.Dispatch
  alias Aerie.Router.Echo
  alias Aerie.Router.Endpoints
  alias Aerie.Router.Forward
  alias Aerie.Router.Intake
  alias Aerie.Router.Load
  alias Aerie.Router.Local
  alias Aerie.Router.Plan
  alias Aerie.Router.Routes
  alias Aerie.Router.Rules
  alias Aerie.Router.Tables
  alias Aerie.Router.Talker
  alias Aerie.Router.Tally
  alias Aerie.Router.Turns
  alias Aerie.Router.Wishes
  alias Aerie.Router.View
  alias MavCodec.Frame

  @typedoc """
  Where frames come from: the link's id, its network (nil: what its endpoint says), which of its peers sent them, and what
  is thought of the link (`Aerie.Signing.trust/1`).
  """
  @type source :: %{
          required(:id) => String.t(),
          required(:network) => String.t() | nil,
          required(:peer) => term,
          optional(:trust) => Aerie.Signing.Guard.trust(),
          optional(:high_latency) => boolean
        }

  @type vehicle_key :: {network :: String.t(), system :: non_neg_integer}

  @typedoc """
  What became of frames, in frames: `delivered` to sessions, `unclaimed` (of a system without a vehicle), `refused` (the
  limit of vehicles), `overload` (the session does not keep up), `looped` (they are our own). `sessions` got something.
  """
  @type outcome :: %{
          delivered: non_neg_integer,
          unclaimed: non_neg_integer,
          refused: non_neg_integer,
          overload: non_neg_integer,
          looped: non_neg_integer,
          sessions: [pid]
        }

  @nothing %{delivered: 0, unclaimed: 0, refused: 0, overload: 0, looped: 0, sessions: []}

  @doc """
  Delivers the frames of one read of one peer, in order: one message `{:frames, link_id, [frame]}` for each vehicle in it,
  or `{:frames, {link_id, peer}, [frame]}` while several endpoints bring a system that is in it.

  An autopilot's heartbeat of an unknown vehicle starts that vehicle, and the frames of the read are its first ones (H2,
  H4). Never raises for what is in the frames.
  """
  @spec deliver(Names.gateway(), source, [Frame.t()]) :: outcome
  def deliver(_gateway, _source, []), do: @nothing

  def deliver(gateway, source, frames) do
    case Tables.of(gateway) do
      # The router is being restarted, and the link with it.
      nil -> %{@nothing | unclaimed: length(frames)}
      tables -> forward(gateway, tables, source, frames)
    end
  end

  defp forward(gateway, tables, source, frames) do
    local = Local.fetch(gateway, tables)

    case way_of(local, source) do
      # A client whose endpoint is gone, as after a restart of the router: whatever it says is no vehicle's.
      nil -> %{@nothing | unclaimed: length(frames)}
      way -> forward(gateway, tables, local, way, source, frames)
    end
  end

  defp forward(gateway, tables, local, way, source, frames) do
    now = :erlang.monotonic_time(:millisecond)
    Tally.add(way.tally, :frames_in, length(frames))
    # What has no right signature where one is needed is not for us, whoever else it is forwarded to (S10).
    trusted = Aerie.Signing.admit(gateway, believed(%{source | network: hd(way.networks)}, way), frames)

    case by_talker(frames, local.plan.own) do
      :own -> echo(tables, way, frames, now)
      {:one, ids} -> one(gateway, tables, local, way, ids, {frames, trusted}, now)
      {:several, looped, talkers} -> several(gateway, tables, local, way, {looped, talkers}, trusted, now)
    end
  end

  defp echo(tables, way, frames, now) do
    Echo.look(tables, way, frames, now)
    %{@nothing | looped: length(frames)}
  end

  # Nearly always a read is of one component: the short way.
  defp one(gateway, tables, local, way, {system, _component} = ids, {_frames, trusted} = both, now) do
    {talker, way, autopilot?} = talker(gateway, tables, local, way, ids, both, now)

    cond do
      trusted == [] ->
        @nothing

      way.side != :vehicle ->
        %{@nothing | unclaimed: length(trusted)}

      true ->
        to_session(
          gateway,
          tables,
          way,
          talker,
          {system, from(way, talker), trusted, autopilot?},
          now,
          @nothing
        )
    end
  end

  defp several(gateway, tables, local, way, {looped, talkers}, trusted, now) do
    outcome = %{@nothing | looped: length(looped)}

    {way, vehicles, from} =
      Enum.reduce(talkers, {way, [], way.owner}, fn {{system, _} = ids, frames}, {way, vehicles, from} ->
        # The one before may have changed it.
        local = Local.fetch(gateway, tables)
        both = {frames, heard(frames, trusted, ids)}
        {talker, way, autopilot?} = talker(gateway, tables, local, way, ids, both, now)
        from = if from == way.owner, do: from(way, talker), else: from
        {way, if(autopilot?, do: [system | vehicles], else: vehicles), from}
      end)

    if looped != [], do: Echo.look(tables, way, looped, now)
    not_own = Enum.reject(trusted, &({&1.system, &1.component} == local.plan.own))

    if way.side == :vehicle do
      # A vehicle's frames in their order, whichever of its components sent them.
      not_own
      |> Enum.group_by(& &1.system)
      |> Enum.reduce(outcome, fn {system, frames}, outcome ->
        to_session(gateway, tables, way, nil, {system, from, frames, system in vehicles}, now, outcome)
      end)
    else
      %{outcome | unclaimed: length(not_own)}
    end
  end

  # A client that is signed for needs no signature of its own.
  defp believed(source, %{sign: true}), do: Map.put(source, :trust, :secure)
  defp believed(source, _way), do: source

  defp heard(frames, trusted, ids) do
    # Nearly always all.
    if trusted == frames, do: frames, else: Enum.filter(trusted, &({&1.system, &1.component} == ids))
  end

  defp way_of(%{plan: plan}, %{id: id, peer: peer, network: network}) do
    case plan.ways do
      %{{^id, ^peer} => way} -> way
      _unknown when network == nil -> nil
      _unknown -> Plan.stranger(id, peer, network)
    end
  end

  defp by_talker([%Frame{system: system, component: component} | rest] = frames, own) do
    if same?(rest, system, component) do
      ids = {system, component}
      if ids == own, do: :own, else: {:one, ids}
    else
      {looped, others} = Enum.split_with(frames, &({&1.system, &1.component} == own))
      {:several, looped, others |> Enum.group_by(&{&1.system, &1.component}) |> Enum.to_list()}
    end
  end

  defp same?([], _system, _component), do: true
  defp same?([%Frame{system: s, component: c} | rest], s, c), do: same?(rest, s, c)
  defp same?(_rest, _system, _component), do: false

  # Frames of an unknown message id come from who knows whom: they are passed on, but teach nothing (R4).
  defp talker(gateway, tables, local, way, {system, component}, {frames, heard}, now) do
    before = Local.talker(local, way.key, system, component)
    talker = Talker.refresh(before, tables, local.plan, way, known?(heard), now)
    {talker, way, autopilot?} = Intake.look(gateway, tables, way, talker, heard)
    _ = if talker !== before, do: Local.put(gateway, Local.put_talker(local, way.key, talker))
    frames = Wishes.pass(gateway, tables, way, frames, heard)
    frames = Turns.pass(gateway, tables, local.plan, way, talker, frames)
    Forward.frames(tables, local.plan, way, talker, frames, now)
    {talker, way, autopilot?}
  end

  defp known?([]), do: false
  defp known?([%Frame{crc_extra: nil} | rest]), do: known?(rest)
  defp known?([_checked | _rest]), do: true

  # Where several endpoints bring a system its session is told which one it was.
  defp from(way, %{twice: false, other: false}), do: way.owner
  defp from(way, _talker), do: way.key

  defp to_session(gateway, tables, way, talker, {system, from, frames, autopilot?}, now, outcome) do
    key = {hd(way.networks), system}

    case session(gateway, key, way, talker) do
      nil when autopilot? -> admit(gateway, tables, from, key, frames, now, outcome)
      nil -> unclaimed(gateway, key, frames, outcome)
      session -> pass(gateway, tables, from, key, session, frames, now, outcome)
    end
  end

  defp unclaimed(gateway, key, frames, outcome) do
    Local.hold(gateway, key, frames)
    %{outcome | unclaimed: outcome.unclaimed + length(frames)}
  end

  # Remembered with the talker while it lives; that there is none, until some process takes a name.
  defp session(gateway, key, way, talker) do
    case talker do
      %{session: {^key, session}} when is_pid(session) ->
        if Process.alive?(session), do: session, else: find_session(gateway, key, way, talker)

      %{session: {^key, epoch}} when is_integer(epoch) ->
        if epoch == Names.epoch(), do: nil, else: find_session(gateway, key, way, talker)

      _new_or_none ->
        find_session(gateway, key, way, talker)
    end
  end

  defp find_session(gateway, key, _way, nil), do: Names.whereis(gateway, :session, key)

  defp find_session(gateway, key, way, talker) do
    epoch = Names.epoch()
    found = Names.whereis(gateway, :session, key)
    Local.update_talker(gateway, way.key, %{talker | session: {key, found || epoch}})
    found
  end

  defp admit(gateway, tables, from, key, frames, now, outcome) do
    first = fn -> Local.held(gateway, key, hd(frames)) ++ frames end

    case Admission.session(gateway, tables, key, from, first, now) do
      # It gets them when it is there.
      :coming ->
        %{outcome | delivered: outcome.delivered + length(frames)}

      {:ok, session} ->
        pass(gateway, tables, from, key, session, first.(), now, outcome)

      :refused ->
        %{outcome | refused: outcome.refused + length(frames)}

      :not_yet ->
        unclaimed(gateway, key, frames, outcome)
    end
  end

  defp pass(gateway, tables, from, {network, system} = key, session, frames, now, outcome) do
    if Load.over?(tables, key, session, now) do
      metadata = %{gateway: gateway, network: network, system: system, reason: :overload}
      :telemetry.execute([:aerie, :router, :dropped], %{frames: length(frames)}, metadata)
      %{outcome | overload: outcome.overload + length(frames)}
    else
      Kernel.send(session, {:frames, from, frames})
      %{outcome | delivered: outcome.delivered + length(frames), sessions: [session | outcome.sessions]}
    end
  end

  @doc """
  Sends bytes (one or more whole frames) to a vehicle or any other system: by the way that was heard last, of redundant
  links by the one that carries their class (`Aerie.Router.Carrier`).

  `component:` prefers ways by which that component was heard, `link:` is the only link that will do.
  `{:error, :no_route}` for who was never heard, or not for a long time. `:ok` means handed to the link; what the link
  cannot send it counts.
  """
  @spec send(Names.gateway(), vehicle_key, iodata, keyword) :: :ok | {:error, :no_route}
  defdelegate send(gateway, key, bytes, options \\ []), to: Dispatch

  @doc "Sends bytes to every endpoint of a network (`:all` networks by default), clients too: for our own heartbeat."
  @spec broadcast(Names.gateway(), iodata, network :: String.t() | :all) :: :ok
  defdelegate broadcast(gateway, bytes, network \\ :all), to: Dispatch

  @doc "The way by which a system was heard last: `{link, peer}`, or nil. `link:` and `component:` narrow it."
  @spec way(Names.gateway(), vehicle_key, keyword) :: Routes.way() | nil
  def way(gateway, key, options \\ []) do
    with tables when is_map(tables) <- Tables.of(gateway), do: Routes.best(tables, key, options)
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
  | `:owner`, `:side`, `:kind`, `:peer` | the same for people: `:vehicle` or `:client`, `:link`, `:websocket` ..., words |
  | `:networks`, `:group`, `:role`, `:sniffer` | rules of its owner (`Aerie.Router.Owner`) |
  | `:high_latency` | whether it is spared what links of high latency do not carry (X6): configured, or found out |
  | `:id_offsets` | what is added to the ids of a network for it (`Aerie.Router.Renumber`) |
  | `:hidden` | `[{network, system}]` that it does not see, because an earlier one of its networks has a system that it sees under that id |
  | `:since` | unix microseconds |
  | `:waiting` | frames on their way to its process |
  | `:counters` | `Aerie.Router.Tally` |
  | `:rates` | of the last seconds, per second: `frames_in`, `frames_out`, `bytes_out` |
  """
  @spec endpoints(Names.gateway()) :: [map]
  def endpoints(gateway) do
    case Tables.of(gateway) do
      nil -> []
      tables -> View.endpoints(tables)
    end
  end

  @doc """
  Changes rules of a link, a client or any other owner of endpoints while it runs: the keys of the configuration
  (`Aerie.Router.Settings.changeable/0`), nil for none, those that are not given stay. Holds with the next frame and for
  this owner only, until `reset/3`, until the owner is removed or the gateway ends; a restart of its process or of the router
  changes nothing of it.
  """
  @spec configure(Names.gateway(), String.t(), map | keyword) :: :ok | {:error, String.t()}
  defdelegate configure(gateway, id, changes), to: Rules, as: :change

  @doc "Undoes what `configure/3` changed of an owner: these keys (all), which are as configured then."
  @spec reset(Names.gateway(), String.t(), [atom] | :all) :: :ok | {:error, String.t()}
  defdelegate reset(gateway, id, keys \\ :all), to: Rules

  @doc "What differs from the configuration, by owner and key: `%{now: value, configured: value}`."
  @spec changes(Names.gateway()) :: %{String.t() => %{atom => %{now: term, configured: term}}}
  defdelegate changes(gateway), to: Rules, as: :list

  @doc "Whose commands go from a link's ends to vehicles just now (`Aerie.Router.Gate`)."
  @spec gcs(Names.gateway(), String.t()) :: :auto | :allow | :deny
  def gcs(gateway, link) do
    with tables when is_map(tables) <- Tables.of(gateway), %{gcs: gcs} <- Endpoints.owner(tables, link) do
      gcs
    else
      _unknown -> :auto
    end
  end

  @doc """
  What the gateway calls itself: `%{system, component, alarm}`, with nil for ids that are still to be found out; `alarm` says
  in words that an autopilot is heard that has the same ones, which is then not seen as a vehicle.
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

  @doc "All systems that sent a heartbeat, vehicles or not (`Aerie.Router.Systems`)."
  @spec systems(Names.gateway()) :: %{vehicle_key => map}
  def systems(gateway), do: Store.systems(gateway)

  @doc "Forgets the routes of a system, as after its reboot (R6)."
  @spec clear(Names.gateway(), vehicle_key) :: :ok
  def clear(gateway, key) do
    with_tables(gateway, fn tables ->
      Routes.clear(tables, key)
      Tables.rerouted(tables)
    end)
  end

  @doc "Forgets the routes by a link."
  @spec forget(Names.gateway(), String.t()) :: :ok
  def forget(gateway, link), do: with_tables(gateway, &Routes.forget(&1, link))

  @doc "Forgets a link that is no more: its endpoints, routes, rules and what was changed of them."
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
