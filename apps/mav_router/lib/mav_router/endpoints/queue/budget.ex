defmodule MavRouter.Endpoints.Queue.Budget do
  @report_ms 10_000

  @moduledoc """
  How many bytes may go out by a link: a token bucket that fills at the rate of the line, corrected by the radio.

  A serial line at 57,600 baud takes 5,760 bytes a second, and the radio behind it perhaps half of that. More than
  that would wait in buffers that nobody can look into, and a command would wait behind it for seconds. So no more is
  written than the line takes, and what is important goes first (`MavRouter.Endpoints.Queue.ClassQueue`).

  RADIO_STATUS tells how much room is left in the radio's buffer (`txbuf`, per cent): little room lowers the rate,
  much room raises it again, between a twentieth and the whole of the line's rate. Radios report once a second; if a
  radio says nothing for
  #{div(@report_ms, 1_000)} s, its last report does not hold any more, or a link would stay slow for good.

  Rates are bytes a second, times monotonic ms. A frame may be sent while there is any token left, so the bucket may go
  into debt by one frame.
  """

  @enforce_keys [:rate, :capacity, :tokens, :at]
  defstruct [:rate, :capacity, :tokens, :at, :reported, factor: 1.0]

  @type t :: %__MODULE__{
          rate: pos_integer,
          capacity: float,
          tokens: float,
          at: integer,
          reported: integer | nil,
          factor: float
        }

  @lowest 0.05
  # A burst of a tenth of a second, and always room for the longest frame.
  @burst_s 0.1
  @longest 300

  @doc "A full bucket for a rate in bytes a second."
  @spec new(pos_integer, integer) :: t
  def new(rate, now) when is_integer(rate) and rate > 0 do
    capacity = max(rate * @burst_s, @longest / 1)
    %__MODULE__{rate: rate, capacity: capacity, tokens: capacity, at: now}
  end

  @doc "The rate of a serial line in bytes a second: ten bits a byte."
  @spec of_baud(pos_integer) :: pos_integer
  def of_baud(baud), do: max(div(baud, 10), 1)

  @doc "Adds the tokens since the last time."
  @spec fill(t, integer) :: t
  def fill(%__MODULE__{at: at} = budget, now) when now <= at, do: budget

  def fill(%__MODULE__{reported: reported} = budget, now)
      when reported != nil and now - reported > @report_ms,
      do: fill(%{budget | reported: nil, factor: 1.0}, now)

  def fill(budget, now) do
    tokens = min(budget.tokens + (now - budget.at) * rate(budget) / 1000, budget.capacity)
    %{budget | tokens: tokens, at: now}
  end

  @doc "Whether a frame may go out now."
  @spec open?(t) :: boolean
  def open?(%__MODULE__{tokens: tokens}), do: tokens > 0

  @doc "Bytes went out."
  @spec spend(t, non_neg_integer) :: t
  def spend(budget, bytes), do: %{budget | tokens: budget.tokens - bytes}

  @doc "How long until a frame may go out, in ms; 0 when it may now."
  @spec wait_ms(t) :: non_neg_integer
  def wait_ms(%__MODULE__{tokens: tokens}) when tokens > 0, do: 0
  def wait_ms(budget), do: max(ceil((1 - budget.tokens) * 1000 / rate(budget)), 1)

  @doc "The radio's report at `now`: room in its buffer in percent. Other values (255: unknown) change nothing."
  @spec radio(t, non_neg_integer, integer) :: t
  def radio(budget, txbuf, now) when txbuf in 0..100 do
    change =
      cond do
        txbuf < 20 -> 0.7
        txbuf < 50 -> 0.9
        txbuf > 95 -> 1.1
        txbuf > 80 -> 1.03
        true -> 1.0
      end

    %{budget | factor: (budget.factor * change) |> min(1.0) |> max(@lowest), reported: now}
  end

  def radio(budget, _unknown, _now), do: budget

  @doc "The present rate in bytes a second."
  @spec rate(t) :: float
  def rate(%__MODULE__{rate: rate, factor: factor}) when is_float(factor), do: rate * factor
end
