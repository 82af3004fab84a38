defmodule Aerie.Recorder.Recording.Past do
  @moduledoc """
  What a ring had when a recording began with it, so that no frame is written twice: the recording listens already when
  it reads the ring, and what is in both is told by the number of its entry (`Aerie.Recorder.Ring.push/5`). A pure value.
  """

  # Entries that come late are not older than this many.
  @remembered 256

  defstruct taken: MapSet.new(), first: 0

  @type t :: %__MODULE__{taken: MapSet.t(pos_integer), first: non_neg_integer}

  @doc "No past: everything is new."
  @spec none() :: t
  def none, do: %__MODULE__{}

  @doc "The past that these entries of a ring are."
  @spec new([{pos_integer, binary, pos_integer}]) :: t
  def new(entries) do
    taken = entries |> Enum.take(-@remembered) |> MapSet.new(&elem(&1, 0))
    %__MODULE__{taken: taken, first: Enum.min(taken, fn -> 0 end)}
  end

  @doc "Whether frames with the number of a ring's entry (nil: in no ring) are written already."
  @spec has?(t, pos_integer | nil) :: boolean
  def has?(_past, nil), do: false
  def has?(past, n), do: n < past.first or MapSet.member?(past.taken, n)
end
