defmodule Aerie.Gateway do
  @moduledoc """
  One gateway: the supervisor of everything between its links and its NATS server.

  ```
  Aerie.Gateway                    rest_for_one
  ├─ Aerie.Base.Store             owns the ETS read model and the journal of events
  ├─ Aerie.Base.PubSub            change notices, coalesced
  ├─ Aerie.Fleet.Bridge.State.LastPublished      what was published last of each vehicle, over restarts
  ├─ Aerie.Fleet.Bridge.Supervisor       NATS server (embedded mode), connection, outbox
  ├─ MavRouter.Signing.Supervisor      keys, time stamps of signed links
  ├─ MavRouter.Recorder.Supervisor     recordings of vehicles, the last moments of each
  ├─ Aerie.Control.Policy.Store.Supervisor       the policy for commands, the audit log
  ├─ MavRouter.Router.Supervisor       routes, client endpoints
  ├─ Aerie.Vehicle.Supervisor      one tree per vehicle, made when its autopilot is first heard
  ├─ Aerie.Fleet.Remote.Supervisor       vehicles of other gateways, and telling them of ours
  ├─ Aerie.Control.Commands.Supervisor     commands: ledger, what is under way
  ├─ Aerie.Control.Params.Cache.Writer          lists of parameters, over restarts
  ├─ Aerie.Control.ReadCache.Supervisor      answers ground stations that read parameters and plans
  ├─ Aerie.Fleet.Shadow.Supervisor       desired states, which of several gateways acts
  ├─ Aerie.Fleet.Operations.Supervisor   one command or desired state for many vehicles
  ├─ MavRouter.Link.Supervisor         one tree per physical link
  ├─ Aerie.Fleet.Client.Supervisor       unix sockets of programs on this machine
  └─ Aerie.Fleet.Tracks.Server       where all vehicles were
  ```

  A child depends only on those before it, and a restart also restarts those after it. The app's README says what each
  restart costs.

  The store therefore does nothing but own tables: it has no code that could fail on input.

  The configuration ends here: each part gets the settings that it declares (`Aerie.Base.Settings`) and sees nothing
  else of it.

  A gateway is addressed by its name everywhere: `Aerie.Base.Store.vehicles(name)`. Tests give each their own
  (`make_ref()`), a node that runs only one uses `:default`.
  """
  use Supervisor

  alias Aerie.{Config, Fleet, Vehicle}
  alias Aerie.Base.Names
  alias Aerie.Base.Names.Successor
  alias Aerie.Control.{CommandExecutor, Commands, Params, Policy, ReadCache, TransferExecutor}
  alias Aerie.Fleet.{Bridge, Operations, Remote, Shadow}
  alias Aerie.Vehicle.Events.Journal
  alias Aerie.Vehicle.Services.StreamDemand
  alias MavRouter.{Link, Recorder, Router, Signing}

  alias MavRouter.Client

  @typedoc """
  * `:name` - any term, `:default` when absent
  * `:config` - an `%Aerie.Config{}`; required
  * `:pubsub_tick_ms` - the shortest time between change notices; `Aerie.Base.PubSub` has the default
  * `:read_config` - reads the configuration again, for `Aerie.Control.Policy.Store.reload/2`; without it only the fence
    file is read again
  * `:without` - children that are left out, as modules: for a gateway that only has vehicles, say
  """
  @type option ::
          {:name, Names.gateway()}
          | {:config, Config.t()}
          | {:pubsub_tick_ms, pos_integer()}
          | {:read_config, (-> {:ok, Config.t()} | {:error, [Config.Error.t()]})}
          | {:without, [module()]}

  @spec start_link([option()]) :: Supervisor.on_start()
  def start_link(options) do
    name = Keyword.get(options, :name, :default)
    Supervisor.start_link(__MODULE__, Keyword.put(options, :name, name), name: Names.via(name, :gateway))
  end

  @doc false
  def child_spec(options) do
    %{
      id: {__MODULE__, Keyword.get(options, :name, :default)},
      start: {__MODULE__, :start_link, [options]},
      type: :supervisor
    }
  end

  @doc "Ends a gateway: links first, then vehicles, router, bridge and store."
  @spec stop(Names.gateway()) :: :ok
  def stop(gateway), do: Supervisor.stop(Names.via(gateway, :gateway))

  @impl Supervisor
  def init(given) do
    name = Keyword.fetch!(given, :name)
    %Config{} = config = Keyword.fetch!(given, :config)
    Process.set_label({:gateway, name})
    without = Keyword.get(given, :without, [])

    children =
      for {module, options} <- parts(name, config, given[:read_config]),
          module not in without do
        tick = if module == Aerie.Base.PubSub, do: tick(given), else: []
        Successor.child_spec({module, [gateway: name] ++ options ++ tick})
      end

    # A part that fails at once each time ends the gateway, and then the VM, for the service manager to start them;
    # single deaths, even one of each part within a minute, do not.
    Supervisor.init(children, strategy: :rest_for_one, max_restarts: 10, max_seconds: 10)
  end

  @doc """
  The parts of a gateway in the order of their start, each with its options (but for `:gateway`): its settings, and what
  it needs of those above it. The store keeps the tables of the fleet; the router knows who takes in vehicles, who
  answers requests for rates and who decides about commands, and supervises the client endpoints; signing knows who
  keeps its events; vehicles know who hears what happens.
  """
  @spec parts(Names.gateway(), Config.t(), read | nil) :: [{module(), keyword()}]
        when read: (-> {:ok, Config.t()} | {:error, [Config.Error.t()]})
  def parts(name, config, read \\ nil) do
    read = read || fn -> {:ok, config} end
    bridge = %{Bridge.Settings.from(config) | port_given: Config.given?(config, "nats.port")}

    clients =
      Successor.child_spec({Client.Supervisor, gateway: name, settings: Client.Settings.from(config)})

    [
      {Aerie.Base.Store,
       counters: Aerie.Gateway.Counters.all(),
       tables: [
         Journal.table(bridge.fleet),
         StreamDemand.table(),
         Commands.Recent.table(),
         Policy.ControlLease.Holders.table(),
         Policy.Memory.ClientHistory.table()
         | Fleet.Parts.tables()
       ]},
      {Aerie.Base.PubSub, []},
      {Bridge.State.LastPublished, settings: bridge},
      {Bridge.Supervisor, settings: bridge},
      {Signing.Supervisor, settings: Signing.Settings.from(config), events: Vehicle.Events.External},
      {Recorder.Supervisor, settings: Recorder.Settings.from(config)},
      {Policy.Store.Supervisor,
       settings: Policy.Store.Settings.from(config), read: fn -> policy(read.()) end},
      {Router.Supervisor,
       settings: MavRouter.Router.Settings.from(config),
       vehicles: Vehicle.Supervisor,
       requests: Vehicle.Services.Streams,
       policy: Policy.Clients.MavlinkPolicy,
       readings: ReadCache,
       children: [clients]},
      {Vehicle.Supervisor,
       settings: Vehicle.Settings.from(config),
       publisher: Bridge,
       arming: Policy.Clients.Arming,
       loops: [CommandExecutor, TransferExecutor, Shadow.Loop, Params.Metadata.EventDefinitions]},
      {Remote.Supervisor, settings: Remote.Settings.from(config)},
      {Commands.Supervisor, settings: Commands.Settings.from(config), gateways: Remote},
      {Params.Cache.Writer, settings: Params.Cache.Settings.from(config)},
      {ReadCache.Supervisor, []},
      {Shadow.Supervisor, settings: Shadow.Settings.from(config)},
      {Operations.Supervisor, dir: Path.join(config.shadow.dir, "operations")},
      {Link.Supervisor, settings: Link.Settings.from(config)}
    ] ++ Fleet.Parts.last(config)
  end

  # Only the policy is read again; everything else of the configuration counts from the start on.
  defp policy({:ok, config}), do: {:ok, Map.from_struct(Policy.Store.Settings.from(config))}
  defp policy({:error, errors}), do: {:error, Enum.map(errors, &Config.Error.format/1)}

  defp tick(options) do
    case Keyword.fetch(options, :pubsub_tick_ms) do
      {:ok, tick_ms} -> [tick_ms: tick_ms]
      :error -> []
    end
  end
end
