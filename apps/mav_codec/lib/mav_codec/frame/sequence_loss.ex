defmodule MavCodec.Frame.SequenceLoss do
  import Bitwise

  # A frame may be late by this many numbers; a gap shorter than @restart is a loss (R9).
  @late 32
  @late_mask (1 <<< @late) - 1
  @restart 64
  # At most so many at a time, because the bits must fit a machine word.
  @late_step 16
  # The largest number of tracks, and how many frames of the source a track may be silent.
  @max_tracks 4
  @track_silence 256
  # The window: so many buckets of so many numbers each.
  @buckets 8
  @bucket 64

  @moduledoc """
  Estimates from sequence numbers how many frames of one source {system, component} on one link were lost (R7, R9).

  It is a pure value: `observe/2` each number, then read `stats/1`. "Number minus the last one minus one" is not enough for
  real firmware, so these rules apply:

    * A missing number counts as lost only when it is #{@late} numbers old. If it comes before that, it was late (two
      threads of PX4 1.17 send on one channel: 48, 50, 49, 51).
    * A step forward by #{@restart} or more, or backward to a number that was not missing and is not recent, is a restart, not a
      loss (R9).
    * A restart begins a new *track* and keeps the old one for a while. So a source with two counters (Betaflight numbers
      two groups of messages independently) has two tracks without gaps, and no loss.
    * A number that was seen a moment ago is a duplicate (two radios, one vehicle), neither loss nor restart.

  It cannot detect a filtered stream, whose sequence numbers always have gaps (an autopilot that forwards the heartbeats of
  another link's ground station). `MavCodec.Parser` therefore gives no loss for a source that sends only heartbeats.

  The ratio is taken over a window of the last #{@buckets * @bucket} numbers or so; the counters never go down.
  """

  defstruct tracks: [],
            received: 0,
            lost: 0,
            late: 0,
            duplicates: 0,
            restarts: 0,
            bucket_received: 0,
            bucket_lost: 0,
            buckets: []

  # A track is {next expected number, bits of the missing among the last 32 (bit 0 = the newest), `received` when last used}.
  @typep track :: {0..255, non_neg_integer(), non_neg_integer()}
  @type t :: %__MODULE__{
          tracks: [track()],
          received: non_neg_integer(),
          lost: non_neg_integer(),
          late: non_neg_integer(),
          duplicates: non_neg_integer(),
          restarts: non_neg_integer(),
          bucket_received: non_neg_integer(),
          bucket_lost: non_neg_integer(),
          buckets: [{non_neg_integer(), non_neg_integer()}]
        }

  @typedoc """
    * `received` - frames observed
    * `lost` - numbers that never came (counted #{@late} numbers later)
    * `missing` - numbers that may still come
    * `late` - frames that came out of order
    * `duplicates` - numbers seen twice within a moment
    * `restarts` - how often the count restarted, or a further counter was found
    * `ratio` - lost part of the window, 0.0..1.0
  """
  @type stats :: %{
          received: non_neg_integer(),
          lost: non_neg_integer(),
          missing: non_neg_integer(),
          late: non_neg_integer(),
          duplicates: non_neg_integer(),
          restarts: non_neg_integer(),
          ratio: float()
        }

  @doc "A new estimator."
  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc "One frame with sequence number `seq`."
  @spec observe(t(), 0..255) :: t()
  def observe(%__MODULE__{} = loss, seq), do: observe_run(loss, seq, 1)

  @doc "`count` frames in order, the first with number `first`: the same as `count` calls of `observe/2`, but cheap."
  @spec observe_run(t(), 0..255, pos_integer()) :: t()
  def observe_run(%__MODULE__{tracks: [{expected, 0, _} | others]} = loss, first, count)
      when expected == first do
    received = loss.received + count
    tracks = [{first + count &&& 255, 0, received} | others]
    in_bucket = loss.bucket_received + count

    # The common case, one update.
    if in_bucket + loss.bucket_lost < @bucket,
      do: %{loss | tracks: tracks, received: received, bucket_received: in_bucket},
      else: bucket(%{loss | tracks: tracks, received: received}, count, 0)
  end

  # The same while numbers are missing: they become older by the run's length.
  def observe_run(%__MODULE__{tracks: [{expected, missing, _} | others]} = loss, first, count)
      when expected == first do
    part = min(count, @late_step)
    bits = missing <<< part
    lost = ones(bits >>> @late)
    received = loss.received + part
    track = {first + part &&& 255, bits &&& @late_mask, received}
    loss = bucket(%{loss | tracks: [track | others], received: received, lost: loss.lost + lost}, part, lost)
    if part == count, do: loss, else: observe_run(loss, first + part &&& 255, count - part)
  end

  def observe_run(loss, first, 1), do: step(loss, first)

  def observe_run(loss, first, count),
    do: loss |> step(first) |> observe_run(first + 1 &&& 255, count - 1)

  @doc "The counters and the ratio over the window."
  @spec stats(t()) :: stats()
  def stats(%__MODULE__{} = loss) do
    %{
      received: loss.received,
      lost: loss.lost,
      missing: loss.tracks |> Enum.map(fn {_, missing, _} -> ones(missing) end) |> Enum.sum(),
      late: loss.late,
      duplicates: loss.duplicates,
      restarts: loss.restarts,
      ratio: ratio(loss)
    }
  end

  @doc "The part of the numbers in the window that was lost, 0.0..1.0; 0.0 if nothing was observed."
  @spec ratio(t()) :: float()
  def ratio(%__MODULE__{} = loss) do
    {received, lost} =
      Enum.reduce(loss.buckets, {loss.bucket_received, loss.bucket_lost}, fn {r, l}, {received, lost} ->
        {received + r, lost + l}
      end)

    if received + lost == 0, do: 0.0, else: lost / (received + lost)
  end

  # The four explanations of a number, the most harmless first.
  defp step(loss, seq) do
    loss = %{loss | received: loss.received + 1}

    with nil <- next(loss, seq),
         nil <- late(loss, seq),
         nil <- gap(loss, seq),
         nil <- duplicate(loss, seq),
         do: restart(loss, seq)
  end

  defp next(loss, seq) do
    case Enum.find(loss.tracks, fn {expected, _, _} -> expected == seq end) do
      nil -> nil
      track -> advance(loss, track, 0)
    end
  end

  defp late(loss, seq) do
    case Enum.find(loss.tracks, fn {expected, missing, _} = _track ->
           missing?(missing, age(expected, seq))
         end) do
      nil ->
        nil

      {expected, missing, _} = track ->
        missing = bxor(missing, 1 <<< age(expected, seq))
        bucket(%{use_track(loss, track, {expected, missing, loss.received}) | late: loss.late + 1}, 1, 0)
    end
  end

  defp gap(%{tracks: []}, _seq), do: nil

  defp gap(loss, seq) do
    {expected, _, _} = track = Enum.min_by(loss.tracks, fn {expected, _, _} -> seq - expected &&& 255 end)
    skipped = seq - expected &&& 255
    if skipped < @restart, do: advance(loss, track, skipped)
  end

  defp duplicate(loss, seq) do
    case Enum.find(loss.tracks, fn {expected, _, _} -> age(expected, seq) < @late end) do
      nil ->
        nil

      {expected, missing, _} = track ->
        bucket(
          %{use_track(loss, track, {expected, missing, loss.received}) | duplicates: loss.duplicates + 1},
          1,
          0
        )
    end
  end

  defp restart(loss, seq) do
    # Numbers that the forgotten tracks still missed need not be lost: a restart explains them as well.
    kept =
      loss.tracks
      |> Enum.filter(fn {_, _, used} -> loss.received - used <= @track_silence end)
      |> Enum.take(@max_tracks - 1)

    restarts = if loss.tracks == [], do: 0, else: 1
    track = {seq + 1 &&& 255, 0, loss.received}
    bucket(%{loss | tracks: [track | kept], restarts: loss.restarts + restarts}, 1, 0)
  end

  # The track continues after `skipped` missing numbers; those older than 32 numbers are lost.
  defp advance(loss, {expected, missing, _} = track, skipped) do
    bits = missing <<< (skipped + 1) ||| ((1 <<< skipped) - 1) <<< 1
    lost = ones(bits >>> @late)
    track_now = {expected + skipped + 1 &&& 255, bits &&& @late_mask, loss.received}
    bucket(%{use_track(loss, track, track_now) | lost: loss.lost + lost}, 1, lost)
  end

  # The track in use is the first.
  defp use_track(%{tracks: [track | others]} = loss, track, now), do: %{loss | tracks: [now | others]}
  defp use_track(loss, track, now), do: %{loss | tracks: [now | List.delete(loss.tracks, track)]}

  # 0 for the number before the expected one.
  defp age(expected, seq), do: expected - 1 - seq &&& 255

  defp missing?(missing, age), do: age < @late and (missing >>> age &&& 1) == 1

  defp bucket(loss, received, lost) do
    received = loss.bucket_received + received
    lost = loss.bucket_lost + lost

    if received + lost < @bucket do
      %{loss | bucket_received: received, bucket_lost: lost}
    else
      buckets = [{received, lost} | Enum.take(loss.buckets, @buckets - 1)]
      %{loss | bucket_received: 0, bucket_lost: 0, buckets: buckets}
    end
  end

  defp ones(0), do: 0
  defp ones(bits), do: (bits &&& 1) + ones(bits >>> 1)
end
