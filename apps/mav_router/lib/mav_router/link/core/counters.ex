defmodule MavRouter.Link.Core.Counters do
  @max_ids 1024

  @moduledoc """
  What a link counted since it was added: a value that only grows, kept in the link's snapshot in the store, so that it
  outlives reconnections and restarts of the link's process.

  `fields/0` says what each sum counts. `messages`: frames by message id; ids beyond the first #{@max_ids} different ones are
  counted under `:other`.
  """

  alias Aerie.Base.Json.Object

  metric = &[metric: "gateway_link_#{&1}_total"]

  @fields Object.fields([
            {:bytes_in, :integer, "B", "bytes received", metric.("received_bytes")},
            {:frames_in, :integer, nil, "frames received that passed their checks",
             metric.("received_frames")},
            {:bytes_out, :integer, "B", "bytes handed to the transport", metric.("sent_bytes")},
            {:writes_out, :integer, nil, "writes handed to the transport", metric.("sent_writes")},
            {:crc_errors, :integer, nil, "frames with a wrong CRC", metric.("crc_errors")},
            {:resync_bytes, :integer, "B", "bytes skipped in search of the next frame",
             metric.("resync_bytes")},
            {:unknown_ids, :integer, nil, "frames whose message id no dialect knows",
             metric.("unknown_messages")},
            {:incompatible, :integer, nil, "frames dropped for unknown incompatibility flags (F6)",
             metric.("incompatible_frames")},
            {:lost, :integer, nil, "frames lost, estimated by sequence numbers (R7, R9)",
             metric.("lost_frames")},
            {:reconnects, :integer, nil, "connections made after the first", metric.("reconnects")},
            {:restarts, :integer, nil, "restarts of the link's process", metric.("restarts")},
            {:peers_refused, :integer, nil,
             "connections and datagrams of senders beyond the limit, or of too many new ones at once",
             metric.("refused_peers")},
            {:routes_refused, :integer, nil,
             "times that a component got no route, because its sender has too many: nothing can be sent to it",
             metric.("refused_routes")},
            # The others are drops, and one metric by reason.
            {:unclaimed, :integer, nil, "frames of systems without a vehicle"},
            {:overload, :integer, nil, "frames that a vehicle's session could not keep up with"},
            {:refused, :integer, nil, "frames of vehicles beyond limits.max_vehicles"},
            {:looped, :integer, nil, "our own frames that came back"},
            {:dropped_out, :integer, nil,
             "writes that could not be sent: link down, peer gone, or buffer full"},
            {:kernel_dropped, :integer, nil,
             "datagrams that the kernel's buffer had no room for; known on Linux only"},
            {:shed, :integer, nil, "datagrams dropped because too many waited"},
            {:shed_new, :integer, nil, "the same, of senders that were not heard before the overload"},
            {:denied, :integer, nil, "commands of endpoints that may not send them"},
            {:withheld, :integer, nil, "heartbeats and measurements withheld from vehicles"}
          ])

  defstruct Enum.map(@fields, &{&1.name, 0}) ++ [messages: %{}]

  @type t :: %__MODULE__{messages: %{(non_neg_integer | :other) => pos_integer}}

  @doc "The sums, and what each counts."
  @spec fields :: [Object.t()]
  def fields, do: @fields

  @doc "Adds to one sum."
  @spec add(t, atom, integer) :: t
  def add(%__MODULE__{} = counters, name, n), do: Map.put(counters, name, Map.fetch!(counters, name) + n)

  @doc "Adds the sums that `more` has; its other keys are ignored."
  @spec merge(t, map) :: t
  def merge(%__MODULE__{} = counters, more), do: more |> Map.to_list() |> merged(counters)

  defp merged([], counters), do: counters

  defp merged([{name, n} | rest], counters) when is_integer(n) and n != 0 and is_map_key(counters, name),
    do: merged(rest, add(counters, name, n))

  defp merged([_other | rest], counters), do: merged(rest, counters)

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
