defmodule Msp.Session.Params.Blocks do
  @moduledoc """
  One parameter of Betaflight that is a field of a block: its block is read; to set it, that is written with the field changed, and read again.
  What is then there is reported.
  """

  alias MavCodec.Msp.{Messages, Params}
  alias Msp.Params.Block
  alias Msp.Session
  alias Msp.Session.Params.Answers
  alias Msp.Session.{Output, Tasks}

  # What fits into a field.
  @ranges %{
    u8: 0..0xFF,
    i8: -0x80..0x7F,
    u16: 0..0xFFFF,
    i16: -0x8000..0x7FFF,
    u32: 0..0xFFFFFFFF
  }
  @notice 5

  @doc "The first request, for a parameter of the table."
  @spec first(Params.t()) :: map
  def first(param), do: %{by: __MODULE__, param: param, ask: {param.block, %{}}, stage: :before}

  @doc "The answer to a request of the task."
  @spec answer(Session.t(), Tasks.task(), Tasks.answer()) :: Session.t()
  def answer(session, %{stage: :before, param: param} = task, {:ok, values}) do
    case values[param.field] do
      nil -> Answers.refuse(session, task, :unknown, "this build does not have it")
      number when task.what == :read -> Answers.report(session, task, value(param, number), told(param))
      _number -> write(session, task, values)
    end
  end

  def answer(session, %{stage: :written} = task, {:ok, _acknowledged}),
    do: Tasks.ask_next(session, task, %{stage: :check, ask: {task.param.block, %{}}})

  def answer(session, %{stage: :check, param: param, wanted: wanted} = task, {:ok, values}) do
    session =
      if values == wanted,
        do: session,
        else: Output.text(session, @notice, "#{task.name}: its block is not as it was written")

    session |> Answers.changed() |> Answers.report(task, value(param, values[param.field] || 0), told(param))
  end

  def answer(session, %{stage: :before} = task, :refused),
    do: Answers.refuse(session, task, :unknown, "this firmware does not have it")

  def answer(session, task, :refused),
    do: Answers.refuse(session, task, :denied, "the flight controller refused it")

  defp write(session, %{param: param} = task, values) do
    case number(param, task.value) do
      {:ok, number} ->
        wanted = Block.put(values, param.field, number)
        ask = {Block.write_name(param.block), Block.writing(param.block, wanted)}
        Tasks.ask_next(session, task, %{stage: :written, wanted: wanted, ask: ask})

      {:error, why} ->
        Answers.refuse(session, task, :out_of_range, why)
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
