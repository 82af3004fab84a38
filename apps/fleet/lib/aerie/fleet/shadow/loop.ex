defmodule Aerie.Fleet.Shadow.Loop do
  @moduledoc """
  The third loop of a vehicle's tree: compares the desired state with the vehicle, on every change and once a second, and acts.
  It runs `Aerie.Fleet.Shadow.Loop.Core` with a clock and the vehicle's snapshot, and carries out its actions.

  It wakes up for events of the vehicle (sent by `Aerie.Vehicle.Events`), for a new document, and once a second. Each attempt is a
  task; at most one of them changes the vehicle. The loop dies with the session and the event loop; a new one reads everything again,
  and the ledger knows a command that was under way.
  """
  use GenServer

  alias Aerie.Base.{Names, Store}
  alias Aerie.Base.Timing.HostClock
  alias Aerie.Control.Params.LongNames
  alias Aerie.Control.Policy
  alias Aerie.Vehicle.Events.Journal
  alias Aerie.Fleet.Bridge.State.LastPublished
  alias Aerie.Fleet.Shadow.{Documents, Metrics, Settings}
  alias Aerie.Fleet.Shadow.Document.Field
  alias Aerie.Fleet.Shadow.Loop.{Actuator, Core}
  alias Aerie.Fleet.Shadow.Document.Report

  @tick_ms 1_000
  # While nothing is desired of a vehicle, only its reported document is renewed from time to time.
  @idle_ticks 5
  # Changes that come together are handled together.
  @soon_ms 50

  @spec start_link(gateway: Names.gateway(), options: Aerie.Vehicle.Options.t()) :: GenServer.on_start()
  def start_link(arguments) do
    name = Names.via(arguments[:gateway], :shadow, arguments[:options].key)
    GenServer.start_link(__MODULE__, arguments, name: name)
  end

  @impl GenServer
  def init(gateway: gateway, options: options) do
    Process.set_label({:shadow, options.id})
    schedule()

    {:ok,
     %{
       gateway: gateway,
       vehicle: %{gateway: gateway, id: options.id, key: options.key, loop: self()},
       core: nil,
       settings: nil,
       name: nil,
       documents: nil,
       heard?: nil,
       tasks: %{},
       plans: %{},
       reported: nil,
       ticks: 0,
       looking: nil,
       clock: HostClock.offset()
     }, {:continue, :join}}
  end

  @impl GenServer
  def handle_continue(:join, state), do: {:noreply, join(state)}

  @impl GenServer
  def handle_info({:timeout, _timer, :tick}, state) do
    schedule()
    state = join(%{state | ticks: state.ticks + 1})
    idle? = state.core != nil and Core.idle?(state.core)
    {:noreply, if(idle? and rem(state.ticks, @idle_ticks) != 1, do: state, else: refresh(state))}
  end

  def handle_info({:desired, document}, %{core: %Core{} = core} = state),
    do: {:noreply, soon(%{state | core: Core.desired(core, document)})}

  # An event of the vehicle was committed.
  def handle_info(:changed, state), do: {:noreply, soon(state)}

  def handle_info({:timeout, timer, :look}, %{looking: timer} = state),
    do: {:noreply, refresh(%{state | looking: nil})}

  def handle_info({task, {:set, outcome}}, state) when is_map_key(state.tasks, task) do
    Process.demonitor(task, [:flush])
    {:noreply, ended(state, task, outcome)}
  end

  def handle_info({:DOWN, task, :process, _pid, _crash}, state) when is_map_key(state.tasks, task),
    do:
      {:noreply,
       ended(state, task, {:refused, "a fault of the gateway ended the try; the vehicle may have done it"})}

  def handle_info(_late, state), do: {:noreply, state}

  # `Documents` may have been restarted; without it there is no shadow.
  defp join(state) do
    case Names.whereis(state.gateway, :shadow_documents) do
      nil ->
        %{state | documents: nil}

      documents when documents == state.documents ->
        state

      documents ->
        %Settings{} = settings = Names.value(state.gateway, :shadow)
        Documents.join(documents, state.vehicle.id)
        name = LastPublished.name(settings.bridge.vehicle.identity)

        core =
          state.core ||
            Core.new(state.vehicle.id, Map.to_list(Map.take(settings, [:hold_us, :max_tries, :allow_arming])))

        contact(%{
          state
          | documents: documents,
            settings: settings,
            name: name,
            core: core,
            heard?: nil,
            reported: nil
        })
    end
  end

  defp soon(%{looking: nil} = state), do: %{state | looking: :erlang.start_timer(@soon_ms, self(), :look)}
  defp soon(state), do: state

  defp refresh(%{documents: nil} = state), do: state

  defp refresh(state) do
    case Store.vehicle(state.gateway, state.vehicle.key) do
      nil -> state
      snapshot -> state |> note_contact(snapshot.status != :lost) |> refresh(snapshot)
    end
  end

  # At once: until then nobody knows which gateway may command the vehicle.
  defp contact(state) do
    case Store.vehicle(state.gateway, state.vehicle.key) do
      nil -> state
      snapshot -> note_contact(state, snapshot.status != :lost)
    end
  end

  defp note_contact(%{heard?: heard?} = state, heard?), do: state

  defp note_contact(state, heard?) do
    Documents.vehicle_heard(state.documents, state.vehicle.id, heard?)
    %{state | heard?: heard?}
  end

  defp refresh(state, snapshot) do
    %{gateway: gateway, vehicle: %{id: id}} = state = clock(state)

    commanded = Policy.Memory.RecentCommands.last(gateway, id)
    state = %{state | plans: still_known(state.plans, commanded, snapshot)}
    beside = beside(state)

    view = %{
      now: System.os_time(:microsecond),
      snapshot: snapshot,
      commanded: commanded,
      holds: holds(state, snapshot),
      beside: beside
    }

    if state.core.document.fields != %{}, do: Metrics.count(gateway, :reconciliations)
    {core, actions} = Core.compare(state.core, view)
    actions |> Enum.reduce(%{state | core: core}, &act/2) |> report(snapshot, beside)
  end

  # Set forward, it must end no hold early, and set back, make none longer.
  defp clock(state) do
    offset = HostClock.offset()
    step = HostClock.step(state.clock, offset)
    plans = Map.new(state.plans, fn {path, known} -> {path, %{known | at: known.at + step}} end)
    %{state | clock: offset, core: Core.clock_set(state.core, step), plans: plans}
  end

  # Parameters as PARAM_VALUE last reported them.
  defp beside(%{gateway: gateway, vehicle: vehicle} = state) do
    for {"params." <> name = path, _entry} <- state.core.document.fields,
        {:ok, value} when is_number(value) <- [known(gateway, vehicle.id, name)],
        into: Map.new(state.plans, fn {path, known} -> {path, known.hash} end),
        do: {path, value}
  end

  # A long name that no table has came as MAVLink has it.
  defp known(gateway, id, name) do
    with :error <- Journal.param(gateway, id, name), do: Journal.param(gateway, id, LongNames.wire(name))
  end

  # A plan that was read stays valid until somebody commands the vehicle, and may send another plan, or it restarts.
  defp still_known(plans, commanded, snapshot) do
    boot_ms = snapshot.time_boot_ms || 0

    Map.filter(plans, fn {_path, known} ->
      (commanded == nil or commanded.at < known.at) and
        (boot_ms >= known.boot_ms or MavCodec.Message.BootClock.wrapped?(known.boot_ms, boot_ms))
    end)
  end

  defp holds(state, snapshot) do
    disabled =
      if state.settings.enabled,
        do: [],
        else: [%{by: "configuration", until: nil, why: "shadow.enabled is false"}]

    recorded =
      if Enum.any?(snapshot.links, &match?(%{spec: %{recorded: true}}, Store.link(state.gateway, &1))),
        do: [%{by: "recording", until: nil, why: "it is a vehicle of a recording"}],
        else: []

    other =
      case Documents.authority(state.gateway, state.vehicle.id) do
        :mine -> []
        {:held, by, why} -> [%{by: by, until: nil, why: why}]
      end

    in_charge =
      case Policy.ControlLease.Holders.of(state.gateway, state.vehicle.key) do
        %{holder: holder} when holder != "shadow" ->
          [%{by: "lease", until: nil, why: "#{holder} is in charge of it"}]

        _nobody ->
          []
      end

    disabled ++ recorded ++ other ++ in_charge
  end

  defp act({:set, path, version, value}, state) do
    Metrics.count(state.gateway, :commands_issued)
    vehicle = state.vehicle
    tasks = Names.via(state.gateway, :shadow_tasks)
    task = Task.Supervisor.async_nolink(tasks, fn -> {:set, Actuator.set(vehicle, path, value)} end)
    %{state | tasks: Map.put(state.tasks, task.ref, {path, version, value})}
  end

  defp act({:withdraw, path}, state) do
    Actuator.withdraw(state.vehicle, path)
    state
  end

  defp act({:report, _report}, state), do: state

  defp ended(state, task, outcome) do
    {{path, version, value}, tasks} = Map.pop!(state.tasks, task)
    core = Core.done(state.core, path, version, outcome, System.os_time(:microsecond))
    {name, reason} = with {:refused, reason} <- outcome, do: {:refused, reason}, else: (:done -> {:done, nil})

    :telemetry.execute([:aerie, :shadow, :set], %{count: 1}, %{
      gateway: state.gateway,
      vehicle: state.vehicle.id,
      field: Field.fetch!(path).name,
      outcome: name,
      reason: reason
    })

    soon(found(%{state | tasks: tasks, core: core}, path, value, outcome))
  end

  defp found(state, path, hash, :done) when path in ["mission.plan", "geofence.plan"] do
    boot_ms =
      with %{time_boot_ms: ms} when is_integer(ms) <- Store.vehicle(state.gateway, state.vehicle.key),
           do: ms,
           else: (_unknown -> 0)

    put_in(state.plans[path], %{hash: hash, at: System.os_time(:microsecond), boot_ms: boot_ms})
  end

  defp found(state, _path, _value, _outcome), do: state

  # Only on a change. `Documents` publishes it.
  defp report(state, snapshot, beside) do
    case Report.document(snapshot, state.core, beside, state.name) do
      reported when reported == state.reported ->
        state

      reported ->
        {published, omitted} = Report.bounded(stamped(reported))
        if omitted > 0, do: Metrics.count(state.gateway, :reports_shortened)
        Documents.report(state.documents, state.vehicle.id, state.core.report, published)
        %{state | reported: reported}
    end
  end

  defp stamped(reported),
    do: Map.put(reported, "at", DateTime.to_iso8601(DateTime.utc_now(:millisecond)))

  defp schedule, do: :erlang.start_timer(@tick_ms, self(), :tick)
end
