defmodule Msp.Session.Params.Blocks do
  @moduledoc """
  One parameter of Betaflight that is a field of a block: its block is read; to set it, that is written with the field changed, and read again.
  """
  @behaviour Msp.Session.Params

  alias MavCodec.Msp.{Messages, Params}
  alias Msp.Params.Block
  alias Msp.Session.Params.Answers

  # What fits into a field.
  @ranges %{
    u8: 0..0xFF,
    i8: -0x80..0x7F,
    u16: 0..0xFFFF,
    i16: -0x8000..0x7FFF,
    u32: 0..0xFFFFFFFF
  }

  @doc "The first request, for a parameter of the table."
  @spec first(Params.t()) :: map
  def first(param), do: %{by: __MODULE__, param: param, ask: {param.block, %{}}, stage: :before}

  @impl Msp.Session.Params
  def again(%{param: param}), do: {param.block, %{}}

  @impl Msp.Session.Params
  def read(%{param: param}, values) do
    case values[param.field] do
      nil -> {:error, "this build does not have it"}
      number -> {:ok, values, value(param, number), told(param)}
    end
  end

  @impl Msp.Session.Params
  def write(%{param: param, value: value}, values) do
    with {:ok, number} <- number(param, value) do
      wanted = Block.put(values, param.field, number)
      {:ok, {Block.write_name(param.block), Block.writing(param.block, wanted)}, wanted}
    end
  end

  # As it is on the wire; Betaflight checks no range.
  defp number(%{low: low, high: high} = param, value) do
    number = param.base + param.step * value

    cond do
      number != round(number) ->
        {:error, "it is a whole number"}

      low != nil and (value < low or value > high) ->
        {:error, "it goes from #{low} to #{high}"}

      param.values != [] and round(value) not in 0..(length(param.values) - 1) ->
        {:error, "it goes from 0 to #{length(param.values) - 1}"}

      round(number) not in @ranges[type(param)] ->
        {:error, "it does not fit"}

      true ->
        {:ok, round(number)}
    end
  end

  @doc "The parameter's value, of the number in its block."
  @spec value(Params.t(), integer) :: integer
  def value(%{base: 0, step: 1}, number), do: number
  def value(param, number), do: div(number - param.base, param.step)

  @doc "The type by which clients get it."
  @spec told(Params.t()) :: Answers.type()
  def told(param), do: Answers.type(type(param), param.high)

  defp type(param) do
    {:ok, block} = Messages.fetch(:betaflight, param.block)

    Enum.find_value(block.reply, fn field ->
      if is_map_key(field, :key) and field.key == param.field, do: field.type
    end)
  end
end
