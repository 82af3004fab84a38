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

  @doc "The first request, for a parameter of a firmware's table."
  @spec first(Messages.firmware(), Params.t()) :: map
  def first(firmware, param) do
    %{by: __MODULE__, param: param, type: type(firmware, param), ask: {param.block, %{}}, stage: :before}
  end

  @impl Msp.Session.Params
  def again(%{param: param}), do: {param.block, %{}}

  @impl Msp.Session.Params
  def read(%{param: param, type: type}, values) do
    case values[param.field] do
      nil -> {:error, "this build does not have it"}
      number -> {:ok, values, value(param, number), Answers.type(type, param.high)}
    end
  end

  @impl Msp.Session.Params
  def write(%{param: param, type: type, value: value}, values) do
    with {:ok, number} <- number(param, type, value) do
      wanted = Block.put(values, param.field, number)
      {:ok, {Block.write_name(param.block), Block.writing(param.block, wanted)}, wanted}
    end
  end

  # As it is on the wire; Betaflight checks no range.
  defp number(%{low: low, high: high} = param, type, value) do
    number = param.base + param.step * value

    cond do
      number != round(number) ->
        {:error, "it is a whole number"}

      low != nil and (value < low or value > high) ->
        {:error, "it goes from #{low} to #{high}"}

      param.values != [] and round(value) not in 0..(length(param.values) - 1) ->
        {:error, "it goes from 0 to #{length(param.values) - 1}"}

      round(number) not in @ranges[type] ->
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
  @spec told(Messages.firmware(), Params.t()) :: Answers.type()
  def told(firmware, param), do: Answers.type(type(firmware, param), param.high)

  defp type(firmware, param) do
    {:ok, block} = Messages.fetch(firmware, param.block)

    Enum.find_value(block.reply, fn field ->
      if is_map_key(field, :key) and field.key == param.field, do: field.type
    end)
  end
end
