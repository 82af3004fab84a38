defmodule Aerie.Bridge.Events.Window do
  @moduledoc """
  Events on their way to NATS: what may be sent, what is in flight, what is confirmed. Pure.

  Each vehicle has at most one event in flight, so a vehicle's events are stored in their order even when one is
  refused; events of different vehicles travel side by side, at most `max` in flight. Items carry a key (where they came
  from: the journal or a place in the outbox), which is what a confirmation gives back.
  """

  alias Aerie.Bridge.Outbox.Record

  @enforce_keys [:max, :ready, :keys]
  defstruct [:max, :ready, :keys, queues: %{}, in_flight: %{}, next_ref: 1]

  @type key :: term()
  @type item :: {key(), Record.t()}
  @typedoc "Number of a sending; a new one each time an event is sent."
  @type ref :: pos_integer()
  @type t :: %__MODULE__{
          max: pos_integer(),
          queues: %{String.t() => :queue.queue(item())},
          ready: :queue.queue(String.t()),
          in_flight: %{ref() => {item(), sent_at :: integer(), tries :: pos_integer()}},
          keys: MapSet.t(key()),
          next_ref: ref()
        }

  @doc "An empty window that lets `max` events be in flight."
  @spec new(pos_integer()) :: t()
  def new(max), do: %__MODULE__{max: max, ready: :queue.new(), keys: MapSet.new()}

  @doc "An empty window again. Answers to what was sent before are told apart by their numbers."
  @spec reset(t()) :: t()
  def reset(window), do: %{new(window.max) | next_ref: window.next_ref}

  @doc "How many events it holds, in flight or not."
  @spec size(t()) :: non_neg_integer()
  def size(window), do: MapSet.size(window.keys)

  @doc "How many are in flight."
  @spec in_flight(t()) :: non_neg_integer()
  def in_flight(window), do: map_size(window.in_flight)

  @doc "Takes up events, oldest first. Those it has already are ignored."
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

  @doc "Whether it has this event."
  @spec member?(t(), key()) :: boolean()
  def member?(window, key), do: MapSet.member?(window.keys, key)

  @doc "The next event to send, if one may be sent; it then is in flight."
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

  @doc "A sending is confirmed: the event's key, or nil for a confirmation that nobody waits for any more."
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

  @doc "Sendings older than `deadline`, to be sent again under new numbers; an answer to the old one is ignored."
  @spec overdue(t(), deadline :: integer()) :: [ref()]
  def overdue(window, deadline) do
    for {ref, {_item, at, _tries}} <- window.in_flight, at <= deadline, do: ref
  end

  @doc "How often the event that was sent most often was sent."
  @spec most_tries(t()) :: non_neg_integer()
  def most_tries(window),
    do: window.in_flight |> Map.values() |> Enum.map(&elem(&1, 2)) |> Enum.max(fn -> 0 end)

  @doc "Sends again. Gives the number of this try too."
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
