defmodule Aerie.Bridge do
  @moduledoc """
  The gateway's side of the NATS contract: state and events of vehicles go out here.

  State is fire and forget with the last value kept while NATS is away. Events are taken from `Aerie.Fleet.Journal` and
  are published at least once, over restarts of NATS and of the gateway. See the README beside the code.

  Telemetry:

  | event | measurements | metadata |
  |---|---|---|
  | `[:aerie, :bridge, :server, :up]` | `restarts` | `gateway`, `url` |
  | `[:aerie, :bridge, :server, :down]` | `up_ms` | `gateway`, `status` (of the process) |
  | `[:aerie, :bridge, :connected]` | `count` (1) | `gateway`, `url` |
  | `[:aerie, :bridge, :disconnected]` | `up_ms` | `gateway`, `reason` (text) |
  | `[:aerie, :bridge, :events, :confirmed]` | `count` | `gateway` |
  """

  @behaviour Aerie.Vehicle.Fleet

  alias Aerie.Bridge.{Memory, Metrics, State, Tables, Token}
  alias Aerie.Names

  @typedoc """
  * `mode` - `:embedded` or `:url`
  * `connected` - whether there is a connection; `url` - to which server, or the embedded server's
  * `problem` - what keeps events from being stored by NATS, in words, or nil: whether the bridge does its work
  * `server` - embedded mode: `status` (`:starting | :up | :down | {:failed, text}`), `port`, `store_dir`, `restarts`, `fault`
    (why it stores nothing, or nil)
  * `streams` - what became of each stream, see `Aerie.Bridge.Streams`
  * `outbox` - `events`, `bytes`, `dropped`, `in_flight`, `problem` (of its disk: text or nil), `stalled_s` (for how long
    events have waited and none was confirmed) and `stalled` (that this is a problem: text or nil)
  """
  @type info :: %{
          mode: :embedded | :url,
          connected: boolean(),
          problem: String.t() | nil,
          url: String.t() | nil,
          server: map() | nil,
          streams: map(),
          outbox: map()
        }

  @doc """
  Publishes a state group of a vehicle, in the calling process but for the sending. Never waits for NATS.

  `map` is the group as in the vehicle's snapshot (`%{data: …, time_boot_ms: …}`) or just its data; `at` is in unix
  microseconds. Without a bridge it does nothing.
  """
  @impl Aerie.Vehicle.Fleet
  @spec publish_state(Names.gateway(), String.t(), atom(), map(), integer()) :: :ok
  defdelegate publish_state(gateway, vehicle, group, map, at), to: State, as: :put

  @doc "What the last life of the gateway told of a vehicle (`Aerie.Bridge.Memory`), or nil."
  @impl Aerie.Vehicle.Fleet
  @spec remembered(Names.gateway(), String.t()) :: Aerie.Vehicle.Detector.Found.t()
  defdelegate remembered(gateway, vehicle), to: Memory, as: :of

  @doc "How the bridge is, or nil when it is not running. Subscribers of `:bridge` are told of each change."
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
        streams: tables |> Tables.info(:streams) |> Map.get(:report, %{}),
        outbox: Tables.info(tables, :outbox)
      }
    end
  end

  @doc """
  The address for people and programs on this machine: of the embedded server with its login, which is for the terminal of
  whoever started it and for nothing that others can read. Nil when there is none to name.
  """
  @spec login_url(Names.gateway()) :: String.t() | nil
  def login_url(gateway) do
    case info(gateway) do
      %{mode: :embedded, server: %{status: :up} = server} -> Token.url(server)
      %{mode: :url, url: url} -> url
      _not_up -> nil
    end
  end

  @doc "The connection for other users of NATS (commands, shadow), or nil just now. Ask again after `{:bridge, …}` news."
  @spec connection(Names.gateway()) :: pid() | nil
  def connection(gateway) do
    with %{} = tables <- Tables.get(gateway), do: Map.get(Tables.info(tables, :connection), :conn)
  end

  @doc "The bridge's metrics, for `/metrics`."
  @spec metrics(Names.gateway()) :: [Metrics.metric()]
  def metrics(gateway) do
    case Tables.get(gateway) do
      nil -> []
      tables -> Metrics.all(gateway, tables)
    end
  end
end
