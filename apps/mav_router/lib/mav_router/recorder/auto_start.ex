defmodule MavRouter.Recorder.AutoStart do
  @moduledoc """
  Starts what the configuration asks for: the recording of each vehicle when it is first heard, and the saving of its ring on the
  events listed there.
  """
  use GenServer

  alias Aerie.Base.PubSub
  alias Aerie.Base.Store
  alias Aerie.Base.Names
  alias MavRouter.Recorder
  alias MavRouter.Recorder.{Status, Tables, Tap}

  @every_ms 1_000

  @spec start_link(keyword) :: GenServer.on_start()
  def start_link(options) do
    GenServer.start_link(__MODULE__, options,
      name: Names.via(Keyword.fetch!(options, :gateway), :recorder_auto_start)
    )
  end

  @impl GenServer
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    Process.set_label({:recorder_auto_start, gateway})
    tables = Tables.of(gateway)
    settings = Tables.settings(tables)
    :ok = PubSub.subscribe(gateway, :roster)
    if settings.ring and settings.save_on != [], do: :ok = PubSub.subscribe(gateway, :events)
    Process.send_after(self(), :look, @every_ms)
    {:ok, %{gateway: gateway, tables: tables, settings: settings}, {:continue, :look}}
  end

  @impl GenServer
  def handle_continue(:look, state) do
    all(state)
    {:noreply, state}
  end

  @impl GenServer
  def handle_info({:fleet, :roster, id}, state) do
    _ = with %{key: key} <- Store.vehicle(state.gateway, id), do: ensure(state, key)
    {:noreply, state}
  end

  def handle_info({:fleet, :events, event}, state) do
    # Only counted: the recording itself reports what is in its way.
    _ =
      if event.type in state.settings.save_on do
        with {:error, _reason} <- Recorder.save_at(state.gateway, event.vehicle, event.type, event.time, nil),
             do: Store.count(state.gateway, {:recorder, :not_saved})
      end

    {:noreply, state}
  end

  # Starts recordings again that died, and removes their queues, and what is known of recordings whose link or vehicle is gone.
  def handle_info(:look, state) do
    Process.send_after(self(), :look, @every_ms)
    Tap.sweep(state.tables)
    Status.sweep(state.tables, state.gateway)
    all(state)
    {:noreply, state}
  end

  def handle_info(_other, state), do: {:noreply, state}

  defp all(state), do: Enum.each(Store.vehicles(state.gateway), &ensure(state, &1.key))

  defp ensure(state, key) do
    target = {:vehicle, key}

    if Tables.mode(state.tables, target) != :off and Names.whereis(state.gateway, :recording, target) == nil,
      do: Recorder.begin(state.gateway, target)
  end
end
