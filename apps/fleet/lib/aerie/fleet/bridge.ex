defmodule Aerie.Fleet.Bridge do
  @moduledoc """
  Publishes state and events of vehicles to NATS.

  State is fire and forget; while NATS is away, the last value of each subject is kept. Events come from
  `Aerie.Vehicle.Events.Journal` and are published at least once, even if NATS or the gateway restarts. See the README
  beside the code.

  Telemetry:

  | event | measurements | metadata |
  |---|---|---|
  | `[:aerie, :bridge, :server, :up]` | `restarts` | `gateway`, `url` |
  | `[:aerie, :bridge, :server, :down]` | `up_ms` | `gateway`, `status` (of the process) |
  | `[:aerie, :bridge, :connected]` | `count` (1) | `gateway`, `url` |
  | `[:aerie, :bridge, :disconnected]` | `up_ms` | `gateway`, `reason` (text) |
  | `[:aerie, :bridge, :events, :confirmed]` | `count` | `gateway` |
  """

  @behaviour Aerie.Vehicle.Session.Publisher

  alias Aerie.Fleet.Bridge.{Metrics, State}
  alias Aerie.Fleet.Bridge.Events.History
  alias Aerie.Fleet.Bridge.NatsServer.Token
  alias Aerie.Fleet.Bridge.State.LastPublished
  alias Aerie.Fleet.Bridge.Status.Tables
  alias Aerie.Base.{Names, Store}

  @typedoc """
  * `mode` - `:embedded` or `:url`
  * `connected` - whether there is a connection; `url` - to which server, or the embedded server's
  * `problem` - why NATS does not store events, or nil if it does
  * `server` - embedded mode: `status` (`:starting | :up | :down | {:failed, text}`), `port`, `store_dir`, `restarts`,
    `fault` (why it stores nothing, or nil)
  * `hub` - leaf node: `status` (`:up | :down`), `waiting` (events that the hub does not have), `lost` (events that it
    never gets), `problem` (text or nil) and `stalled` (text if it is there and does not store events, else nil); nil
    without a hub
  * `streams` - the state of each stream, see `Aerie.Fleet.Bridge.Streams`
  * `outbox` - `events`, `bytes`, `dropped`, `in_flight`, `problem` (of its disk: text or nil), `stalled_s` (how long
    events have waited without any confirmation), `stalled` (text if that is too long, else nil) and `silent?` (whether
    the server is connected and says nothing to it, as after a failed write)
  """
  @type info :: %{
          mode: :embedded | :url,
          connected: boolean(),
          problem: String.t() | nil,
          url: String.t() | nil,
          server: map() | nil,
          hub: map() | nil,
          streams: map(),
          outbox: map()
        }

  @doc """
  Hands over a state group of a vehicle for publishing. It is encoded in the calling process, which never waits for
  NATS.

  `map` is the group as in the vehicle's snapshot (`%{data: …, time_boot_ms: …}`) or just its data; `at` is in unix
  microseconds. Without a bridge it does nothing.
  """
  @impl Aerie.Vehicle.Session.Publisher
  @spec publish_state(Names.gateway(), String.t(), atom(), map(), integer()) :: :ok
  defdelegate publish_state(gateway, vehicle, group, map, at), to: State, as: :put

  @doc """
  The vehicle's state as last published before the gateway was restarted (`Aerie.Fleet.Bridge.State.LastPublished`), or
  nil.
  """
  @impl Aerie.Vehicle.Session.Publisher
  @spec remembered(Names.gateway(), String.t()) :: Aerie.Vehicle.Events.Detector.OfflineChanges.t()
  defdelegate remembered(gateway, vehicle), to: LastPublished, as: :of

  @doc "The state of the bridge, or nil if it is not running. Subscribers of `:bridge` get each change."
  @spec info(Names.gateway()) :: info() | nil
  def info(gateway) do
    with %{} = tables <- Tables.get(gateway) do
      server = Tables.info(tables, :server)
      connection = Tables.info(tables, :connection)

      %{
        mode: if(server == %{}, do: :url, else: :embedded),
        connected: connection[:status] == :up,
        problem: Tables.problem(tables),
        url: connection[:url] || server[:url],
        server: if(server != %{}, do: server),
        hub: with(hub when hub == %{} <- Tables.info(tables, :hub), do: nil),
        streams: tables |> Tables.info(:streams) |> Map.get(:report, %{}),
        outbox: Tables.info(tables, :outbox)
      }
    end
  end

  @doc "Whether there is no bridge because the configuration says so (`nats.mode: off`)."
  @spec off?(Names.gateway()) :: boolean()
  def off?(gateway), do: Store.recall(gateway, {:bridge, :off}, false)

  @doc "The fleet's environment: the second word of every subject, which signed commands also name over REST."
  @spec environment(Names.gateway()) :: String.t() | nil
  def environment(gateway), do: Store.recall(gateway, {:bridge, :environment})

  @doc false
  @spec note_environment(Names.gateway(), String.t()) :: :ok
  def note_environment(gateway, environment),
    do: Store.remember(gateway, {:bridge, :environment}, environment)

  @doc "The name that distinguishes this gateway from others, in its messages and its own events."
  @spec name(Names.gateway()) :: String.t() | nil
  def name(gateway), do: Store.recall(gateway, {:bridge, :name})

  @doc false
  @spec note_name(Names.gateway(), String.t()) :: :ok
  def note_name(gateway, name), do: Store.remember(gateway, {:bridge, :name}, name)

  @doc false
  @spec note_off(Names.gateway()) :: :ok
  def note_off(gateway), do: Store.remember(gateway, {:bridge, :off}, true)

  @doc """
  The server's address for people and programs on this machine. That of the embedded server contains its login: show it
  in the terminal from which the gateway was started, and write it nowhere that others can read. Nil if there is no
  address.
  """
  @spec login_url(Names.gateway()) :: String.t() | nil
  def login_url(gateway) do
    case info(gateway) do
      %{mode: :embedded, server: %{status: :up} = server} -> Token.url(server)
      %{mode: :url, url: url} -> url
      _not_up -> nil
    end
  end

  @doc """
  The connection, for other users of NATS (commands, shadow), or nil if there is none now. Ask again after a `:bridge`
  message.
  """
  @spec connection(Names.gateway()) :: pid() | nil
  def connection(gateway) do
    with %{} = tables <- Tables.get(gateway), do: Map.get(Tables.info(tables, :connection), :conn)
  end

  @doc "The events of all vehicles from one time to another (unix microseconds), also of earlier runs."
  @spec past_events(Names.gateway(), from :: integer(), to :: integer()) :: History.t()
  def past_events(gateway, from, to) do
    subjects = "fleet.#{environment(gateway)}.*.event.>"
    History.read(gateway, if(off?(gateway), do: :off, else: {connection(gateway), subjects}), from, to)
  end

  @doc "The bridge's metrics, for `/metrics`; without samples while it does not run."
  @spec metrics(Names.gateway()) :: [Metrics.metric()]
  def metrics(gateway), do: Metrics.all(gateway, Tables.get(gateway))
end
