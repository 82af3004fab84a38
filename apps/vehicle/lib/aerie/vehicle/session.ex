defmodule Aerie.Vehicle.Session do
  @moduledoc """
  The process of one vehicle: receives its frames and carries out the actions of `Aerie.Vehicle.Session.Core`.

  The router sends `{:frames, link_id, [frame]}`, one message per read of a link, or `{:frames, {link_id, peer},
  [frame]}` while several endpoints of a link bring the system.

  Between frames time goes on by `Aerie.Vehicle.Session.Clock`: a vehicle is lost after the same silence whether its
  frames come from a radio or from a recording that is played ten times as fast. A recording that is played as fast as
  it can be read has no time between its frames until its end. When the machine's clock is set
  (`Aerie.Base.Timing.HostClock`; a companion computer without a battery-backed clock starts in another year), all times
  that the session keeps of a live vehicle move with it: nothing becomes older or newer, and no vehicle is lost by it.
  """
  use GenServer

  alias Aerie.Base.{Names, Store}
  alias Aerie.Base.Timing.HostClock
  alias Aerie.Vehicle
  alias Aerie.Vehicle.Events.Journal
  alias Aerie.Vehicle.Services.Links.HighLatency
  alias Aerie.Vehicle.Services.StreamDemand
  alias Aerie.Vehicle.Session.{ArmAuthorization, Capacity, Clock, Core, Output}
  alias MavRouter.Forward.GroundStations
  alias MavRouter.Identity

  @grid_ms 10
  @late 4
  @rest_ms 1_000
  @look_around_ms 1_000

  @spec start_link(gateway: Names.gateway(), options: Vehicle.Options.t()) :: GenServer.on_start()
  def start_link(arguments) do
    name = Names.via(arguments[:gateway], :session, arguments[:options].key)
    GenServer.start_link(__MODULE__, arguments, name: name)
  end

  @impl GenServer
  def init(gateway: gateway, options: options) do
    Process.set_label({:session, options.id})
    # A sender of frames may have cached that there is no session.
    Names.changed()
    snapshot = Store.vehicle(gateway, options.key)
    {core, []} = options |> Core.new(snapshot) |> count_vehicles(gateway)
    {link, speed} = recording(gateway, snapshot)

    state = %{
      gateway: gateway,
      options: options,
      core: core,
      clock: snapshot && Clock.new(snapshot.last_heard, monotonic(), speed),
      link: link,
      host: HostClock.offset(),
      live?: snapshot != nil and Enum.any?(snapshot.links, &(link_speed(gateway, &1) == :live)),
      speeds: %{},
      output: Output.new(gateway, options),
      events: nil,
      alone: nil,
      listeners: %{},
      obeyed: nil,
      ticks: 0
    }

    schedule_tick(state, 0)

    # A collision that the last session knew of has to be detected again.
    MavRouter.Routes.Collisions.put(gateway, options.key, [])
    # Newer frames may be in the mailbox already.
    {:ok, state, {:continue, {:first, MavRouter.Router.first_frames(gateway, options.key)}}}
  end

  @impl GenServer
  def handle_continue({:first, frames}, state) do
    state = demand(state, nil)
    if frames, do: handle_info(frames, state), else: {:noreply, state}
  end

  @impl GenServer
  def handle_info({:frames, _link, []}, state), do: {:noreply, state}

  def handle_info({:frames, path, frames}, state) do
    MavRouter.Recorder.vehicle_frames(state.gateway, state.options.key, frames)
    link = Vehicle.Collision.Owner.link(path)
    {speed, state} = speed(state, link)
    state = check_host_clock(%{state | live?: speed == :live, link: link})
    moment = monotonic()
    restarted? = Clock.restarted?(state.clock, speed, state.core.now, hd(frames).at, moment, state.host)
    state = if restarted?, do: step(state, {:rebase, hd(frames).at}), else: state
    clock = Clock.frame(List.last(frames).at, moment, speed)
    hand_over(state.listeners, frames)
    {:noreply, step(%{state | clock: clock}, {:frames, path, frames})}
  end

  def handle_info({:claimed, path, at}, state), do: {:noreply, step(state, {:claimed, path, at})}

  # A link on which the vehicle was heard is connected again.
  def handle_info({:link_reconnected, link}, state), do: {:noreply, step(state, {:link_reconnected, link})}

  def handle_info({:timeout, _timer, {:tick, due}}, state) do
    schedule_tick(state, monotonic() - due)
    handle_info({:tick, due}, state)
  end

  # Time as it was when the tick came: frames that wait behind it came later, so a busy process takes no vehicle for
  # lost.
  def handle_info({:tick, due}, state) do
    state = state |> check_host_clock() |> past_end()

    case Clock.expected(state.clock, due) do
      # Nothing was heard yet, so there is no time.
      nil -> {:noreply, state}
      now -> {:noreply, state |> step({:tick, now}) |> obeyed() |> look_around(now)}
    end
  end

  def handle_info({:demand, forwarded}, state), do: {:noreply, demand(state, forwarded)}

  # The vehicle's own event definitions.
  def handle_info({:event_definitions, definitions}, state),
    do: {:noreply, step(state, {:event_definitions, definitions})}

  # Another operator is in charge of the vehicle.
  def handle_info({:operator, fields}, state), do: {:noreply, step(state, {:operator, fields})}

  def handle_info({:high_latency, on?}, state) do
    target = {state.options.system_id, state.core.component || 1}
    message = HighLatency.control(target, on?)
    {:noreply, %{state | output: Output.send(state.output, message, state.core.version)}}
  end

  # The executor or the transfers want frames with these ids, texts, reports and reboots, and with `:snapshots` among
  # them those as well; nil: nothing any more.
  def handle_info({:listen, pid, ids}, state) do
    {monitor, _ids} = Map.get_lazy(state.listeners, pid, fn -> {Process.monitor(pid), nil} end)
    if ids == nil, do: Process.demonitor(monitor, [:flush])

    {:noreply,
     %{
       state
       | listeners:
           if(ids, do: Map.put(state.listeners, pid, {monitor, ids}), else: Map.delete(state.listeners, pid))
     }}
  end

  def handle_info({:DOWN, _monitor, :process, pid, _reason}, state),
    do: {:noreply, %{state | listeners: Map.delete(state.listeners, pid)}}

  # The executor asks the vehicle by commands that our requests for streams also use, and cannot tell the answers apart
  # (C8).
  def handle_info({:alone, pid, wanted?}, state),
    do: {:noreply, step(%{state | alone: if(wanted?, do: pid)}, {:hold_requests, wanted?})}

  def handle_info({:transmit, messages}, state) do
    version = state.core.version
    output = Enum.reduce(messages, state.output, &Output.send(&2, &1, version))
    {:noreply, %{state | output: output}}
  end

  def handle_info({:watchdog, watchdog, tag}, state) do
    Identity.Watchdog.answer(watchdog, tag)
    {:noreply, state}
  end

  defp hand_over(listeners, _frames) when listeners == %{}, do: :ok

  defp hand_over(listeners, frames) do
    for {pid, {_monitor, ids}} <- Map.to_list(listeners) do
      wanted = for frame <- frames, :lists.member(frame.id, ids), do: frame
      if wanted != [], do: send(pid, {:frames, wanted})
    end

    :ok
  end

  defp notify(%{listeners: listeners}, what),
    do: Enum.each(listeners, fn {pid, _wants} -> send(pid, what) end)

  # Not :timer.send_interval/2: all ticks would pass through its one process, a thousand a second for a hundred
  # vehicles. Those of all vehicles come at full hundredths of a second, so that they wake the machine a hundred times a
  # second, not ten times for each. After a tick that came late the next one waits four times as long: sessions that
  # cannot run leave the processor to frames.
  defp schedule_tick(state, late_us) do
    ms = max(tick_ms(state), min(@late * div(late_us, 1_000), @rest_ms))
    at = :erlang.monotonic_time(:millisecond) + ms
    at = at - Integer.mod(at, @grid_ms)
    :erlang.start_timer(at, self(), {:tick, at * 1_000}, abs: true)
  end

  defp tick_ms(state), do: div(Core.tick_us(state.core), 1_000)

  # At once when it changes, and once a second for a router that was restarted.
  defp obeyed(%{core: core, obeyed: told} = state) do
    ids = Core.obeyed(core)

    if ids != told or look_around?(state) do
      GroundStations.obeyed(state.gateway, state.options.key, ids)
      %{state | obeyed: ids}
    else
      state
    end
  end

  # Once a second: what other processes have written to the tables.
  defp look_around(state, _now) do
    if look_around?(state) do
      stations = GroundStations.list(state.gateway, state.options.network)
      {core, []} = Core.handle(state.core, {:stations, stations})
      {core, []} = count_vehicles(core, state.gateway)
      state = %{state | ticks: state.ticks + 1, core: core}
      if StreamDemand.sweep(state.gateway, state.options.key), do: demand(state, nil), else: state
    else
      %{state | ticks: state.ticks + 1}
    end
  end

  defp look_around?(%{ticks: ticks} = state), do: rem(ticks, div(@look_around_ms, tick_ms(state))) == 0

  defp count_vehicles(core, gateway),
    do: Core.handle(core, {:vehicles, Store.vehicle_count(gateway)})

  defp demand(state, forwarded) do
    merged = StreamDemand.merged(state.gateway, state.options.key)
    {core, []} = Core.handle(state.core, {:demand, merged, forwarded})
    %{state | core: core}
  end

  # How fast a link's time passes: `:live`, or the factor of a recording.
  defp speed(%{speeds: speeds} = state, link) when is_map_key(speeds, link), do: {speeds[link], state}

  defp speed(state, link) do
    case link_speed(state.gateway, link) do
      # A link may deliver its first frames just before it is in the store.
      :unknown -> {1.0, state}
      speed -> {speed, state |> put_in([:speeds, link], speed) |> configured(link)}
    end
  end

  defp link_speed(gateway, link) do
    case Store.link(gateway, link) do
      %{spec: %{recorded: true, speed: speed}} when is_number(speed) ->
        speed

      %{spec: %{recorded: true, speed: :max}, status: status} ->
        if status in [:down, :ended], do: 1.0, else: 0.0

      %{spec: %{recorded: true}} ->
        1.0

      %{} ->
        :live

      nil ->
        :unknown
    end
  end

  # The recording by which the last session heard the vehicle, and its speed; 1.0 without one.
  defp recording(_gateway, nil), do: {nil, 1.0}

  defp recording(gateway, %{links: links}) do
    Enum.find_value(links, {nil, 1.0}, fn link ->
      speed = link_speed(gateway, link)
      is_number(speed) && {link, speed}
    end)
  end

  # Time stands still between the frames of a recording that is read as fast as it can be, but not after its end: the
  # vehicle is lost then.
  defp past_end(%{clock: %{speed: speed} = clock, link: link} = state) when speed == 0 do
    if link_speed(state.gateway, link) == 0,
      do: state,
      else: %{state | clock: %{clock | moment: monotonic(), speed: 1.0}}
  end

  defp past_end(state), do: state

  defp configured(state, link) do
    configured = %{
      high_latency: HighLatency.link?(state.gateway, link),
      msp: match?(%{spec: %{kind: :msp}}, Store.link(state.gateway, link))
    }

    {core, []} = Core.handle(state.core, {:link, link, configured})
    %{state | core: core}
  end

  # The machine's clock may have been set since the last check.
  defp check_host_clock(state) do
    offset = HostClock.offset()
    shift(%{state | host: offset}, HostClock.step(state.host, offset))
  end

  defp shift(%{clock: %{} = clock, live?: true} = state, step) when step != 0,
    do: step(%{state | clock: %{clock | at: clock.at + step}}, {:shift, step})

  defp shift(state, _step), do: state

  defp step(state, event) do
    {core, actions} = Core.handle(state.core, event)
    %{state | core: core} |> act_all(actions) |> wake(actions) |> alone()
  end

  defp act_all(state, []), do: state
  defp act_all(state, [action | actions]), do: action |> act(state) |> act_all(actions)

  defp alone(%{alone: nil} = state), do: state

  defp alone(state) do
    if Core.Services.requests_held?(state.core) do
      send(state.alone, :alone)
      %{state | alone: nil}
    else
      state
    end
  end

  defp act({:snapshot, snapshot}, state) do
    key = state.options.key

    snapshot = %{
      snapshot
      | signing: MavRouter.Signing.vehicle(state.gateway, key),
        recording: MavRouter.Recorder.summary(state.gateway, {:vehicle, key})
    }

    Store.put_vehicle(state.gateway, key, snapshot)

    for {pid, {_monitor, ids}} <- Map.to_list(state.listeners),
        :lists.member(:snapshots, ids),
        do: send(pid, {:snapshot, snapshot})

    state
  end

  defp act({:observe, observation}, state) do
    case observation do
      %{kind: :reboot, boot_ms: boot_ms} -> notify(state, {:rebooted, boot_ms})
      # Whole, whatever chunks it came in (X2).
      %{kind: :text, data: text} -> notify(state, {:text, text})
      _other -> :ok
    end

    _dropped_and_counted_when_full = Journal.offer(state.gateway, state.options.id, observation)
    state
  end

  defp act({:reported, report}, state) do
    notify(state, {:reported, report})
    state
  end

  # Not for what is only a recording.
  defp act(:describe_events, state) do
    reader = state.live? && Names.whereis(state.gateway, :event_definitions, state.options.key)
    if reader, do: send(reader, :read)
    state
  end

  defp act({:publish, group, sample, at}, state) do
    Output.publish(state.output, group, sample, at)
    state
  end

  defp act({:send, message, version}, state) do
    %{state | output: Output.send(state.output, message, version, link(state.core))}
  end

  defp act({:send, message, version, link}, state) do
    %{state | output: Output.send(state.output, message, version, link)}
  end

  defp act({:authorise_arming, {system, component}}, state) do
    case Store.vehicle(state.gateway, state.options.key) do
      nil ->
        state

      snapshot ->
        decision = ArmAuthorization.decision(Vehicle.Settings.arming(state.gateway), state.gateway, snapshot)
        answers = ArmAuthorization.answers(decision, system, component)
        Enum.reduce(answers, state, &act({:send, &1, &2.core.version}, &2))
    end
  end

  defp act({:round_trip, link, us}, state) do
    MavRouter.Endpoints.Meter.note_rtt(state.gateway, link, us / 1000)
    state
  end

  defp act(:withhold, state) do
    Output.withhold(state.output)
    state
  end

  defp act({:heartbeat, version}, state) do
    %{state | output: Output.heartbeat(state.output, version, link(state.core))}
  end

  defp act({:other_vehicle, paths}, state) do
    MavRouter.Routes.Collisions.put(state.gateway, state.options.key, paths)
    state
  end

  defp act({:count, counter}, state) do
    Store.count(state.gateway, {:vehicle, state.options.id, counter})
    state
  end

  defp act({:status, old, new}, state) do
    metadata = %{gateway: state.gateway, vehicle: state.options.id, old: old, new: new}
    :telemetry.execute([:aerie, :vehicle, :status], %{count: 1}, metadata)
    Capacity.note(state.gateway, state.options.key, new)
    state
  end

  defp wake(state, actions) do
    if List.keymember?(actions, :observe, 0) do
      # Both restart together, so this pid stays valid.
      events = state.events || Names.whereis(state.gateway, :events, state.options.key)
      if events, do: Vehicle.Events.wake(events)
      %{state | events: events}
    else
      state
    end
  end

  defp link(core) do
    case Core.Services.link(core) do
      {:link, link} -> link
      _any_or_none -> nil
    end
  end

  defp monotonic, do: :erlang.monotonic_time(:microsecond)
end
