defmodule MavCodec.Parser.Sources do
  @moduledoc """
  Sequence loss per source {system, component} of one parser.

  The frames of a source come in order, so a run of them is counted and passed to `MavCodec.Frame.SequenceLoss` at once. At most
  `limit/0` sources are kept: with forged source ids, only later sources lack statistics.
  """

  import Bitwise

  alias MavCodec.Frame
  alias MavCodec.Frame.SequenceLoss

  @limit 512
  @heartbeat 0

  # By system * 256 + component, which is found faster than a tuple: the estimator, whether anything but heartbeats was
  # heard, and the run that goes on: the first number that the estimator has not seen, the next one, and how many those are.
  # Sources alternate with nearly every frame, so a run is handed over when it is interrupted or this long.
  @run 64

  @type source ::
          {SequenceLoss.t(), talks? :: boolean(), first :: 0..255, next :: 0..255, count :: 0..64}
  @type t :: %{optional(non_neg_integer()) => source()}
  @type key :: {system :: non_neg_integer(), component :: 0..255}

  @doc "The largest number of sources."
  @spec limit() :: pos_integer()
  def limit, do: @limit

  @doc "No source yet."
  @spec new() :: t()
  def new, do: %{}

  @doc "Counts `frames`, the oldest first. A frame with an unknown id counts for a known source, but never adds one."
  @spec observe(t(), [Frame.t()]) :: t()
  def observe(sources, []), do: sources

  def observe(sources, [
        %Frame{system: system, component: component, seq: seq, id: id, crc_extra: extra} | rest
      ]) do
    key = system <<< 8 ||| component

    case sources do
      %{^key => {loss, talks?, first, ^seq, count}} when count < @run ->
        observe(
          %{sources | key => {loss, talks?(talks?, id, extra), first, seq + 1 &&& 255, count + 1}},
          rest
        )

      %{^key => {loss, talks?, first, _next, count}} ->
        loss = hand_over(loss, first, count)
        observe(%{sources | key => {loss, talks?(talks?, id, extra), seq, seq + 1 &&& 255, 1}}, rest)

      # An unchecked frame does not make its source known, also when a checked one stands right behind it: what is counted
      # must not depend on how the bytes were cut into pushes.
      _ when extra == nil or map_size(sources) >= @limit ->
        observe(sources, rest)

      _ ->
        source = {SequenceLoss.new(), talks?(false, id, extra), seq, seq + 1 &&& 255, 1}
        observe(Map.put(sources, key, source), rest)
    end
  end

  defp talks?(true, _id, _extra), do: true
  defp talks?(false, id, extra), do: id != @heartbeat and extra != nil

  defp hand_over(loss, _first, 0), do: loss
  defp hand_over(loss, first, count), do: SequenceLoss.observe_run(loss, first, count)

  @doc """
  The loss of each source, see `t:MavCodec.Frame.SequenceLoss.stats/0`.

  `ratio` is `nil` for a source that sent nothing but heartbeats: these may be forwarded ones, picked out of a stream
  whose other numbers never came this way.
  """
  @spec stats(t()) :: %{optional(key()) => map()}
  def stats(sources) do
    Map.new(sources, fn {key, {loss, talks?, first, _next, count}} ->
      stats = loss |> hand_over(first, count) |> SequenceLoss.stats()
      {{key >>> 8, key &&& 255}, if(talks?, do: stats, else: %{stats | ratio: nil})}
    end)
  end

  @doc "Frames lost, over all sources whose loss can be known, by their `stats/1`."
  @spec lost(%{optional(key()) => map()}) :: non_neg_integer()
  def lost(stats),
    do: for({_key, %{ratio: ratio, lost: n}} <- stats, ratio != nil, reduce: 0, do: (sum -> sum + n))
end
