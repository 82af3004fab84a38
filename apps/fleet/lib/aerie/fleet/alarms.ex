defmodule Aerie.Fleet.Alarms do
  @moduledoc """
  Keeps a gateway's alarms, for all operators together. It looks at the snapshots when they have changed, at most twice
  a second, and handles events as they come. After a restart it begins with what the vehicles' detectors and the journal
  still have, and nothing is acknowledged.

  Pages are notified of a change by `{:notice, :console_alarms}` of `Aerie.Base.PubSub`, with the summary.
  """
  use GenServer

  alias Aerie.Base.{Names, Store}
  alias Aerie.Fleet
  alias Aerie.Fleet.Diagnosis
  alias Aerie.Vehicle.Events.Journal
  alias Aerie.Base.PubSub
  alias Aerie.Fleet.Alarms.{Conditions, Core, Detected}

  @look_ms 500
  # No notice announces a new diagnosis, or a problem of the gateway itself.
  @idle_ms 2_000
  # A gateway that starts is not connected to NATS at once, and that is not an alarm.
  @settle_us 10_000_000

  @type alarm :: Core.alarm()

  @doc "Whether it holds, is acknowledged, or is over."
  @spec state(alarm()) :: Core.state()
  defdelegate state(alarm), to: Core

  @doc "Options: `:gateway`; `:look_ms`, 500."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :console_alarms))

  @doc "All alarms in their order, and how many did not fit."
  @spec list(Names.gateway()) :: {[alarm()], non_neg_integer()}
  def list(gateway), do: read(gateway, :list, {[], 0})

  @doc "The summary for the header of the pages."
  @spec summary(Names.gateway()) :: Core.summary()
  def summary(gateway), do: read(gateway, :summary, Core.summary(Core.new()))

  defp read(gateway, what, absent),
    do: Names.read(gateway, :console_alarms, absent, &:ets.lookup_element(&1, what, 2, absent))

  @doc "Records that `by` has seen the alarms with these ids, or `:all`."
  @spec acknowledge(Names.gateway(), [String.t()] | :all, String.t()) :: :ok
  def acknowledge(gateway, ids, by),
    do: GenServer.call(Names.via(gateway, :console_alarms), {:acknowledge, ids, by})

  @impl GenServer
  def init(options) do
    gateway = options[:gateway]
    Process.set_label({:console_alarms, gateway})
    for topic <- [:vehicles, :links, :events], do: PubSub.subscribe(gateway, topic)
    table = :ets.new(:console_alarms, [:set, :protected, read_concurrency: true])
    Names.put_value(gateway, :console_alarms, table)
    detected = detected(gateway)

    alarms =
      for event <- Journal.recent(gateway, :all), reduce: Core.new() do
        alarms -> Detected.told(alarms, event, Map.get(detected, event.vehicle, []))
      end

    state = %{
      gateway: gateway,
      table: table,
      alarms: alarms,
      shown: nil,
      problem_since: System.os_time(:microsecond),
      timer: nil,
      look_ms: options[:look_ms] || @look_ms
    }

    {:ok, refresh(state)}
  end

  @impl GenServer
  def handle_call({:acknowledge, ids, by}, _from, state),
    do: {:reply, :ok, publish(%{state | alarms: Core.acknowledge(state.alarms, ids, by)})}

  @impl GenServer
  def handle_info({:fleet, :events, event}, state) do
    if Detected.about?(event) do
      detected = detected(state.gateway)
      alarms = Detected.told(state.alarms, event, Map.get(detected, event.vehicle, []))
      alarms = Detected.put(alarms, detected, Fleet.vehicles(state.gateway), System.os_time(:microsecond))
      {:noreply, publish(%{state | alarms: alarms})}
    else
      {:noreply, soon(state)}
    end
  end

  def handle_info({:fleet, _topic, _changed}, state), do: {:noreply, soon(state)}
  def handle_info(:look, state), do: {:noreply, refresh(state)}

  # Changes within `look_ms` of each other are handled together.
  defp soon(%{timer: {:idle, timer}} = state) do
    _ = Process.cancel_timer(timer)
    %{state | timer: {:soon, Process.send_after(self(), :look, state.look_ms)}}
  end

  defp soon(state), do: state

  defp refresh(%{gateway: gateway} = state) do
    now = System.os_time(:microsecond)
    state = %{state | problem_since: problem_since(state, now)}
    vehicles = Fleet.vehicles(gateway)
    links = gateway |> Store.links() |> Enum.flat_map(&Conditions.link/1)

    alarms =
      state.alarms
      |> Core.put(:vehicles, Enum.flat_map(vehicles, &Conditions.vehicle/1), now)
      |> Detected.put(detected(gateway), vehicles, now)
      |> Core.put(:links, links, now)
      |> Core.put(:gateway, own(gateway, now - state.problem_since > @settle_us), now)
      |> diagnosed(gateway, now)

    _ = with {_kind, timer} <- state.timer, do: Process.cancel_timer(timer)
    publish(%{state | alarms: alarms, timer: {:idle, Process.send_after(self(), :look, @idle_ms)}})
  end

  # What the detectors' committed states have, by vehicle.
  defp detected(gateway),
    do:
      for([id, conditions] <- Journal.states(gateway, %{conditions: :"$2"}), into: %{}, do: {id, conditions})

  # A diagnosis that does not answer changes nothing.
  defp diagnosed(alarms, gateway, now) do
    case Diagnosis.Server.fetch(gateway) do
      {:ok, conditions} -> Core.put(alarms, :diagnosis, Conditions.diagnosed(conditions), now)
      :error -> alarms
    end
  end

  defp own(gateway, settled?) do
    problem = problem(gateway)
    identity = MavRouter.Router.identity(gateway)
    Conditions.gateway(identity, if(settled?, do: problem), Aerie.Control.Policy.Audit.failing(gateway))
  end

  defp problem(gateway), do: with(%{problem: problem} <- Aerie.Fleet.Bridge.info(gateway), do: problem)

  # Since when events have not been stored, without a break.
  defp problem_since(%{problem_since: since, gateway: gateway}, now),
    do: if(problem(gateway) == nil, do: now, else: since)

  defp publish(%{alarms: alarms, shown: alarms} = state), do: state

  defp publish(%{alarms: alarms} = state) do
    summary = Core.summary(alarms)
    true = :ets.insert(state.table, list: {Core.list(alarms), alarms.dropped}, summary: summary)
    PubSub.publish(state.gateway, {:notice, :console_alarms}, summary)
    %{state | shown: alarms}
  end
end
