defmodule Aerie.Link.Counters do
  @moduledoc """
  What a link counted since it was first made: a value that grows only, kept in the link's snapshot in the store, so that
  it outlives reconnections and restarts of the link's process.

  - `bytes_in`, `frames_in`: received, and frames of them that passed their checks
  - `crc_errors`, `resync_bytes`, `unknown_ids`, `incompatible`, `lost`: as `MavCodec.Parser.stats/1` counts them
  - `bytes_out`, `writes_out`: given to the transport
  - `reconnects`: connections made after the first; `restarts`: of the link's process
  - `peers_refused`: datagrams and connections of peers beyond the limit
  - drops, each counted in frames or writes: `unclaimed` (of a system whose vehicle is not known), `overload` (the vehicle
    could not keep up), `refused` (the limit of vehicles is reached), `looped` (our own frames come back), `dropped_out`
    (writes with no way out: link down, peer gone, buffer full)
  - `denied`: orders to vehicles that came from an end which may not give them; `withheld`: heartbeats and measurements that
    were kept from vehicles (`Aerie.Router.Gate`)
  - datagrams that came faster than the link could read: `kernel_dropped` (the kernel had no room for them; Linux tells), `shed`
    (they had waited so long that newer ones were read instead, `Aerie.Link.Backlog`)
  - `messages`: frames by message id; ids beyond the first #{1024} different ones are counted under `:other`
  """

  @max_ids 1024

  @sums [
    :bytes_in,
    :frames_in,
    :crc_errors,
    :resync_bytes,
    :unknown_ids,
    :incompatible,
    :lost,
    :bytes_out,
    :writes_out,
    :reconnects,
    :restarts,
    :peers_refused,
    :unclaimed,
    :overload,
    :refused,
    :looped,
    :dropped_out,
    :kernel_dropped,
    :shed,
    :denied,
    :withheld
  ]

  defstruct Enum.map(@sums, &{&1, 0}) ++ [messages: %{}]

  @type t :: %__MODULE__{messages: %{(non_neg_integer | :other) => pos_integer}}

  @doc "The names of the plain sums, in the order in which they are shown."
  @spec sums() :: [atom]
  def sums, do: @sums

  @doc "Adds to one sum."
  @spec add(t, atom, integer) :: t
  def add(%__MODULE__{} = counters, name, n), do: Map.put(counters, name, Map.fetch!(counters, name) + n)

  @doc "Adds each sum that both have; other keys of `more` are not looked at."
  @spec merge(t, map) :: t
  def merge(%__MODULE__{} = counters, more) do
    Enum.reduce(@sums, counters, fn name, counters ->
      case more do
        %{^name => n} when is_integer(n) and n != 0 -> add(counters, name, n)
        _none -> counters
      end
    end)
  end

  @doc "Counts frames by message id."
  @spec messages(t, [%{id: non_neg_integer}]) :: t
  def messages(%__MODULE__{} = counters, frames) do
    %{counters | messages: count(frames, counters.messages)}
  end

  defp count([], messages), do: messages

  defp count([%{id: id} | rest], messages) do
    case messages do
      %{^id => n} -> count(rest, %{messages | id => n + 1})
      _new when map_size(messages) < @max_ids -> count(rest, Map.put(messages, id, 1))
      _full -> count(rest, Map.update(messages, :other, 1, &(&1 + 1)))
    end
  end
end
