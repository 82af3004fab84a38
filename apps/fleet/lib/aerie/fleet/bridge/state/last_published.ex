defmodule Aerie.Fleet.Bridge.State.LastPublished do
  @moduledoc """
  Keeps on disk what was last published of each vehicle (mode, armed, in the air), so that a restarted gateway can
  detect what changed in between (`Aerie.Vehicle.Events.Detector.OfflineChanges`). It also keeps the epoch, a number
  that grows with each start; in one epoch a vehicle's `seq` grows by one from event to event.

  A vehicle's values are written when its events have left the journal, because then the stream or the outbox has them.
  So a transition whose event died with the gateway is found after the restart. One that was published in the last half
  second before a `kill -9` may be found again, marked as found. Every ten seconds the time is updated at which the
  values still held, in place and without a sync: a power cut may lose half a minute of it, and nothing else.

  The process looks half a second after a notice of the journal, and again while events wait; else every ten seconds.

  A vehicle that was not lost and is not heard again gives `link.lost`
  (`Aerie.Fleet.Bridge.State.LastPublished.Missing`).

  Each start gives an event `gateway.started`, under the gateway's own name. With `nats.mode: off` there is no file and
  no process: the start is reported, the epoch comes from the clock alone, and no offline changes are found.

  The file is `last/vehicles.json` in the outbox's folder. If it is damaged or missing, no offline changes are found.

  If another gateway has the folder (one that was killed and has not ended yet, or a second one by mistake), the lock is
  retried with back-off. Then what was published before the restart goes to detectors that are running already, and
  `gateway.started` waits up to ten seconds. A change that was published since the start is not published again as
  found.
  """
  # Its end writes to the disk.
  use GenServer, shutdown: 30_000

  alias Aerie.Base.Timing.Backoff
  alias Aerie.Vehicle.Events.Journal
  alias Aerie.Fleet.Bridge.State.LastPublished.File, as: Kept
  alias Aerie.Fleet.Bridge.State.LastPublished.Missing
  alias Aerie.Fleet.Bridge.Settings
  alias Aerie.Base.Files.FolderLock
  alias Aerie.Base.{Names, PubSub, Store}
  alias MavRouter.Identity
  alias Aerie.Vehicle.{Event, Events}
  alias Aerie.Vehicle.Events.Detector
  alias Aerie.Vehicle.Events.Detector.Observation

  require Logger

  @look_ms 500
  @refresh_ms 10_000
  @refresh_us @refresh_ms * 1_000
  @max_vehicles 4096
  @lock_min_ms 250
  @lock_max_ms 10_000
  @begin_ms 10_000
  # The value that an event published.
  @published %{
    "mode_change" => :mode,
    "armed" => :armed,
    "disarmed" => :armed,
    "takeoff" => :in_air,
    "landed" => :in_air
  }

  @doc "`:ignore` if the configuration has no NATS, like the bridge itself; the epoch begins all the same."
  @spec start_link(gateway: Names.gateway(), settings: Settings.t()) :: GenServer.on_start()
  def start_link(options) do
    settings = Keyword.fetch!(options, :settings)
    gateway = Keyword.fetch!(options, :gateway)

    if Settings.on?(settings) do
      GenServer.start_link(__MODULE__, options, name: Names.via(gateway, :bridge_last_published))
    else
      start = %{gateway: gateway, settings: settings, started_at: now(), former: Kept.none()}
      epoch(start)
      begin(start)
      :ignore
    end
  end

  @doc "The vehicle's state as published before the restart, or nil."
  @spec of(Names.gateway(), String.t()) :: Detector.OfflineChanges.t()
  def of(gateway, vehicle) do
    with %{} = remembered <- Names.value(gateway, :bridge_last_published), do: remembered[vehicle]
  end

  @doc "The name under which a gateway publishes its own events."
  @spec name(Identity.Settings.t()) :: String.t()
  def name(%Identity.Settings{vehicle_id: nil}) do
    {:ok, host} = :inet.gethostname()
    named(to_string(host))
  end

  def name(%Identity.Settings{vehicle_id: id}), do: named(id)

  # Names in subjects have at most 64 letters, digits, - and _.
  defp named(id), do: String.slice("gateway-" <> String.replace(id, ~r/[^A-Za-z0-9_-]/, "-"), 0, 64)

  @impl GenServer
  def init(options) do
    Process.flag(:trap_exit, true)
    gateway = options[:gateway]
    Process.set_label({:bridge_last_published, gateway})
    Logger.metadata(gateway: inspect(gateway))
    settings = options[:settings]

    state = %{
      gateway: gateway,
      settings: settings,
      started_at: now(),
      started: System.monotonic_time(:microsecond),
      dir: Path.join(Path.expand(settings.outbox.dir), "last"),
      file: nil,
      lock_failures: 0,
      former: Kept.none(),
      unheard: %{},
      epoch: nil,
      vehicles: %{},
      written_at: nil,
      problem: nil,
      timer: nil,
      waiting?: false
    }

    :ok = PubSub.subscribe(gateway, :journal)
    state = look_in(state, @look_ms)

    case FolderLock.acquire(state.dir) do
      :ok ->
        state = read(state)
        Names.put_value(gateway, :bridge_last_published, compared(state.former))
        state = %{state | epoch: epoch(state)}
        begin(state)
        # Written at once, so that the next epoch is greater, however short this one is.
        {:ok, write(state, now(), false)}

      {:error, text} ->
        Logger.error("changes during a restart will not be found until this is mended: #{text}")
        Process.send_after(self(), :begin, Keyword.get(options, :begin_ms, @begin_ms))
        {:ok, again(%{state | epoch: epoch(state)})}
    end
  end

  # State seen by this process is newer than the file.
  defp read(state) do
    file = Path.join(state.dir, "vehicles.json")
    former = Kept.read(file)

    %{
      state
      | file: file,
        former: former,
        unheard: Missing.new(former.vehicles),
        vehicles: Map.merge(former.vehicles, state.vehicles)
    }
  end

  defp compared(former), do: Map.new(former.vehicles, fn {id, known} -> {id, Map.delete(known, :lost)} end)

  defp again(%{lock_failures: failures} = state) do
    # The first wait would be zero, and nothing has changed yet.
    Process.send_after(self(), :lock, Backoff.wait(failures + 1, @lock_min_ms, @lock_max_ms))
    %{state | lock_failures: failures + 1}
  end

  # An epoch lasts as long as the store, which numbers the events.
  defp epoch(%{gateway: gateway, former: former}) do
    Journal.epoch(gateway, max(div(now(), 1000), (former.epoch || 0) + 1))
  end

  defp begin(%{former: former} = state) do
    name = name(state.settings.vehicle.identity)

    # Otherwise this process was restarted, and the gateway was not.
    if Journal.state(state.gateway, name) == nil do
      data = %{
        "version" => version(),
        "previous_epoch" => former.epoch,
        "ended" => if(former.epoch, do: if(former.ended, do: "orderly", else: "killed")),
        "vehicles" => Enum.sort(Map.keys(former.vehicles))
      }

      event = Event.new(name, "gateway.started", 1, state.started_at, nil, data)
      Journal.commit(state.gateway, name, :started, [event])
    end
  end

  defp version, do: :fleet |> Application.spec(:vsn) |> to_string()

  @impl GenServer
  def handle_info(:look, state) do
    up_us = System.monotonic_time(:microsecond) - state.started
    unheard = Missing.check(state.unheard, state.gateway, state.settings.vehicle, now(), up_us)
    {:noreply, again_later(check(%{state | unheard: unheard}))}
  end

  # Something was committed.
  def handle_info({:fleet, :journal, :pending}, state), do: {:noreply, look_in(state, @look_ms)}

  def handle_info(:lock, state) do
    case FolderLock.acquire(state.dir) do
      :ok -> {:noreply, late(state)}
      {:error, _text} -> {:noreply, again(state)}
    end
  end

  def handle_info(:begin, state) do
    begin(state)
    {:noreply, state}
  end

  def handle_info(_message, state), do: {:noreply, state}

  # A timer that fires earlier stays.
  defp look_in(%{timer: timer} = state, ms) do
    left = timer && Process.read_timer(timer)

    if is_integer(left) and left <= ms do
      state
    else
      _ = timer && Process.cancel_timer(timer)
      %{state | timer: Process.send_after(self(), :look, ms)}
    end
  end

  # Nobody tells when an acknowledgement comes, and when a vehicle has been missing for long enough.
  defp again_later(%{unheard: unheard, problem: nil, waiting?: false} = state) when unheard == %{},
    do: look_in(state, next_refresh(state))

  defp again_later(state), do: look_in(state, @look_ms)

  # Bounded, because the clock may have been set.
  defp next_refresh(%{written_at: nil}), do: @refresh_ms

  defp next_refresh(%{written_at: at}),
    do: div(at + @refresh_us - now(), 1_000) |> Kernel.+(1) |> max(@look_ms) |> min(@refresh_ms)

  defp late(state) do
    Logger.notice("changes during a restart will be found again: #{state.dir} is free")

    # The vehicles of the file get their time to be heard from now on, because another gateway has heard them until now.
    state = read(%{state | started: System.monotonic_time(:microsecond)})

    # The same epoch: only this process was restarted, and the file is its own.
    _ =
      if state.former.epoch != state.epoch,
        do: notify(state.gateway, compared(state.former), now())

    begin(state)
    # The next epoch must be greater than both.
    state = %{state | epoch: max(state.epoch, state.former.epoch || 0)}
    state |> check() |> write(now(), false)
  end

  # To the vehicles that are here, and to those that are heard from now on.
  defp notify(gateway, found, now) do
    here = Enum.filter(found, fn {id, _known} -> Journal.state(gateway, id) != nil end)
    Names.put_value(gateway, :bridge_last_published, found)
    Enum.each(here, fn {id, known} -> offer(gateway, id, known, now) end)

    for %{key: key} <- Store.vehicles(gateway),
        events when is_pid(events) <- [Names.whereis(gateway, :events, key)],
        do: Events.wake(events)

    :ok
  end

  defp offer(gateway, id, known, now) do
    published = for event <- Journal.recent(gateway, id), key = @published[event.type], do: key
    observation = Observation.new(:published, now, nil, Map.drop(known, published))
    _full = Journal.offer(gateway, id, observation)
  end

  @impl GenServer
  def terminate(_reason, state), do: state |> check() |> write(now(), true)

  defp check(state) do
    now = now()
    waiting = Journal.waiting(state.gateway)
    recorded = recorded(state.gateway)

    told =
      for [vehicle, last, found, lost] <- Journal.states(state.gateway, detectors()),
          vehicle not in waiting and vehicle not in recorded,
          known =
            last |> Map.take(Detector.OfflineChanges.keys()) |> Enum.into(Map.delete(found || %{}, :since)),
          known != %{},
          into: %{},
          do: {vehicle, kept(known, state.vehicles[vehicle], last, lost != false, now)}

    # Nothing newer is known of the others.
    former = Map.new(state.vehicles, fn {id, known} -> {id, Map.delete(known, :held)} end)
    vehicles = former |> Map.merge(told) |> bounded()
    state = %{state | waiting?: Enum.any?(waiting)}

    cond do
      state.written_at == nil or values(vehicles) != values(state.vehicles) ->
        write(%{state | vehicles: vehicles}, now, false)

      vehicles != state.vehicles and now - state.written_at >= @refresh_us ->
        refresh(%{state | vehicles: vehicles}, now)

      true ->
        state
    end
  end

  defp detectors, do: %{__struct__: Detector, last: :"$2", published: :"$3", lost: :"$4"}

  # The values of a vehicle that is lost, or that has sent none since the restart, hold as of the time it was heard.
  # Those of the others still hold (`held`).
  defp kept(known, before, last, lost, now) do
    same? = before != nil and map_size(Map.drop(before, [:since, :lost, :held])) == map_size(known)

    if same? and (lost or last == %{}),
      do: Map.merge(known, %{since: before.since, lost: lost}),
      else: Map.merge(known, %{since: now, lost: lost, held: true})
  end

  # Vehicles of recordings do not really fly.
  defp recorded(gateway) do
    replayed = for %{spec: %{recorded: true}, id: id} <- Store.links(gateway), do: id

    if replayed == [],
      do: [],
      else:
        for(
          %{links: [_ | _] = links, id: id} <- Store.vehicles(gateway),
          links -- replayed == [],
          do: id
        )
  end

  defp bounded(vehicles) when map_size(vehicles) <= @max_vehicles, do: vehicles

  defp bounded(vehicles) do
    vehicles |> Enum.sort_by(fn {_id, known} -> -known.since end) |> Enum.take(@max_vehicles) |> Map.new()
  end

  defp values(vehicles), do: Map.new(vehicles, fn {id, known} -> {id, Map.delete(known, :since)} end)

  defp refresh(%{file: file} = state, now) when file != nil do
    if Kept.hold(file, now) == :ok, do: %{state | written_at: now}, else: write(state, now, false)
  end

  defp refresh(state, now), do: %{state | written_at: now}

  defp write(%{file: nil} = state, now, _ended), do: %{state | written_at: now}

  defp write(state, now, ended) do
    case Kept.write(state.file, %{epoch: state.epoch, ended: ended, vehicles: state.vehicles}, now) do
      :ok -> %{state | written_at: now, problem: nil}
      {:error, reason} -> problem(state, reason)
    end
  end

  # Logged once; tried again at the next look.
  defp problem(%{problem: reason} = state, reason), do: state

  defp problem(state, reason) do
    Logger.error(
      "cannot write #{state.file}: #{:file.format_error(reason)}; changes during a restart will not be found"
    )

    %{state | problem: reason}
  end

  defp now, do: System.os_time(:microsecond)
end
