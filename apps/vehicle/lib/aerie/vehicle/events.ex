defmodule Aerie.Vehicle.Events do
  @moduledoc """
  The event loop of one vehicle: reads its inbox in the journal, passes each entry to `Aerie.Vehicle.Events.Detector`, and commits
  the detector's new state together with the events.

  Whichever process is killed at whatever time, each inbox entry is processed exactly once: the committed state says which
  one was the last.
  """
  use GenServer

  alias Aerie.Base.{Names, Store}
  alias Aerie.Vehicle
  alias Aerie.Vehicle.Events.{Detector, Journal}
  alias MavRouter.Identity

  @spec start_link(gateway: Names.gateway(), options: Vehicle.Options.t()) :: GenServer.on_start()
  def start_link(arguments) do
    name = Names.via(arguments[:gateway], :events, arguments[:options].key)
    GenServer.start_link(__MODULE__, arguments, name: name)
  end

  @doc "Tells the loop that there is something in the inbox."
  @spec wake(pid()) :: :ok
  def wake(events) do
    send(events, :inbox)
    :ok
  end

  @impl GenServer
  def init(gateway: gateway, options: options) do
    Process.set_label({:events, options.id})
    Journal.welcome(gateway, options.id)
    detector = Journal.begin(gateway, options.id, first(gateway, options))
    # The last loop may have been killed between a commit and its notice.
    Journal.wake(gateway)
    {:ok, %{gateway: gateway, id: options.id, key: options.key, detector: detector}, {:continue, :inbox}}
  end

  # The detector of a new gateway: it compares the state with what was published before the restart.
  defp first(gateway, options) do
    published = if options.publisher, do: options.publisher.remembered(gateway, options.id)
    options |> Detector.new() |> Detector.remember(published)
  end

  @impl GenServer
  def handle_continue(:inbox, state), do: {:noreply, work(state)}

  @impl GenServer
  def handle_info(:inbox, state) do
    drain()
    {:noreply, work(state)}
  end

  def handle_info({:watchdog, watchdog, tag}, state) do
    Identity.Watchdog.answer(watchdog, tag)
    {:noreply, state}
  end

  defp work(state) do
    entries = Journal.inbox(state.gateway, state.id, state.detector.done)
    detector = Enum.reduce(entries, state.detector, &step(state, &1, &2))
    Journal.forget(state.gateway, state.id, Enum.map(entries, &elem(&1, 0)))
    %{state | detector: detector}
  end

  defp step(state, {n, observation}, former) do
    known = &Journal.param(state.gateway, state.id, &1)
    {detector, events, params} = Detector.observe(former, observation, known)
    detector = %{detector | done: n}
    Journal.commit(state.gateway, state.id, detector, events, params)
    # What is kept over a restart may change without an event.
    if events == [] and kept(detector) != kept(former), do: Journal.wake(state.gateway)

    suppressed = detector.budget.suppressed - former.budget.suppressed

    _ =
      if suppressed > 0,
        do: Store.count(state.gateway, {:vehicle, state.id, :events_suppressed}, suppressed)

    Enum.each(events, &committed(state.gateway, state.id, &1))
    if events != [], do: tell_shadow(state)
    detector
  end

  defp kept(%{last: last} = detector),
    do: {Map.take(last, Detector.OfflineChanges.keys()), detector.published, detector.lost}

  # The shadow loop looks at the vehicle once a second anyway: this one is so that it hears at once of who is in charge.
  defp tell_shadow(state) do
    shadow = Names.whereis(state.gateway, :shadow, state.key)
    if shadow, do: send(shadow, :changed)
  end

  @doc "Emits the telemetry of an event that was committed."
  @spec committed(Names.gateway(), String.t(), Vehicle.Event.t()) :: :ok
  def committed(gateway, id, event) do
    metadata = %{gateway: gateway, vehicle: id, type: event.type, event: event}
    :telemetry.execute([:aerie, :vehicle, :event], %{count: 1}, metadata)
  end

  # Reading the inbox once serves all notices that are waiting.
  defp drain do
    receive do
      :inbox -> drain()
    after
      0 -> :ok
    end
  end
end
