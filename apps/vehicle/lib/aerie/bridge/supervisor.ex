defmodule Aerie.Bridge.Supervisor do
  @moduledoc """
  The bridge's processes, each depending on those before it (`rest_for_one`).

  | child | what its end costs |
  |---|---|
  | `Tables` | counters and last values; then all below |
  | `Server` (embedded mode) | the server ends with it and comes back with its data; then all below |
  | `Connection` | the connection; events in flight are sent again |
  | `State` | nothing: last values are in the tables |
  | `Events` | events in flight are sent again, their ids make that harmless |
  """
  use Supervisor

  alias Aerie.Bridge.{Connection, Events, Server, State, Tables}
  alias Aerie.{Config, Names}

  @doc "`:ignore` when the configuration has no NATS (`nats.mode: off`, or no such section): there is nothing to bridge to."
  @spec start_link(gateway: Names.gateway(), config: Config.t() | map()) :: Supervisor.on_start()
  def start_link(options) do
    case options[:config] do
      %Config{nats: %{mode: mode}} when mode in [:embedded, :url] ->
        Supervisor.start_link(__MODULE__, options, name: Names.via(options[:gateway], :bridge))

      _without ->
        :ignore
    end
  end

  @impl Supervisor
  def init(options) do
    Process.set_label({:bridge, options[:gateway]})
    children = if options[:config].nats.mode == :embedded, do: [{Server, options}], else: []

    children =
      [{Tables, gateway: options[:gateway]}] ++
        children ++
        [{Connection, options}, {State, options}, {Events, options}]

    # A client or server that misbehaves is met with pauses of its own; this bounds what nobody thought of.
    Supervisor.init(children, strategy: :rest_for_one, max_restarts: 10, max_seconds: 30)
  end
end
