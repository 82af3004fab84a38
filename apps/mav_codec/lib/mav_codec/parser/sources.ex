defmodule MavCodec.Parser.Sources do
  @moduledoc """
  Sequence loss per source {system, component} of one parser.

  Frames come in runs of one source in order, so a run is counted and handed to `MavCodec.SequenceLoss` as one. At most
  `limit/0` sources are kept: what forges source ids costs only the statistics of those that come after.
  """

  import Bitwise

  alias MavCodec.{Frame, SequenceLoss}

  @limit 512
  @heartbeat 0

  # {estimator, whether anything but heartbeats was heard} by system * 256 + component, which is found faster than a tuple.
  @type t :: %{optional(non_neg_integer()) => {SequenceLoss.t(), boolean()}}
  @type key :: {system :: non_neg_integer(), component :: 0..255}

  @doc "Sources that are kept at most."
  @spec limit() :: pos_integer()
  def limit, do: @limit

  @doc "Nothing heard yet."
  @spec new() :: t()
  def new, do: %{}

  @doc "Counts `frames`, the oldest first. Frames of unknown ids count for a source that is known, but make none."
  @spec observe(t(), [Frame.t()]) :: t()
  def observe(sources, []), do: sources

  # An unchecked frame does not make its source known, also when a checked one stands right behind it: what is counted
  # must not depend on how the bytes were cut into pushes.
  def observe(sources, [%Frame{crc_extra: nil, system: system, component: component} | rest] = frames) do
    if is_map_key(sources, key(system, component)), do: run(frames, sources), else: observe(sources, rest)
  end

  def observe(sources, frames), do: run(frames, sources)

  defp run([%Frame{system: system, component: component, seq: seq} | _] = frames, sources),
    do: run(frames, sources, system, component, seq, seq, 0, nil)

  # `known` is nil, or the highest id of the run's frames whose CRC was checked.
  defp run(
         [%Frame{system: system, component: component, seq: seq} = frame | rest],
         sources,
         system,
         component,
         first,
         seq,
         n,
         known
       ),
       do: run(rest, sources, system, component, first, seq + 1 &&& 255, n + 1, highest(frame, known))

  defp run([], sources, system, component, first, _next, n, known),
    do: add(sources, key(system, component), first, n, known)

  defp run(frames, sources, system, component, first, _next, n, known),
    do: sources |> add(key(system, component), first, n, known) |> observe(frames)

  defp highest(%Frame{crc_extra: nil}, known), do: known
  defp highest(%Frame{id: id}, nil), do: id
  defp highest(%Frame{id: id}, known), do: max(id, known)

  defp key(system, component), do: system <<< 8 ||| component

  defp add(sources, key, first, n, known) do
    talks? = known != nil and known > @heartbeat

    case sources do
      %{^key => {loss, talked?}} ->
        %{sources | key => {SequenceLoss.observe_run(loss, first, n), talked? or talks?}}

      _ when map_size(sources) >= @limit ->
        sources

      _ ->
        Map.put(sources, key, {SequenceLoss.observe_run(SequenceLoss.new(), first, n), talks?})
    end
  end

  @doc """
  The loss of each source, see `t:MavCodec.SequenceLoss.stats/0`.

  `ratio` is `nil` for a source that sent nothing but heartbeats: these may be forwarded ones, picked out of a stream
  whose other numbers never came this way.
  """
  @spec stats(t()) :: %{optional(key()) => map()}
  def stats(sources) do
    Map.new(sources, fn {key, {loss, talks?}} ->
      stats = SequenceLoss.stats(loss)
      {{key >>> 8, key &&& 255}, if(talks?, do: stats, else: %{stats | ratio: nil})}
    end)
  end

  @doc "Frames lost, over all sources whose loss can be known."
  @spec lost(t()) :: non_neg_integer()
  def lost(sources) do
    for {_, {loss, true}} <- sources, reduce: 0, do: (sum -> sum + loss.lost)
  end
end
