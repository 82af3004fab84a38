defmodule MavRouter.Recorder.Recording.Buffer do
  @moduledoc """
  Records that are collected until they are written together. A pure value.

  `waiting` are bytes that count as waiting in the queue (`MavRouter.Recorder.Tap`) until these records are written or dropped: collected
  records still take memory.
  """

  @full 65_536

  defstruct entries: [], bytes: 0, frames: 0, waiting: 0

  @type t :: %__MODULE__{
          entries: [binary],
          bytes: non_neg_integer,
          frames: non_neg_integer,
          waiting: non_neg_integer
        }

  @doc "Adds the records of some frames, copied, so that they do not keep a link's reads in memory."
  @spec add(t, iodata, pos_integer) :: t
  def add(buffer, records, frames) do
    records = IO.iodata_to_binary(records)

    %{
      buffer
      | entries: [records | buffer.entries],
        bytes: buffer.bytes + byte_size(records),
        frames: buffer.frames + frames
    }
  end

  @doc "Notes bytes of the queue that wait for the records to be written."
  @spec wait(t, non_neg_integer) :: t
  def wait(buffer, bytes), do: %{buffer | waiting: buffer.waiting + bytes}

  @spec empty?(t) :: boolean
  def empty?(buffer), do: buffer.entries == []

  @doc "Whether there is enough for one write."
  @spec full?(t) :: boolean
  def full?(buffer), do: buffer.bytes >= @full

  @doc "All records in their order."
  @spec records(t) :: iodata
  def records(buffer), do: Enum.reverse(buffer.entries)
end
