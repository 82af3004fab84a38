defmodule MavRouter.Link.Core.Counters do
  @max_ids 1024

  @moduledoc """
  What a link counted since it was added: a value that only grows, kept in the link's snapshot in the store, so that it
  outlives reconnections and restarts of the link's process.

  - `bytes_in`, `frames_in`: received bytes, and frames in them that passed their checks
  - `crc_errors`, `resync_bytes`, `unknown_ids`, `incompatible`, `lost`: as `MavCodec.Parser.stats/1` counts them
  - `bytes_out`, `writes_out`: passed to the transport
  - `reconnects`: connections made after the first; `restarts`: of the link's process
  - `peers_refused`: datagrams and connections of peers beyond the limit
  - drops, in frames or writes: `unclaimed` (no vehicle is known for the system), `overload` (the vehicle could not keep up),
    `refused` (the limit of vehicles is reached), `looped` (our own frames came back), `dropped_out` (link down, peer gone,
    buffer full)
  - `denied`: commands to vehicles from peers that may not command; `withheld`: heartbeats and measurements that were not
    forwarded to vehicles (`MavRouter.Endpoints.Access`)
  - `routes_refused`: how often a component of its peers got no route, because the peer has too many
    (`MavRouter.Routes`)
  - datagrams that came faster than the link could read: `kernel_dropped` (the kernel had no room; known on Linux only), `shed`
    (too many waited, `MavRouter.Link.Transport.Net.Backlog`), `shed_new` (the same, of senders that were not heard
    before the overload)
  - `messages`: frames by message id; ids beyond the first #{@max_ids} different ones are counted under `:other`
  """

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
    :shed_new,
    :denied,
    :withheld,
    :routes_refused
  ]

  defstruct Enum.map(@sums, &{&1, 0}) ++ [messages: %{}]

  @type t :: %__MODULE__{messages: %{(non_neg_integer | :other) => pos_integer}}

  @doc "Adds to one sum."
  @spec add(t, atom, integer) :: t
  def add(%__MODULE__{} = counters, name, n), do: Map.put(counters, name, Map.fetch!(counters, name) + n)

  @doc "Adds the sums that `more` has; its other keys are ignored."
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
