defmodule Aerie.Router.Tally do
  @moduledoc """
  What is counted for one endpoint: an array of counters that every process adds to without a lock, and that grows only.

  | counter | |
  |---|---|
  | `frames_in` | came from it |
  | `frames_out`, `bytes_out` | handed to it: to its socket, or to its process |
  | `no_route` | from it, addressed to somebody who is not known (R2) |
  | `duplicates` | from it, and from another endpoint before |
  | `collided` | from it, by another vehicle with the id of one that was there before (`Aerie.Router.Apart`) |
  | `read_only` | from it, and it may not speak |
  | `denied` | from it, orders to vehicles that it may not give (`Aerie.Router.Gate`) |
  | `withheld` | from it, kept from vehicles: an operator's heartbeats and what estimators believe |
  | `held` | from it, waited until another's transfer with the vehicle was over (`Aerie.Router.Turns`) |
  | `out_of_turn` | from it, parts of a transfer while another had the turn, and beginnings that waited in vain |
  | `secret` | from it, SETUP_SIGNING (S8) |
  | `filtered_in`, `filtered_out`, `limited` | stopped by a filter or a rate limit |
  | `spared` | not for a link of high latency (X6) |
  | `refused` | to or from it, with an id that cannot be renumbered (`Aerie.Router.Renumber`) |
  | `failed` | its socket did not take them |
  | `dropped_control` ... `dropped_bulk` | dropped for want of room, by class |
  """

  alias Aerie.Router.Classify

  @dropped Enum.map(Classify.classes(), &:"dropped_#{&1}")
  @names [:frames_in, :frames_out, :bytes_out, :no_route, :duplicates, :collided, :read_only, :secret] ++
           [
             :denied,
             :withheld,
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
    def add(tally, unquote(name), n), do: :counters.add(tally, unquote(index), n)
  end

  @doc "Counts frames of a class that were dropped."
  @spec dropped(t, Classify.class(), non_neg_integer) :: :ok
  for class <- Classify.classes() do
    def dropped(tally, unquote(class), n), do: add(tally, unquote(:"dropped_#{class}"), n)
  end

  @doc "One counter."
  @spec get(t, atom) :: non_neg_integer
  for {name, index} <- Enum.with_index(@names, 1) do
    def get(tally, unquote(name)), do: :counters.get(tally, unquote(index))
  end

  @doc "How many did not go out: dropped in all classes, or not taken by the socket."
  @spec lost(t) :: non_neg_integer
  def lost(tally), do: Enum.reduce([:failed | @dropped], 0, &(get(tally, &1) + &2))

  @doc "How many were dropped in all classes, of counters that were read."
  @spec dropped(%{atom => non_neg_integer}) :: non_neg_integer
  def dropped(counts), do: Enum.reduce(@dropped, 0, &(Map.get(counts, &1, 0) + &2))

  @doc "All counters by name."
  @spec read(t) :: %{atom => non_neg_integer}
  def read(tally),
    do: for({name, i} <- Enum.with_index(@names, 1), into: %{}, do: {name, :counters.get(tally, i)})
end
