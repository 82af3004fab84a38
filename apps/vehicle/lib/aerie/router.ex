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
  | `[:aerie, :router, :dropped]` | `frames` | `gateway`, `network`, `system`, `reason`: `:overload` |
  """

  alias Aerie.Fleet.Store
  alias Aerie.Names
  alias Aerie.Router.Admission
  alias Aerie.Router.Heartbeat
  alias Aerie.Router.Load
  alias Aerie.Router.Routes
  alias Aerie.Router.Systems
  alias Aerie.Router.Tables
  alias MavCodec.Frame

  @typedoc """
  Where frames come from: the link's id, its network, which of its peers sent them, and what is thought of the link
  (`Aerie.Signing.trust/1`).
  """
  @type source :: %{
          required(:id) => String.t(),
          required(:network) => String.t(),
          required(:peer) => term,
          optional(:trust) => Aerie.Signing.Guard.trust()
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
  Delivers the frames of one read of one peer, in order: one message `{:frames, link_id, [frame]}` for each vehicle in it.

  An autopilot's heartbeat of an unknown vehicle starts that vehicle, and the frames of the read are its first ones (H2,
  H4). Never raises for what is in the frames.
  """
  @spec deliver(Names.gateway(), source, [Frame.t()]) :: outcome
  def deliver(_gateway, _source, []), do: @nothing

  def deliver(gateway, source, frames) do
    case Tables.of(gateway) do
      # The router is being restarted, and the link with it.
      nil -> %{@nothing | unclaimed: length(frames)}
      # What has no right signature where one is needed is not for us, whoever else it is forwarded to (S10).
      tables -> admitted(gateway, tables, source, Aerie.Signing.admit(gateway, source, frames))
    end
  end

  defp admitted(_gateway, _tables, _source, []), do: @nothing

  defp admitted(gateway, tables, source, frames) do
    now = System.monotonic_time(:millisecond)
    own = Tables.setting(tables, :own, nil)

    frames
    |> by_system()
    |> Enum.reduce(@nothing, fn {system, frames}, outcome ->
      {looped, frames} = Enum.split_with(frames, &({&1.system, &1.component} == own))
      outcome = %{outcome | looped: outcome.looped + length(looped)}
      if frames == [], do: outcome, else: system(gateway, tables, source, system, frames, now, outcome)
    end)
  end

  # Nearly always a read is of one system.
  defp by_system([%Frame{system: system} | rest] = frames) do
    if Enum.all?(rest, &(&1.system == system)),
      do: [{system, frames}],
      else: Enum.group_by(frames, & &1.system)
  end

  defp system(gateway, tables, %{network: network} = source, system, frames, now, outcome) do
    learn(tables, source, system, frames, now)
    autopilot? = heartbeats(gateway, source, frames)
    key = {network, system}

    case Names.whereis(gateway, :session, key) do
      nil when autopilot? -> admit(gateway, tables, source, key, frames, now, outcome)
      nil -> %{outcome | unclaimed: outcome.unclaimed + length(frames)}
      session -> pass(gateway, tables, source, key, session, frames, now, outcome)
    end
  end

  # Frames of an unknown message id come from who knows whom: they are passed on, but teach nothing (R4).
  defp learn(tables, source, system, frames, now) do
    frames
    |> Enum.reduce([], fn
      %Frame{crc_extra: nil}, known -> known
      %Frame{component: component}, known -> if component in known, do: known, else: [component | known]
    end)
    |> Enum.each(&Routes.learn(tables, source.network, system, &1, {source.id, source.peer}, now))
  end

  # Whether one of the frames is the heartbeat of a vehicle's autopilot; all senders of heartbeats are remembered.
  defp heartbeats(gateway, source, frames) do
    Enum.reduce(frames, false, fn
      %Frame{id: 0, crc_extra: extra} = frame, vehicle? when extra != nil ->
        heartbeat = Heartbeat.read(frame)
        _ = Systems.note(gateway, source.network, source.id, frame, heartbeat)
        vehicle? or Heartbeat.vehicle?(heartbeat)

      _other, vehicle? ->
        vehicle?
    end)
  end

  defp admit(gateway, tables, source, key, frames, now, outcome) do
    case Admission.session(gateway, tables, key, now) do
      {:ok, session} -> pass(gateway, tables, source, key, session, frames, now, outcome)
      :refused -> %{outcome | refused: outcome.refused + length(frames)}
    end
  end

  defp pass(gateway, tables, source, {network, system} = key, session, frames, now, outcome) do
    if Load.over?(tables, key, session, now) do
      metadata = %{gateway: gateway, network: network, system: system, reason: :overload}
      :telemetry.execute([:aerie, :router, :dropped], %{frames: length(frames)}, metadata)
      %{outcome | overload: outcome.overload + length(frames)}
    else
      Kernel.send(session, {:frames, source.id, frames})
      %{outcome | delivered: outcome.delivered + length(frames), sessions: [session | outcome.sessions]}
    end
  end

  @doc """
  Sends bytes (one or more whole frames) to a vehicle or any other system, by the way that was heard last.

  `component:` prefers ways by which that component was heard. `{:error, :no_route}` for who was never heard, or not for
  a long time. `:ok` means handed to the link; what the link cannot send it counts.
  """
  @spec send(Names.gateway(), vehicle_key, iodata, keyword) :: :ok | {:error, :no_route}
  def send(gateway, {_network, _system} = key, bytes, options \\ []) do
    with tables when is_map(tables) <- Tables.of(gateway),
         {link, peer} <- Routes.best(tables, key, Keyword.take(options, [:component])),
         bytes = Aerie.Signing.mark(gateway, key, bytes),
         :ok <- Aerie.Link.send_bytes(gateway, link, bytes, {:peer, peer}) do
      :ok
    else
      _none -> {:error, :no_route}
    end
  end

  @doc "Sends bytes by every link of a network (`:all` networks by default) to every peer: for our own heartbeat."
  @spec broadcast(Names.gateway(), iodata, network :: String.t() | :all) :: :ok
  def broadcast(gateway, bytes, network \\ :all) do
    for link <- Store.links(gateway), network in [:all, link.network], link.status in [:up, :idle] do
      # One that is gone meanwhile needs none.
      marked = Aerie.Signing.mark(gateway, {link.network, nil}, bytes)
      _ = Aerie.Link.send_bytes(gateway, link.id, marked, :all)
    end

    :ok
  end

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

  @doc "All systems that sent a heartbeat, vehicles or not (`Aerie.Router.Systems`)."
  @spec systems(Names.gateway()) :: %{vehicle_key => map}
  def systems(gateway), do: Store.systems(gateway)

  @doc "Forgets the routes of a system, as after its reboot (R6)."
  @spec clear(Names.gateway(), vehicle_key) :: :ok
  def clear(gateway, key), do: with_tables(gateway, &Routes.clear(&1, key))

  @doc "Forgets the routes by a link."
  @spec forget(Names.gateway(), String.t()) :: :ok
  def forget(gateway, link), do: with_tables(gateway, &Routes.forget(&1, link))

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
