defmodule MavRouter.Endpoints.Counters do
  @moduledoc """
  The counters of one endpoint, which every process adds to without a lock, and which only grow.

  | counter | |
  |---|---|
  | `frames_in` | came from it |
  | `frames_out`, `bytes_out` | handed to it: to its socket, or to its process |
  | `no_route` | from it, with a target that no other endpoint has (R2) |
  | `duplicates` | from it, after they had come from another endpoint |
  | `collided` | from it, by another vehicle with the id of one that was there before (`MavRouter.Routes.Collisions`) |
  | `read_only` | from it, and it may only read |
  | `denied` | from it, orders to vehicles that it may not give (`MavRouter.Forward.Gate`) |
  | `withheld` | from it, kept from vehicles: heartbeats, questions, telemetry, input of estimators, messages without a row in `MavCodec.Meaning.Messages` |
  | `routes_refused` | components heard from it that got no route, four times a second each while they speak (`MavRouter.Routes`) |
  | `held` | from it, kept until another's transfer with the vehicle was over (`MavRouter.Sharing.TransferLock`) |
  | `out_of_turn` | from it, steps of a transfer while another had the turn, and beginnings that waited in vain |
  | `secret` | from it, SETUP_SIGNING (S8), and passwords for a client (S9) |
  | `filtered_in`, `filtered_out`, `limited` | stopped by a filter or a rate limit |
  | `spared` | not carried by a link of high latency (X6) |
  | `refused` | to or from it, with an id that cannot be renumbered (`MavRouter.Endpoints.Owner.Renumber`) |
  | `failed` | its socket did not take them |
  | `dropped_control` ... `dropped_bulk` | dropped for want of room, by class |
  """

  alias MavRouter.Endpoints.Queue.TrafficClass

  @dropped Enum.map(TrafficClass.classes(), &:"dropped_#{&1}")
  @names [:frames_in, :frames_out, :bytes_out, :no_route, :duplicates, :collided, :read_only, :secret] ++
           [
             :denied,
             :withheld,
             :routes_refused,
             :held,
             :out_of_turn,
             :filtered_in,
             :filtered_out,
             :limited,
             :spared,
             :refused,
             :failed
           ] ++
           @dropped

  @type t :: :counters.counters_ref()

  @doc "All zero."
  @spec new() :: t
  def new, do: :counters.new(unquote(length(@names)), [:write_concurrency])

  @doc "Adds to a counter."
  @spec add(t, atom, non_neg_integer) :: :ok
  for {name, index} <- Enum.with_index(@names, 1) do
    def add(counters, unquote(name), n), do: :counters.add(counters, unquote(index), n)
  end

  @doc "Counts frames of a class that were dropped."
  @spec dropped(t, TrafficClass.class(), non_neg_integer) :: :ok
  for class <- TrafficClass.classes() do
    def dropped(counters, unquote(class), n), do: add(counters, unquote(:"dropped_#{class}"), n)
  end

  @doc "One counter."
  @spec get(t, atom) :: non_neg_integer
  for {name, index} <- Enum.with_index(@names, 1) do
    def get(counters, unquote(name)), do: :counters.get(counters, unquote(index))
  end

  @doc "How many frames did not go out: dropped, in all classes, or not taken by the socket."
  @spec lost(t) :: non_neg_integer
  def lost(counters), do: Enum.reduce([:failed | @dropped], 0, &(get(counters, &1) + &2))

  @doc "How many frames were dropped in all classes, from counters that were read."
  @spec dropped(%{atom => non_neg_integer}) :: non_neg_integer
  def dropped(counts), do: Enum.reduce(@dropped, 0, &(Map.get(counts, &1, 0) + &2))

  @doc "All counters by name."
  @spec read(t) :: %{atom => non_neg_integer}
  def read(counters),
    do: for({name, i} <- Enum.with_index(@names, 1), into: %{}, do: {name, :counters.get(counters, i)})
end
