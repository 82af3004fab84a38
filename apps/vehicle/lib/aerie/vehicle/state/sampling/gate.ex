defmodule Aerie.Vehicle.State.Sampling.Gate do
  @moduledoc """
  Passes values that matter, at most once per period, and one that does not when the last one was too long ago.
  """

  defstruct [:period_us, :refresh_us, :last, :last_at, :held]

  @type t :: %__MODULE__{
          period_us: pos_integer(),
          refresh_us: pos_integer() | nil,
          last: map() | nil,
          last_at: integer() | nil,
          held: {integer(), map()} | nil
        }

  @spec new(pos_integer(), pos_integer() | nil) :: t()
  def new(period_us, refresh_us), do: %__MODULE__{period_us: period_us, refresh_us: refresh_us}

  @doc "A value; `matters?.(last, value)` says whether it is to be passed."
  @spec push(t(), integer(), map(), (map(), map() -> boolean())) :: {t(), [{integer(), map()}]}
  def push(%{last: nil} = gate, at, data, _matters?), do: give(gate, at, at, data)

  def push(gate, at, data, matters?) do
    early = at - gate.last_at < gate.period_us

    cond do
      matters?.(gate.last, data) ->
        if early, do: {%{gate | held: {at, data}}, []}, else: give(gate, at, at, data)

      gate.refresh_us != nil and at - gate.last_at >= gate.refresh_us ->
        give(gate, at, at, data)

      true ->
        {%{gate | held: nil}, []}
    end
  end

  @spec expire(t(), integer()) :: {t(), [{integer(), map()}]}
  def expire(%{held: nil} = gate, _now), do: {gate, []}

  def expire(%{held: {at, data}} = gate, now) when now - gate.last_at >= gate.period_us,
    do: give(gate, now, at, data)

  def expire(gate, _now), do: {gate, []}

  defp give(gate, now, at, data), do: {%{gate | last: data, last_at: now, held: nil}, [{at, data}]}
end
