defmodule Aerie.Control.Ftp.RoundTrip do
  @moduledoc """
  How long to wait for an answer, in microseconds: from the measured round trip, as TCP does it (RFC 6298). MAVLink's
  recommendation of 50 ms (T1) is shorter than the round trip of most radios.

  Only answers to requests that were sent once are measured: an answer after a repetition may belong to either.
  """

  @unmeasured 1_000_000
  @shortest 100_000
  @longest 10_000_000
  @silence 8_000_000

  defstruct [:smooth, :spread]

  @type t :: %__MODULE__{smooth: number() | nil, spread: number() | nil}

  @doc "Starts with the link's measured round trip, or nil."
  @spec new(rtt_us :: non_neg_integer() | nil) :: t()
  def new(nil), do: %__MODULE__{}
  def new(rtt), do: %__MODULE__{smooth: rtt, spread: rtt / 2}

  @doc "Records how long an answer took."
  @spec sample(t(), non_neg_integer()) :: t()
  def sample(%{smooth: nil}, us), do: new(us)

  def sample(%{smooth: smooth, spread: spread}, us),
    do: %__MODULE__{smooth: 0.875 * smooth + 0.125 * us, spread: 0.75 * spread + 0.25 * abs(smooth - us)}

  @doc "The longest wait, whatever was measured."
  @spec longest() :: pos_integer()
  def longest, do: @longest

  @doc """
  How long a vehicle may be silent before it is given up, however often it was asked: on a fast link the repetitions are over in a
  second or two, for which a radio roams or a computer stands still.
  """
  @spec silence() :: pos_integer()
  def silence, do: @silence

  @doc "How long to wait for an answer after `repeats` repetitions; the wait doubles up to three times."
  @spec timeout(t(), non_neg_integer()) :: pos_integer()
  def timeout(trip, repeats \\ 0) do
    once = if trip.smooth, do: round(trip.smooth + 4 * trip.spread), else: @unmeasured
    min(max(once, @shortest) * Integer.pow(2, min(repeats, 3)), @longest)
  end
end
