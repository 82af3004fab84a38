defmodule Aerie.Recorder.Watch do
  @moduledoc """
  Begins what the configuration asks for: a recording for each vehicle when it is first heard, and the saving of its ring
  when an event calls for it.
  """
  use GenServer

  alias Aerie.Store.PubSub
  alias Aerie.Store
  alias Aerie.Names
  alias Aerie.Recorder
  alias Aerie.Recorder.{Tables, Tap}

  @every_ms 1_000

  @spec start_link(keyword) :: GenServer.on_start()
  def start_link(options) do
    GenServer.start_link(__MODULE__, options,
      name: Names.via(Keyword.fetch!(options, :gateway), :recorder_watch)
    )
  end

  @impl GenServer
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    Process.set_label({:recorder_watch, gateway})
    tables = Tables.of(gateway)
    settings = Tables.settings(tables)
    :ok = PubSub.subscribe(gateway, :vehicles)
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
  def handle_info({:fleet, :vehicles, ids}, state) do
    Enum.each(ids, fn id -> with %{key: key} <- Store.vehicle(state.gateway, id), do: ensure(state, key) end)
    {:noreply, state}
  end

  def handle_info({:fleet, :events, event}, state) do
    # Not worth more than being counted: the ring's saving tells by itself what is in its way.
    _ =
      if event.type in state.settings.save_on do
        with {:error, _reason} <- Recorder.save_at(state.gateway, event.vehicle, event.type, event.time, nil),
             do: Store.count(state.gateway, {:recorder, :not_saved})
      end

    {:noreply, state}
  end

  # Recordings that died are begun again; what they left behind is cleared away.
  def handle_info(:look, state) do
    Process.send_after(self(), :look, @every_ms)
    Tap.sweep(state.tables)
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
