defmodule Aerie.Vehicle.Events do
  @moduledoc """
  The event loop of one vehicle: reads its inbox in the journal, asks `Aerie.Vehicle.Detector`, and commits the
  detector's new state together with the events, entry by entry.

  Whoever is killed when, each inbox entry is taken account of exactly once: the committed state says which was the last.
  """
  use GenServer

  alias Aerie.{Fleet, Identity, Names, Store, Vehicle}

  @spec start_link(gateway: Names.gateway(), options: Vehicle.Options.t()) :: GenServer.on_start()
  def start_link(arguments) do
    name = Names.via(arguments[:gateway], :events, arguments[:options].key)
    GenServer.start_link(__MODULE__, arguments, name: name)
  end

  @doc "Says that there is something in the inbox."
  @spec wake(pid()) :: :ok
  def wake(events) do
    send(events, :inbox)
    :ok
  end

  @impl GenServer
  def init(gateway: gateway, options: options) do
    Process.set_label({:events, options.id})
    Fleet.Journal.welcome(gateway, options.id)
    detector = Fleet.Journal.begin(gateway, options.id, first(gateway, options))
    # A forerunner may have been killed before it told about what it had committed.
    Fleet.Journal.wake(gateway)
    {:ok, %{gateway: gateway, id: options.id, detector: detector}, {:continue, :inbox}}
  end

  # The first of this life: what the last one told is compared with what is found.
  defp first(gateway, options) do
    found = if options.fleet, do: options.fleet.remembered(gateway, options.id)
    options |> Vehicle.Detector.new() |> Vehicle.Detector.remember(found)
  end

  @impl GenServer
  def handle_continue(:inbox, state), do: {:noreply, work(state)}

  @impl GenServer
  def handle_info(:inbox, state) do
    drain()
    {:noreply, work(state)}
  end

  def handle_info({:pulse, pulse, tag}, state) do
    Identity.Pulse.answer(pulse, tag)
    {:noreply, state}
  end

  defp work(state) do
    entries = Fleet.Journal.inbox(state.gateway, state.id, state.detector.done)
    detector = Enum.reduce(entries, state.detector, &step(state, &1, &2))
    Fleet.Journal.forget(state.gateway, state.id, Enum.map(entries, &elem(&1, 0)))
    %{state | detector: detector}
  end

  defp step(state, {n, observation}, detector) do
    before = detector.budget.suppressed
    known = &Fleet.Journal.param(state.gateway, state.id, &1)
    {detector, events, params} = Vehicle.Detector.observe(detector, observation, known)
    detector = %{detector | done: n}
    Fleet.Journal.commit(state.gateway, state.id, detector, events, params)

    suppressed = detector.budget.suppressed - before

    _ =
      if suppressed > 0,
        do: Store.count(state.gateway, {:vehicle, state.id, :events_suppressed}, suppressed)

    Enum.each(events, &told(state.gateway, state.id, &1))
    detector
  end

  @doc "Tells who measures that an event was committed."
  @spec told(Names.gateway(), String.t(), Vehicle.Event.t()) :: :ok
  def told(gateway, id, event) do
    metadata = %{gateway: gateway, vehicle: id, type: event.type, event: event}
    :telemetry.execute([:aerie, :vehicle, :event], %{count: 1}, metadata)
  end

  # One look at the inbox answers all calls to look at it that are waiting.
  defp drain do
    receive do
      :inbox -> drain()
    after
      0 -> :ok
    end
  end
end
