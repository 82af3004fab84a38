defmodule Aerie.Bridge.Memory do
  @moduledoc """
  What the fleet was told last of each vehicle (mode, armed, in the air), kept on disk, so that the gateway's next life can tell
  what changed in between (`Aerie.Vehicle.Detector.Found`); and the epoch, the number of this life.

  A vehicle's values are kept when its events have left the journal: the stream or the outbox has them. So a transition whose
  event died with the gateway is found by the next one, and one that was told in the last half second before a `kill -9` may be
  found again, marked as found. Every ten seconds the time is kept too at which what is kept still held.

  A vehicle that was not lost then and is not heard again is told as lost (`Aerie.Bridge.Memory.Unheard`).

  Its start is an event, `gateway.started`, under the gateway's own name. The epoch is a number that grows with each start;
  in one epoch a vehicle's `seq` grows by one from event to event.

  The file is `last/vehicles.json` in the outbox's folder. One that is damaged or missing costs what could have been found.
  """
  use GenServer

  alias Aerie.Bridge.FolderLock
  alias Aerie.Bridge.Memory.File, as: Kept
  alias Aerie.Bridge.Memory.Unheard
  alias Aerie.{Config, Fleet, Names, Store}
  alias Aerie.Vehicle.{Detector, Event}

  require Logger

  @look_ms 500
  @refresh_us 10_000_000
  @max_vehicles 4096

  @doc "`:ignore` when the configuration has no NATS, as for the bridge itself: nobody is told anything."
  @spec start_link(gateway: Names.gateway(), config: Config.t() | map()) :: GenServer.on_start()
  def start_link(options) do
    case options[:config] do
      %Config{nats: %{mode: mode}} when mode in [:embedded, :url] ->
        GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :bridge_memory))

      _without ->
        :ignore
    end
  end

  @doc "What the last life told of a vehicle, or nil."
  @spec of(Names.gateway(), String.t()) :: Detector.Found.t()
  def of(gateway, vehicle) do
    with %{} = remembered <- Names.value(gateway, :bridge_memory), do: remembered[vehicle]
  end

  @doc "The name under which a gateway has events of its own."
  @spec name(Config.t()) :: String.t()
  def name(%Config{vehicle_id: nil}) do
    {:ok, host} = :inet.gethostname()
    named(to_string(host))
  end

  def name(%Config{vehicle_id: id}), do: named(id)

  # Names in subjects have 64 letters, digits, - and _ at most.
  defp named(id), do: String.slice("gateway-" <> String.replace(id, ~r/[^A-Za-z0-9_-]/, "-"), 0, 64)

  @impl GenServer
  def init(options) do
    Process.flag(:trap_exit, true)
    gateway = options[:gateway]
    Process.set_label({:bridge_memory, gateway})
    Logger.metadata(gateway: inspect(gateway))
    dir = Path.join(Path.expand(options[:config].outbox.dir), "last")
    locked = FolderLock.acquire(dir)
    file = if locked == :ok, do: Path.join(dir, "vehicles.json")
    with {:error, text} <- locked, do: Logger.error("what is known of vehicles is not kept: #{text}")
    former = Kept.read(file)
    found = Map.new(former.vehicles, fn {id, known} -> {id, Map.delete(known, :lost)} end)
    Names.put_value(gateway, :bridge_memory, found)

    state = %{
      gateway: gateway,
      config: options[:config],
      started: System.monotonic_time(:microsecond),
      unheard: Unheard.new(former.vehicles),
      file: file,
      epoch: epoch(gateway, former),
      vehicles: former.vehicles,
      written_at: nil,
      problem: nil
    }

    begin(state, options[:config], former)
    Process.send_after(self(), :look, @look_ms)
    # Written at once: the next life has a greater number, however short this one is.
    {:ok, write(state, now(), false)}
  end

  # A life is that of the store, in which the events are numbered.
  defp epoch(gateway, former) do
    Fleet.Journal.epoch(gateway, max(div(now(), 1000), (former.epoch || 0) + 1))
  end

  defp begin(state, config, former) do
    name = name(config)

    # Nil: this is not the first of these processes in this life.
    if Fleet.Journal.state(state.gateway, name) == nil do
      data = %{
        "version" => version(),
        "previous_epoch" => former.epoch,
        "ended" => if(former.epoch, do: if(former.ended, do: "orderly", else: "killed")),
        "vehicles" => Enum.sort(Map.keys(former.vehicles))
      }

      event = Event.new(name, "gateway.started", 1, now(), nil, data)
      Fleet.Journal.commit(state.gateway, name, :started, [event])
    end
  end

  defp version, do: :vehicle |> Application.spec(:vsn) |> to_string()

  @impl GenServer
  def handle_info(:look, state) do
    Process.send_after(self(), :look, @look_ms)
    up_us = System.monotonic_time(:microsecond) - state.started
    unheard = Unheard.look(state.unheard, state.gateway, state.config, now(), up_us)
    {:noreply, look(%{state | unheard: unheard})}
  end

  def handle_info(_message, state), do: {:noreply, state}

  @impl GenServer
  def terminate(_reason, state), do: state |> look() |> write(now(), true)

  defp look(state) do
    now = now()
    waiting = Fleet.Journal.waiting(state.gateway)
    recorded = recorded(state.gateway)

    told =
      for [vehicle, last, found, lost] <- Fleet.Journal.states(state.gateway, detectors()),
          vehicle not in waiting and vehicle not in recorded,
          known = last |> Map.take(Detector.Found.keys()) |> Enum.into(Map.delete(found || %{}, :since)),
          known != %{},
          into: %{},
          do: {vehicle, kept(known, state.vehicles[vehicle], last, lost != false, now)}

    vehicles = state.vehicles |> Map.merge(told) |> bounded()

    if changed?(state, vehicles, now),
      do: write(%{state | vehicles: vehicles}, now, false),
      else: state
  end

  defp detectors, do: %{__struct__: Detector, last: :"$2", found: :"$3", lost: :"$4"}

  # Of a vehicle that is lost, or has shown nothing yet, what is known holds since it was heard.
  defp kept(known, before, last, lost, now) do
    same? = before != nil and map_size(Map.drop(before, [:since, :lost])) == map_size(known)
    since = if same? and (lost or last == %{}), do: before.since, else: now
    Map.merge(known, %{since: since, lost: lost})
  end

  # A vehicle in a recording is not out there.
  defp recorded(gateway) do
    replayed = for %{kind: :replay, id: id} <- Store.links(gateway), do: id

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

  defp changed?(%{written_at: nil}, _vehicles, _now), do: true

  defp changed?(state, vehicles, now) do
    values = &Map.new(&1, fn {id, known} -> {id, Map.delete(known, :since)} end)

    values.(vehicles) != values.(state.vehicles) or
      (vehicles != state.vehicles and now - state.written_at >= @refresh_us)
  end

  defp write(%{file: nil} = state, now, _ended), do: %{state | written_at: now}

  defp write(state, now, ended) do
    case Kept.write(state.file, %{epoch: state.epoch, ended: ended, vehicles: state.vehicles}) do
      :ok -> %{state | written_at: now, problem: nil}
      {:error, reason} -> problem(state, reason)
    end
  end

  # Said once; tried again at the next look.
  defp problem(%{problem: reason} = state, reason), do: state

  defp problem(state, reason) do
    Logger.error("what is known of vehicles cannot be kept in #{state.file}: #{:file.format_error(reason)}")
    %{state | problem: reason}
  end

  defp now, do: System.os_time(:microsecond)
end
