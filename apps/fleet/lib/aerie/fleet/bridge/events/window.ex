defmodule Aerie.Fleet.Bridge.Events.Window do
  @moduledoc """
  The send window for events: what may be sent, what is in flight, what is confirmed. Pure.

  Each vehicle has at most one event in flight, so its events are stored in order even if one is refused. Events of different
  vehicles are sent concurrently, at most `max` in flight. Each item has a key that says where it comes from (the journal or a
  place in the outbox); a confirmation returns the key.
  """

  alias Aerie.Fleet.Bridge.Events.Outbox.Record

  @enforce_keys [:max, :ready, :keys]
  defstruct [:max, :ready, :keys, queues: %{}, in_flight: %{}, next_ref: 1]

  @type key :: term()
  @type item :: {key(), Record.t()}
  @typedoc "The number of a sending; each sending of an event has its own."
  @type ref :: pos_integer()
  @type t :: %__MODULE__{
          max: pos_integer(),
          queues: %{String.t() => :queue.queue(item())},
          ready: :queue.queue(String.t()),
          in_flight: %{ref() => {item(), sent_at :: integer(), tries :: pos_integer()}},
          keys: MapSet.t(key()),
          next_ref: ref()
        }

  @doc "An empty window for at most `max` events in flight."
  @spec new(pos_integer()) :: t()
  def new(max), do: %__MODULE__{max: max, ready: :queue.new(), keys: MapSet.new()}

  @doc "Empties the window. Its numbers go on, so that late answers are recognised."
  @spec reset(t()) :: t()
  def reset(window), do: %{new(window.max) | next_ref: window.next_ref}

  @doc "The number of events, in flight or not."
  @spec size(t()) :: non_neg_integer()
  def size(window), do: MapSet.size(window.keys)

  @doc "The number of events in flight."
  @spec in_flight(t()) :: non_neg_integer()
  def in_flight(window), do: map_size(window.in_flight)

  @doc "Adds events, oldest first. Events that it already has are ignored."
  @spec put(t(), [item()]) :: t()
  def put(window, items), do: Enum.reduce(items, window, &put_one/2)

  defp put_one({key, %Record{vehicle: vehicle}} = item, window) do
    if MapSet.member?(window.keys, key) do
      window
    else
      window = %{window | keys: MapSet.put(window.keys, key)}

      case window.queues do
        %{^vehicle => queue} ->
          %{window | queues: %{window.queues | vehicle => :queue.in(item, queue)}}

        _idle ->
          queues = Map.put(window.queues, vehicle, :queue.from_list([item]))
          %{window | queues: queues, ready: :queue.in(vehicle, window.ready)}
      end
    end
  end

  @doc "Whether it contains an event."
  @spec member?(t(), key()) :: boolean()
  def member?(window, key), do: MapSet.member?(window.keys, key)

  @doc "The next event to send, which is then in flight; `:none` if nothing may be sent."
  @spec next(t(), now :: integer()) :: {ref(), item(), t()} | :none
  def next(%{max: max, in_flight: in_flight}, _now) when map_size(in_flight) >= max, do: :none

  def next(window, now) do
    case :queue.out(window.ready) do
      {{:value, vehicle}, ready} ->
        {:value, item} = :queue.peek(window.queues[vehicle])
        send_item(%{window | ready: ready}, item, now, 1)

      {:empty, _ready} ->
        :none
    end
  end

  defp send_item(window, item, now, tries) do
    ref = window.next_ref
    in_flight = Map.put(window.in_flight, ref, {item, now, tries})
    {ref, item, %{window | in_flight: in_flight, next_ref: ref + 1}}
  end

  @doc "Confirms a sending: returns the event's key, or nil for a late confirmation."
  @spec confirm(t(), ref()) :: {key() | nil, t()}
  def confirm(window, ref) do
    case Map.pop(window.in_flight, ref) do
      {nil, _} ->
        {nil, window}

      {{{key, record}, _at, _tries}, in_flight} ->
        {_sent, queue} = :queue.out(window.queues[record.vehicle])
        window = %{window | in_flight: in_flight, keys: MapSet.delete(window.keys, key)}
        {key, ready_again(window, record.vehicle, queue)}
    end
  end

  defp ready_again(window, vehicle, queue) do
    if :queue.is_empty(queue) do
      %{window | queues: Map.delete(window.queues, vehicle)}
    else
      %{window | queues: %{window.queues | vehicle => queue}, ready: :queue.in(vehicle, window.ready)}
    end
  end

  @doc "The sendings that are older than `deadline`."
  @spec overdue(t(), deadline :: integer()) :: [ref()]
  def overdue(window, deadline) do
    for {ref, {_item, at, _tries}} <- window.in_flight, at <= deadline, do: ref
  end

  @doc "The largest number of sendings of one event."
  @spec most_tries(t()) :: non_neg_integer()
  def most_tries(window),
    do: window.in_flight |> Map.values() |> Enum.map(&elem(&1, 2)) |> Enum.max(fn -> 0 end)

  @doc "Sends an event again under a new number, and returns the number of tries. An answer to the old number is ignored."
  @spec again(t(), ref(), now :: integer()) :: {ref(), item(), tries :: pos_integer(), t()} | :none
  def again(window, ref, now) do
    case Map.pop(window.in_flight, ref) do
      {nil, _} ->
        :none

      {{item, _at, tries}, in_flight} ->
        {ref, item, window} = send_item(%{window | in_flight: in_flight}, item, now, tries + 1)
        {ref, item, tries + 1, window}
    end
  end
end
