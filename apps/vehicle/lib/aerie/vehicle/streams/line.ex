defmodule Aerie.Vehicle.Streams.Line do
  @moduledoc """
  One message that is wanted of a vehicle, and how far that has come. A pure value; `Aerie.Vehicle.Streams.Arbiter` moves it.

  | state | meaning |
  |---|---|
  | `:new` | not judged yet |
  | `:ok` | comes as wanted |
  | `:asked` | asked for, to be judged |
  | `:query` | came as asked for and does no more: the vehicle is asked what is set |
  | `:short` | asked for often enough, or set rightly while the link does not carry it; left alone |
  | `:missing` | never came or was refused; left alone |
  | `:yielded` | somebody else changed it again after us; left to them |
  """

  # Below this share of what is wanted it is too little: a scheduler rounds, a radio loses some.
  @enough 0.7
  # What came as wanted has to fall below this one to be too little: at the border of one it would be both in turn.
  @too_little 0.6
  @faster 1.6
  @gone_us 10_000_000
  @min_window_us 3_000_000
  @max_window_us 60_000_000
  # So many messages make a rate.
  @sample 6

  @enforce_keys [:id, :ask]
  defstruct [
    :id,
    :ask,
    :hz,
    :set,
    :own,
    :rate,
    :next,
    :sent,
    state: :new,
    tries: 0,
    resets: [],
    queries: [],
    faster: false
  ]

  @typedoc """
  - `hz`: what is wanted at least; nil when any rate will do
  - `ask`: what to ask for when there is too little
  - `set`: what was last asked for since the vehicle's boot, by us or through us; nil for nothing
  - `own`: what came by itself, measured before anybody asked; 0 when it came but nobody had measured it yet
  - `rate`: measured last
  - `next`: when it is looked at again; `tries` how often it was asked for in a row
  - `resets`: when it was changed under us; `queries`: when the vehicle was asked what is set
  """
  @type t :: %__MODULE__{
          id: non_neg_integer(),
          ask: number(),
          hz: number() | nil,
          set: number() | nil,
          own: number() | nil,
          rate: float() | nil,
          next: integer() | nil,
          sent: integer() | nil,
          state: :new | :ok | :asked | :query | :short | :missing | :yielded,
          tries: non_neg_integer(),
          resets: [integer()],
          queries: [integer()],
          faster: boolean()
        }

  @type verdict :: :wait | :good | :faster | :short

  @doc "How long a rate has to be measured to be one (us)."
  @spec window(t()) :: pos_integer()
  def window(%{hz: nil}), do: @min_window_us

  def window(%{hz: hz}), do: round(@sample * 1_000_000 / hz) |> max(@min_window_us) |> min(@max_window_us)

  @doc "What the measured rate says; `rate` nil when it is not known yet, `last` when one came last."
  @spec judge(t(), float() | nil, integer() | nil, integer()) :: verdict()
  def judge(line, rate, last, now)

  # Any rate will do: it is missing when it never came, and gone when it has not come for a while.
  def judge(%{hz: nil, state: state}, _rate, nil, _now) when state in [:new, :asked], do: :short

  def judge(%{hz: nil} = line, rate, last, now) do
    cond do
      last == nil or now - last > @gone_us -> :short
      rate != nil and faster?(line, rate) -> :faster
      true -> :good
    end
  end

  # Set, by us, to less than what is wanted now.
  def judge(%{hz: hz, state: :new, set: set}, _rate, _last, _now) when set != nil and set < hz, do: :short
  def judge(_line, nil, _last, _now), do: :wait
  def judge(%{hz: hz, state: :ok}, rate, _last, _now) when rate < hz * @too_little, do: :short

  def judge(%{hz: hz, state: state}, rate, _last, _now) when state != :ok and rate < hz * @enough,
    do: :short

  def judge(line, rate, _last, _now), do: if(faster?(line, rate), do: :faster, else: :good)

  # Only what came as it was asked for before can have been changed by somebody.
  defp faster?(%{set: set, state: :ok}, rate) when set != nil, do: rate > set * @faster and rate > set + 1
  defp faster?(_line, _rate), do: false

  @doc "It was asked for, `hz` times a second (0: at the vehicle's default); `last` is when it came last."
  @spec asked(t(), number(), integer() | nil) :: t()
  # Not measured yet, so its default is all that can be given back.
  def asked(%{set: nil, own: nil} = line, hz, last) when last != nil, do: asked(%{line | own: 0}, hz, nil)
  def asked(line, hz, _last) when hz == 0, do: %{line | set: nil}
  def asked(line, hz, _last), do: %{line | set: hz}

  @doc "Whether an interval that the vehicle has set (us; -1: none, 0: unknown message) is what was asked for."
  @spec as_set?(t(), integer()) :: boolean()
  def as_set?(%{set: set}, interval) when interval > 0 and set != nil,
    do: 1_000_000 / interval >= set * @enough

  def as_set?(_line, _interval), do: false

  @doc "What faces see of it."
  @spec show(t()) :: map()
  def show(line), do: %{state: line.state, wanted: line.hz, asked: line.set, measured: line.rate}
end
