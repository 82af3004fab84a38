defmodule Aerie.Fleet.Bridge.Supervisor do
  @moduledoc """
  The bridge's processes, each depending on those before it (`rest_for_one`).

  | child | what its crash costs |
  |---|---|
  | `Tables` | counters and last values; then all below |
  | `NatsServer` (embedded mode) | the server ends with it and comes back with its data; then all below |
  | `Connection` | the connection; events in flight are sent again |
  | `State` | nothing: last values are in the tables |
  | `Events` | events in flight are sent again; their ids make that harmless |
  | `EventStreams` (hub) | new vehicles' events wait for their stream |
  | `Forward` (leaf node) | events in flight to the hub are sent again |
  | `Commands` | answers to commands under way; the commands go on |
  """
  use Supervisor

  alias Aerie.Fleet.Bridge.{Commands, Connection, Events, Forward, Leaf, NatsServer, Settings, State}
  alias Aerie.Fleet.Bridge.State.LastPublished
  alias Aerie.Fleet.Bridge.Status.Tables
  alias Aerie.Fleet.Bridge.Events.VehicleStreams

  alias Aerie.Base.Names
  alias Aerie.Fleet.Bridge

  @doc "`:ignore` if there is no NATS (`nats.mode: off`)."
  @spec start_link(gateway: Names.gateway(), settings: Settings.t()) :: Supervisor.on_start()
  def start_link(options) do
    Bridge.note_environment(options[:gateway], options[:settings].environment)
    Bridge.note_name(options[:gateway], LastPublished.name(options[:settings].vehicle.identity))

    if Settings.on?(Keyword.fetch!(options, :settings)) do
      Supervisor.start_link(__MODULE__, options, name: Names.via(options[:gateway], :bridge))
    else
      Bridge.note_off(options[:gateway])
      :ignore
    end
  end

  @impl Supervisor
  def init(options) do
    Process.set_label({:bridge, options[:gateway]})
    nats = options[:settings].nats
    server = if nats.mode == :embedded, do: [{NatsServer, options}], else: []
    forward = if Leaf.Config.on?(nats.leaf), do: [{Forward, options}], else: []

    apart = if nats.streams.events_per_vehicle, do: [{VehicleStreams, options}], else: []

    children =
      [{Tables, gateway: options[:gateway]}] ++
        server ++
        [{Connection, options}, {State, options}, {Events, options}] ++
        apart ++ forward ++ [{Commands, options}]

    # The children handle a misbehaving server with pauses of their own; this limits unforeseen crashes.
    Supervisor.init(children, strategy: :rest_for_one, max_restarts: 10, max_seconds: 30)
  end
end
