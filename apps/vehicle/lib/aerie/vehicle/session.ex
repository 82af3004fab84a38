defmodule Aerie.Vehicle.Session do
  @moduledoc """
  The process of one vehicle: takes its frames and carries out what `Aerie.Vehicle.Core` says.

  Who has frames of the vehicle sends `{:frames, link_id, [frame]}`, one message per read of a link, or
  `{:frames, {link_id, peer}, [frame]}` while the system is heard by several endpoints.

  The time between frames is the time of the last one plus what has passed since by the monotonic clock, at the pace of the
  link: a vehicle is missed after the same silence whether its frames come from a radio or from a recording played ten
  times as fast. When the machine's clock is set (`Aerie.HostClock`; a companion computer without a battery-backed clock
  starts in another year), all that the session knows of a live vehicle moves with it: nothing becomes older or newer by
  that, and no vehicle is lost or kept.
  """
  use GenServer

  alias Aerie.{Fleet, HostClock, Identity, Names, Store, Vehicle}
  alias Aerie.Router.Stations

  @tick_ms 100
  @set_us 3_000_000
  @look_ticks 10

  @spec start_link(gateway: Names.gateway(), options: Vehicle.Options.t()) :: GenServer.on_start()
  def start_link(arguments) do
    name = Names.via(arguments[:gateway], :session, arguments[:options].key)
    GenServer.start_link(__MODULE__, arguments, name: name)
  end

  @impl GenServer
  def init(gateway: gateway, options: options) do
    Process.set_label({:session, options.id})
    # Whoever has frames of the vehicle may remember that there is no session.
    Names.changed()
    snapshot = Store.vehicle(gateway, options.key)
    again()

    state = %{
      gateway: gateway,
      options: options,
      core: Vehicle.Core.new(options, snapshot),
      clock: snapshot && {snapshot.last_heard, monotonic(), 1.0},
      host: HostClock.offset(),
      live?: snapshot != nil and Enum.any?(snapshot.links, &(speed(gateway, &1) == :live)),
      paces: %{},
      outbound: Vehicle.Outbound.new(gateway, options),
      events: nil,
      ticks: 0
    }

    # What a forerunner found out is to be found out again.
    Aerie.Router.Apart.put(gateway, options.key, [])
    {:ok, state, {:continue, :wants}}
  end

  @impl GenServer
  def handle_continue(:wants, state), do: {:noreply, wants(state, nil)}

  @impl GenServer
  def handle_info({:frames, _link, []}, state), do: {:noreply, state}

  def handle_info({:frames, way, frames}, state) do
    link = if is_tuple(way), do: elem(way, 0), else: way
    Aerie.Recorder.vehicle_frames(state.gateway, state.options.key, frames)
    {pace, state} = pace(state, link)
    state = set(%{state | live?: pace == :live})
    state = if pace == :live, do: follow(state, hd(frames).at), else: state
    clock = {List.last(frames).at, monotonic(), if(pace == :live, do: 1.0, else: pace)}
    {:noreply, step(%{state | clock: clock}, {:frames, way, frames})}
  end

  # A link on which it was heard is connected again (`Aerie.Link.Again`).
  def handle_info({:link_again, link}, state), do: {:noreply, step(state, {:link_again, link})}

  def handle_info({:timeout, _timer, :tick}, state) do
    again()
    handle_info(:tick, state)
  end

  def handle_info(:tick, state) do
    state = set(state)

    case expected(state.clock) do
      # Nothing heard yet: there is no time to go by.
      nil -> {:noreply, state}
      now -> {:noreply, state |> step({:tick, now}) |> look_around(now)}
    end
  end

  def handle_info({:wants, forwarded}, state), do: {:noreply, wants(state, forwarded)}

  def handle_info({:high_latency, on?}, state) do
    target = {state.options.system_id, state.core.component || 1}
    message = Vehicle.HighLatency.control(target, on?)
    {:noreply, %{state | outbound: Vehicle.Outbound.send(state.outbound, message, state.core.version)}}
  end

  def handle_info({:pulse, pulse, tag}, state) do
    Identity.Pulse.answer(pulse, tag)
    {:noreply, state}
  end

  # A timer of its own each time: an interval's ticks would all pass by one process, a thousand a second for a hundred
  # vehicles.
  defp again, do: :erlang.start_timer(@tick_ms, self(), :tick)

  # What others have written down since, once a second.
  defp look_around(%{ticks: ticks} = state, _now) when rem(ticks, @look_ticks) != 0,
    do: %{state | ticks: ticks + 1}

  defp look_around(state, _now) do
    stations = Stations.list(state.gateway, state.options.network)
    {core, []} = Vehicle.Core.handle(state.core, {:stations, stations})
    state = %{state | ticks: state.ticks + 1, core: core}
    if Fleet.Wants.sweep(state.gateway, state.options.key), do: wants(state, nil), else: state
  end

  defp wants(state, forwarded) do
    merged = Fleet.Wants.merged(state.gateway, state.options.key)
    {core, []} = Vehicle.Core.handle(state.core, {:wants, merged, forwarded})
    %{state | core: core}
  end

  # How fast a link's time passes: `:live`, or the factor of a recording.
  defp pace(%{paces: paces} = state, link) when is_map_key(paces, link), do: {Map.fetch!(paces, link), state}

  defp pace(state, link) do
    pace = speed(state.gateway, link)
    # A link is known by the first frame that it delivers, but for its first moment.
    if pace == :unknown, do: {1.0, state}, else: {pace, state |> put_in([:paces, link], pace) |> marked(link)}
  end

  defp speed(gateway, link) do
    case Store.link(gateway, link) do
      %{kind: :replay, spec: %{speed: speed}} when is_number(speed) -> speed
      %{kind: :replay} -> 1.0
      %{} -> :live
      nil -> :unknown
    end
  end

  defp marked(state, link) do
    what = %{high_latency: Vehicle.HighLatency.link?(state.gateway, link)}
    {core, []} = Vehicle.Core.handle(state.core, {:link, link, what})
    %{state | core: core}
  end

  # Whether the machine's clock was set since the last look.
  defp set(state) do
    offset = HostClock.offset()
    moved(%{state | host: offset}, HostClock.step(state.host, offset))
  end

  defp moved(%{clock: {at, then, pace}, live?: true} = state, step) when step != 0,
    do: step(%{state | clock: {at + step, then, pace}}, {:shift, step})

  defp moved(state, _step), do: state

  # A live frame's time is not about the time that it is: two links disagree, or the process slept. Frames that waited in
  # the mailbox are older, but not by seconds.
  defp follow(state, at) do
    expected = expected(state.clock)
    if expected != nil and abs(at - expected) > @set_us, do: step(state, {:rebase, at}), else: state
  end

  defp expected(nil), do: nil
  defp expected({at, then, pace}), do: at + round((monotonic() - then) * pace)

  defp step(state, event) do
    {core, actions} = Vehicle.Core.handle(state.core, event)
    state = Enum.reduce(actions, %{state | core: core}, &act/2)
    wake(state, actions)
  end

  defp act({:snapshot, snapshot}, state) do
    key = state.options.key

    snapshot =
      Map.merge(snapshot, %{
        signing: Aerie.Signing.vehicle(state.gateway, key),
        recording: Aerie.Recorder.shown(state.gateway, {:vehicle, key})
      })

    Store.put_vehicle(state.gateway, key, snapshot)
    state
  end

  defp act({:observe, observation}, state) do
    _dropped_and_counted_when_full = Fleet.Journal.offer(state.gateway, state.options.id, observation)
    state
  end

  defp act({:publish, group, sample, at}, state) do
    Vehicle.Outbound.publish(state.outbound, group, sample, at)
    state
  end

  defp act({:send, message, version}, state) do
    %{state | outbound: Vehicle.Outbound.send(state.outbound, message, version, by(state.core))}
  end

  defp act({:send, message, version, link}, state) do
    %{state | outbound: Vehicle.Outbound.send(state.outbound, message, version, link)}
  end

  defp act({:round_trip, link, us}, state) do
    Aerie.Router.Meter.note_rtt(state.gateway, link, us / 1000)
    state
  end

  defp act(:withhold, state) do
    Vehicle.Outbound.withhold(state.outbound)
    state
  end

  defp act({:heartbeat, version}, state) do
    %{
      state
      | outbound: Vehicle.Outbound.heartbeat(state.outbound, version, by(state.core))
    }
  end

  defp act({:apart, ways}, state) do
    Aerie.Router.Apart.put(state.gateway, state.options.key, ways)
    state
  end

  defp act({:count, counter}, state) do
    Store.count(state.gateway, {:vehicle, state.options.id, counter})
    state
  end

  defp act({:status, old, new}, state) do
    metadata = %{gateway: state.gateway, vehicle: state.options.id, old: old, new: new}
    :telemetry.execute([:aerie, :vehicle, :status], %{count: 1}, metadata)
    Vehicle.Places.note(state.gateway, state.options.key, new)
    state
  end

  defp wake(state, actions) do
    if Enum.any?(actions, &match?({:observe, _observation}, &1)) do
      # Both restart together, so the one found first stays the right one.
      events = state.events || Names.whereis(state.gateway, :events, state.options.key)
      if events, do: Vehicle.Events.wake(events)
      %{state | events: events}
    else
      state
    end
  end

  defp by(core) do
    case Vehicle.Core.Dealings.way(core) do
      {:link, link} -> link
      _whichever -> nil
    end
  end

  defp monotonic, do: System.monotonic_time(:microsecond)
end
