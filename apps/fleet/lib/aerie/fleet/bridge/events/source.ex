defmodule Aerie.Fleet.Bridge.Events.Source do
  @moduledoc """
  Where `Aerie.Fleet.Bridge.Events` takes its events from: the outbox first, then the journal. It puts them into the window, with a marker
  where a bounded store dropped some.

  It works on that process's state: `gateway`, `environment`, `epoch`, `outbox` (nil while it cannot be used), `window`, `gaps`, and
  `places`, each event's place in its vehicle's order.
  """

  alias Aerie.Fleet.Bridge.Events.{Disk, Gaps, Window}
  alias Aerie.Vehicle.Journal
  alias Aerie.Fleet.Bridge.Events.Outbox

  @doc "Fills the window, up to twice what may be in flight."
  @spec fill(map()) :: map()
  def fill(state) do
    if Window.size(state.window) >= 2 * state.window.max, do: state, else: fill_from(source(state), state)
  end

  @doc "Whether an event waits in one of the stores."
  @spec waiting?(map()) :: boolean()
  def waiting?(state), do: journal?(state) or source(state) == :outbox

  @doc "Whether an event waits in the journal."
  @spec journal?(map()) :: boolean()
  def journal?(state), do: Journal.pending_size(state.gateway) > 0

  defp source(%{outbox: nil}), do: :journal
  defp source(%{outbox: outbox}), do: if(Outbox.empty?(outbox), do: :journal, else: :outbox)

  defp fill_from(:outbox, state) do
    {records, outbox} = Outbox.read(state.outbox, 2 * state.window.max)

    Enum.reduce(records, %{state | outbox: outbox}, fn {seq, record}, state ->
      put(state, {:outbox, seq}, record, Gaps.place(decoded(record.body)))
    end)
  end

  defp fill_from(:journal, state) do
    for event <- Journal.pending(state.gateway, 4 * state.window.max),
        key = {:journal, event.id},
        not Window.member?(state.window, key),
        reduce: state do
      state -> put(state, key, Disk.record(state, event), place(state.epoch, event))
    end
  end

  defp place(nil, _event), do: nil
  defp place(epoch, event), do: {event.vehicle, epoch, event.seq, event.seq}

  # A bounded store dropped what is missing before it: a reader gets a marker in its place.
  defp put(state, key, record, place) do
    {missing, gaps} = Gaps.observe(state.gaps, place, false)

    marker =
      if missing,
        do: [{{:lost, key}, Gaps.marker(state.environment, missing, System.os_time(:microsecond))}],
        else: []

    window = Window.put(state.window, marker ++ [{key, record}])
    %{state | gaps: gaps, places: Map.put(state.places, key, place), window: window}
  end

  defp decoded(body) do
    case JSON.decode(body) do
      {:ok, object} -> object
      {:error, _damaged} -> nil
    end
  end
end
