defmodule Aerie.Gateway do
  @moduledoc """
  One gateway: the supervisor of everything between its links and its NATS server.

  ```
  Aerie.Gateway                    rest_for_one
  ├─ Aerie.Store             owns the ETS read model and the journal of events
  ├─ Aerie.Store.PubSub            change notices, coalesced
  ├─ Aerie.Bridge.Memory           what the fleet was told last, over restarts
  ├─ Aerie.Bridge.Supervisor       NATS server (embedded mode), connection, outbox
  ├─ Aerie.Signing.Supervisor      keys, time stamps of signed links
  ├─ Aerie.Recorder.Supervisor     recordings of vehicles, the last moments of each
  ├─ Aerie.Router.Supervisor       routes, client endpoints
  ├─ Aerie.Vehicle.Supervisor      one tree per vehicle, made when its autopilot is first heard
  ├─ Aerie.Link.Supervisor         one tree per physical link
  └─ Aerie.Client.Supervisor       unix sockets of programs on this machine
  ```

  A child depends only on those before it, and a restart takes those after it along. What a restart costs:

  | child that dies    | what is lost                                                      | what goes on                  |
  |--------------------|-------------------------------------------------------------------|-------------------------------|
  | a vehicle's process | frames in its mailbox; state comes back from the store and wire  | every other vehicle, all links |
  | a link's process   | bytes in its socket buffer; vehicles stay, marked stale in time   | every other link, all vehicles |
  | Client.Supervisor  | the connections of its clients                                    | everything else                |
  | Link.Supervisor    | the same for all links                                            | vehicles, bridge, store        |
  | Vehicle.Supervisor | links reconnect; vehicles are rebuilt from the store              | router, bridge, store          |
  | Router.Supervisor  | learned routes, then as above                                     | bridge, store                  |
  | Recorder.Supervisor | rings, what was not written; then as above                      | signing, bridge, store         |
  | Signing.Supervisor | nothing: time stamps were stored; then as above                  | bridge, store                  |
  | Bridge.Supervisor  | nothing: unacknowledged events wait in the journal; then as above | store                          |
  | Bridge.Memory      | nothing: what it keeps is on the disk; then as above             | store                          |
  | PubSub             | notices of one tick, then as above                                | store                          |
  | Store              | the snapshots and the journal's unacknowledged events; then all   | nothing                        |

  The store therefore does nothing but own tables: it has no code that could fail on input.

  A gateway is addressed by its name everywhere: `Aerie.Store.vehicles(name)`. Tests give each their own
  (`make_ref()`), a node that runs only one uses `:default`.
  """
  use Supervisor

  alias Aerie.Names
  alias Aerie.RunningConfig
  alias Aerie.Successor

  @typedoc """
  * `:name` - any term, `:default` when absent
  * `:config` - an `%Aerie.Config{}`; required
  * `:pubsub_tick_ms` - how often change notices are sent at most, 100 when absent
  * `:without` - children that are left out, as modules: for a gateway that only has vehicles, say
  """
  @type option ::
          {:name, Names.gateway()}
          | {:config, term()}
          | {:pubsub_tick_ms, pos_integer()}
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

  @doc """
  The configuration a running gateway was started with, or nil when there is no such gateway. A `mavlink.system_id` that was
  to be found out is the one that was.
  """
  @spec config(Names.gateway()) :: term() | nil
  defdelegate config(gateway), to: RunningConfig, as: :of

  @doc """
  What the parts below are given of those above them, as options of all of them: each takes its own. The store keeps the
  `:tables` of the fleet, the router knows its `:vehicles`, the `:requests` for rates and the client endpoints (`:children`),
  signing who keeps `:events`, vehicles the `:fleet` that they tell what happens.
  """
  @spec plugs(term()) :: keyword()
  def plugs(config) do
    [
      tables: [Aerie.Fleet.Journal.table(config), Aerie.Fleet.Wants.table()],
      vehicles: Aerie.Vehicle.Supervisor,
      requests: Aerie.Vehicle.Streams,
      events: Aerie.Vehicle.Alarms,
      fleet: Aerie.Bridge,
      children: [Aerie.Link.Clients.Supervisor]
    ]
  end

  @doc "Ends a gateway: links first, then vehicles, router, bridge and store."
  @spec stop(Names.gateway()) :: :ok
  def stop(gateway), do: Supervisor.stop(Names.via(gateway, :gateway))

  @impl Supervisor
  def init(given) do
    name = Keyword.fetch!(given, :name)
    config = Keyword.fetch!(given, :config)
    options = [gateway: name, config: config] ++ plugs(config)
    Process.set_label({:gateway, name})
    Names.put_value(name, :gateway, config)
    without = Keyword.get(given, :without, [])

    children =
      [
        {Aerie.Store, options},
        {Aerie.Store.PubSub, options ++ tick(given)},
        {Aerie.Bridge.Memory, options},
        {Aerie.Bridge.Supervisor, options},
        {Aerie.Signing.Supervisor, options},
        {Aerie.Recorder.Supervisor, options},
        {Aerie.Router.Supervisor, options},
        {Aerie.Vehicle.Supervisor, options},
        {Aerie.Link.Supervisor, options},
        {Aerie.Client.Supervisor, options}
      ]
      |> Enum.filter(fn {module, _} -> module not in without end)
      |> Enum.map(&Successor.child_spec/1)

    # Any of these dying is rare and serious: three times within a minute means that starting again does not help.
    Supervisor.init(children, strategy: :rest_for_one, max_restarts: 3, max_seconds: 60)
  end

  defp tick(options) do
    case Keyword.fetch(options, :pubsub_tick_ms) do
      {:ok, tick_ms} -> [tick_ms: tick_ms]
      :error -> []
    end
  end
end
