defmodule MavCodec.Tlog.Stamp do
  @moduledoc """
  The time of a record. What is written before a frame is not always one: the recorder may have no clock yet (its time begins in
  1970), the clock is set meanwhile, or the bytes are damaged.

    * From 2000 to 2100 it is a time, and so is what is at most a day from the time before.
    * A recorder whose clock went back to 1970 still tells how much later a record is: time goes on by that.
    * Anything else is damaged, and the record gets the time of the one before. The first record of a file has none before; one
      after 2100 has no time at all.
  """

  @year_2000 946_684_800_000_000
  @year_2100 4_102_444_800_000_000
  @day 86_400_000_000

  @enforce_keys [:time, :written]
  defstruct @enforce_keys

  @typedoc "`time` of the record, and what was `written` (unix microseconds)"
  @type t :: %__MODULE__{time: non_neg_integer(), written: non_neg_integer()}

  @doc "The time of the next record; nil for none."
  @spec next(t() | nil, non_neg_integer()) :: t() | nil
  def next(nil, at) when at > @year_2100, do: nil
  def next(nil, at), do: %__MODULE__{time: at, written: at}
  def next(stamp, at), do: %__MODULE__{time: time(stamp, at), written: at}

  defp time(_stamp, at) when at in @year_2000..@year_2100, do: at
  defp time(%{time: time}, at) when abs(at - time) <= @day, do: at

  defp time(%{time: time, written: written}, at)
       when at < @year_2000 and written < @year_2000 and abs(at - written) <= @day,
       do: max(time + at - written, 0)

  defp time(%{time: time}, _damaged), do: time
end
