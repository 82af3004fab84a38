defmodule Aerie.Vehicle.Services.Streams.WantedMessage do
  @moduledoc """
  One message that is wanted of a vehicle, and the state of its request. A pure value of `Aerie.Vehicle.Services.Streams.Arbiter`.

  | state | meaning |
  |---|---|
  | `:new` | not judged yet |
  | `:ok` | comes as wanted |
  | `:asked` | requested, to be judged |
  | `:query` | came as requested and became too slow: the vehicle is asked for its interval |
  | `:short` | still too slow after all tries, or too fast for the link; nothing more is sent |
  | `:missing` | never came, or was refused; nothing more is sent |
  | `:yielded` | another program changed it again after our request; it is left to that program |
  """

  alias Aerie.Base.Json.Object
  alias MavCodec.Dialects.All

  # A lower share of the wanted rate is too slow: schedulers round, and radios lose some.
  @retries_us [3_000_000, 10_000_000]
  @enough 0.7
  # The threshold for a message that came as wanted is lower, so that a rate at the limit does not alternate.
  @too_slow 0.6
  @faster 1.6
  @gone_us 10_000_000
  @min_window_us 3_000_000
  @max_window_us 60_000_000
  # How many messages a rate is measured over.
  @sample 6

  @enforce_keys [:id, :ask]
  defstruct [
    :id,
    :ask,
    :hz,
    :set,
    :initial,
    :rate,
    :next,
    state: :new,
    tries: 0,
    changes: [],
    queries: [],
    faster: false
  ]

  @typedoc """
  Rates are in messages per second.

  - `hz`: the wanted rate; nil if any rate will do
  - `ask`: the rate to request
  - `set`: the rate that was last requested since the vehicle's boot, by us or through us; nil for none
  - `initial`: the rate before the first request; 0 if the message came but was not measured yet
  - `rate`: the rate last measured
  - `next`: when it is judged again; `tries`: how often it was requested in a row
  - `changes`: when another program changed it; `queries`: when the vehicle was asked for its interval
  """
  @type t :: %__MODULE__{
          id: non_neg_integer(),
          ask: number(),
          hz: number() | nil,
          set: number() | nil,
          initial: number() | nil,
          rate: float() | nil,
          next: integer() | nil,
          state: :new | :ok | :asked | :query | :short | :missing | :yielded,
          tries: non_neg_integer(),
          changes: [integer()],
          queries: [integer()],
          faster: boolean()
        }

  @type verdict :: :wait | :good | :faster | :short

  @doc "How long a rate has to be measured (us)."
  @spec window(t()) :: pos_integer()
  def window(%{hz: nil}), do: @min_window_us

  def window(%{hz: hz}), do: round(@sample * 1_000_000 / hz) |> max(@min_window_us) |> min(@max_window_us)

  @doc "Judges the measured rate, nil if it is not known yet; `last` is when the message last came."
  @spec evaluate(t(), float() | nil, integer() | nil, integer()) :: verdict()
  def evaluate(wanted, rate, last, now)

  # Any rate will do: too slow means that it never came, or has not come for a while.
  def evaluate(%{hz: nil, state: state}, _rate, nil, _now) when state in [:new, :asked], do: :short

  def evaluate(%{hz: nil} = wanted, rate, last, now) do
    cond do
      last == nil or now - last > @gone_us -> :short
      rate != nil and faster?(wanted, rate) -> :faster
      true -> :good
    end
  end

  # We have requested less than is wanted now.
  def evaluate(%{hz: hz, state: :new, set: set}, _rate, _last, _now) when set != nil and set < hz, do: :short
  def evaluate(_line, nil, _last, _now), do: :wait
  def evaluate(%{hz: hz, state: :ok}, rate, _last, _now) when rate < hz * @too_slow, do: :short

  def evaluate(%{hz: hz, state: state}, rate, _last, _now) when state != :ok and rate < hz * @enough,
    do: :short

  def evaluate(wanted, rate, _last, _now), do: if(faster?(wanted, rate), do: :faster, else: :good)

  # Only a rate that was as requested before can have been changed by another program.
  defp faster?(%{state: :ok} = wanted, rate), do: raised?(wanted, rate)
  defp faster?(_line, _rate), do: false

  @doc "Whether a rate is far higher than what was requested."
  @spec raised?(t(), number()) :: boolean()
  def raised?(%{set: set}, rate), do: set != nil and rate > set * @faster and rate > set + 1

  @doc "It was requested at a rate (0: the vehicle's default); `last` is when it last came."
  @spec asked(t(), number(), integer() | nil) :: t()
  # Not measured yet, so it can only be reset to the vehicle's default.
  def asked(%{set: nil, initial: nil} = wanted, hz, last) when last != nil,
    do: asked(%{wanted | initial: 0}, hz, nil)

  def asked(wanted, hz, _last) when hz == 0, do: %{wanted | set: nil}
  def asked(wanted, hz, _last), do: %{wanted | set: hz}

  @doc "Whether the vehicle's interval (us; -1: disabled, 0: unknown message) is what was requested."
  @spec as_set?(t(), integer()) :: boolean()
  def as_set?(%{set: set}, interval) when interval > 0 and set != nil,
    do: 1_000_000 / interval >= set * @enough

  def as_set?(_line, _interval), do: false

  @doc "The rate of a message that is reset: what is wanted of it, but not less than it had before the first request."
  @spec least(t()) :: number()
  def least(wanted), do: max(wanted.hz || 0, wanted.initial || wanted.ask)

  @doc "How long after a request its effect is judged (us)."
  @spec wait(t()) :: pos_integer()
  def wait(wanted), do: max(retry_us(wanted.tries - 1), window(wanted))

  @doc "How long after the request of this number (from 0) it is repeated (us)."
  @spec retry_us(non_neg_integer()) :: non_neg_integer()
  def retry_us(tries), do: Enum.at(@retries_us, tries, 0)

  @states [:new, :asked, :query, :ok, :short, :missing, :yielded]
  @fields Object.fields([
            {:id, :integer, nil, "message id"},
            {:message, :text, nil, "message name", &__MODULE__.name/1},
            {:state, {:one_of, @states}, nil,
             "new, asked, query, ok, short (too slow), missing, yielded (left to another program)"},
            {:wanted_hz, 2, "1/s", "wanted rate; null: any rate", :wanted},
            {:asked_hz, 2, "1/s", "requested rate", :asked},
            {:measured_hz, 2, "1/s", "measured rate", :measured}
          ])

  @doc "What people are shown of `show/1` and the message's `:id`."
  @spec fields() :: [Object.t()]
  def fields, do: @fields

  @doc false
  @spec name(map()) :: String.t() | nil
  def name(%{id: id}), do: All.name(id)

  @doc "For the snapshot."
  @spec show(t()) :: map()
  def show(wanted), do: %{state: wanted.state, wanted: wanted.hz, asked: wanted.set, measured: wanted.rate}
end
