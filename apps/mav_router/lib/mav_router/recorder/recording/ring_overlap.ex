defmodule MavRouter.Recorder.Recording.RingOverlap do
  @moduledoc """
  The entries of the ring with which a recording began, so that no frame is written twice: the recording already gets frames when it
  reads the ring, and those that are in both have the number of their entry (`MavRouter.Recorder.Ring.push/5`). A pure value.
  """

  # Entries that come late are at most this many behind.
  @remembered 256

  defstruct taken: MapSet.new(), first: 0

  @type t :: %__MODULE__{taken: MapSet.t(pos_integer), first: non_neg_integer}

  @doc "No ring: every frame is new."
  @spec none() :: t
  def none, do: %__MODULE__{}

  @doc "These entries of a ring are written already."
  @spec new([{pos_integer, binary, pos_integer}]) :: t
  def new(entries) do
    taken = entries |> Enum.take(-@remembered) |> MapSet.new(&elem(&1, 0))
    %__MODULE__{taken: taken, first: Enum.min(taken, fn -> 0 end)}
  end

  @doc "Whether frames with the number of an entry (nil: in no ring) are written already."
  @spec has?(t, pos_integer | :sent | nil) :: boolean
  def has?(_past, none) when none in [nil, :sent], do: false
  def has?(past, n), do: n < past.first or MapSet.member?(past.taken, n)
end
