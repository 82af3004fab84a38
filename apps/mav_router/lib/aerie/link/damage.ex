defmodule Aerie.Link.Damage do
  @moduledoc """
  What of damaged frames is worth a line of the log: the first at once, then one line every #{10} s while there are more, with how
  many there were. A value.

  A few bytes between frames are none: every serial port that is opened in the middle of a frame has them.
  """

  alias Aerie.Link.Counters

  @every_ms 10_000
  @names [:crc_errors, :incompatible, :resync_bytes]
  @noise_bytes 512

  @enforce_keys [:told]
  defstruct [:told, :at]

  @typedoc "`told`: what was counted when it was last told of; `at`: when that was, monotonic ms"
  @type t :: %__MODULE__{told: %{atom => non_neg_integer}, at: integer | nil}

  @doc "Nothing told yet of what these counters go on from."
  @spec new(Counters.t()) :: t
  def new(counters), do: %__MODULE__{told: Map.take(counters, @names)}

  @doc "Looks at the counters at `now` (monotonic ms): words for the log, or nil."
  @spec look(t, Counters.t(), integer) :: {String.t() | nil, t}
  def look(%__MODULE__{at: at} = damage, _counters, now) when at != nil and now - at < @every_ms,
    do: {nil, damage}

  def look(damage, counters, now) do
    new = Map.new(@names, &{&1, Map.fetch!(counters, &1) - damage.told[&1]})

    if new.crc_errors + new.incompatible > 0 or new.resync_bytes >= @noise_bytes,
      do: {words(new), %__MODULE__{told: Map.take(counters, @names), at: now}},
      else: {nil, damage}
  end

  defp words(new) do
    "what came was damaged: #{new.crc_errors} frames with a wrong CRC, #{new.incompatible} with flags that nobody knows, " <>
      "#{new.resync_bytes} bytes that are no frame (told every #{div(@every_ms, 1000)} s at most)"
  end
end
