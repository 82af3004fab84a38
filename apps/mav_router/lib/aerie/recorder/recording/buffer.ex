defmodule Aerie.Recorder.Recording.Buffer do
  @moduledoc """
  Records that are collected until they are written together. A pure value.

  `waiting` are the bytes of the queue (`Aerie.Recorder.Tap`) that are answered for when these are written, or dropped: what
  is collected still takes memory.
  """

  @full 65_536

  defstruct entries: [], bytes: 0, frames: 0, waiting: 0

  @type t :: %__MODULE__{
          entries: [binary],
          bytes: non_neg_integer,
          frames: non_neg_integer,
          waiting: non_neg_integer
        }

  @doc "Adds the records of some frames. Copied, so that nothing of a link's reads stays in memory for them."
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

  @doc "Notes bytes of the queue that wait for this to be written."
  @spec wait(t, non_neg_integer) :: t
  def wait(buffer, bytes), do: %{buffer | waiting: buffer.waiting + bytes}

  @spec empty?(t) :: boolean
  def empty?(buffer), do: buffer.entries == []

  @doc "Whether there is as much as is written at once."
  @spec full?(t) :: boolean
  def full?(buffer), do: buffer.bytes >= @full

  @doc "All records in their order."
  @spec records(t) :: iodata
  def records(buffer), do: Enum.reverse(buffer.entries)
end
