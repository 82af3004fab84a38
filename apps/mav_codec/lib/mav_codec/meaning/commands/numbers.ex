defmodule MavCodec.Meaning.Commands.Numbers do
  @moduledoc """
  Parameters of MAV_CMDs that are enumerations, flags or indices, although they are sent as floats. Firmwares turn them
  into integers in different ways: PX4 rounds some and truncates others, ArduPilot compares some within a tolerance and
  keeps one byte of others. So such a parameter has to be the integer that it means, in its range. NaN counts as 0, as
  both firmwares read it.

  Which parameters are meant follows from the definitions: those with an enumeration, and those without a unit that
  count in ones. A row may say otherwise.
  """

  import Bitwise

  alias MavCodec.Enums
  alias MavCodec.Enums.MavCmd

  # The largest number up to which a float on the wire has every integer.
  @exact 16_777_215

  @typedoc "One of some values, a set of bits, or an integer in a range."
  @type kind :: {:values, [integer()]} | {:flags, non_neg_integer()} | {:index, integer(), integer()}

  @doc """
  The parameters of a command that have to be integers, by the definitions, with those of its row in place of them.
  """
  @spec of(0..65_535, keyword() | [{1..7, kind() | :any}]) :: [{1..7, kind()}]
  def of(id, given) do
    defined = for param <- MavCmd.params(id), kind = defined(param), into: %{}, do: {param.index, kind}
    merged = Map.merge(defined, Map.new(given))
    Enum.sort(for {index, kind} <- merged, kind != :any, do: {index, kind})
  end

  defp defined(%{reserved: true}), do: nil
  defp defined(%{enum: enum}) when is_binary(enum), do: values(enum)

  defp defined(%{increment: step, units: nil} = param) when step == 1.0,
    do: {:index, min(trunc(param.min || 0), 0), trunc(param.max || @exact)}

  defp defined(_param), do: nil

  defp values(enum) do
    module = Module.concat(Enums, enum |> String.downcase() |> Macro.camelize())
    values = for {_name, value} <- module.all(), do: value

    if function_exported?(module, :flags, 1),
      do: {:flags, Enum.reduce(values, 0, &(&1 ||| &2))},
      else: {:values, values}
  end

  @doc """
  The integer that a parameter is; `:error` for one that firmwares may read in different ways, or that is not in its
  range.
  """
  @spec read(term(), kind()) :: {:ok, integer()} | :error
  def read(value, kind) do
    with {:ok, number} <- integer(value),
         true <- within?(number, kind),
         do: {:ok, number},
         else: (_other -> :error)
  end

  @doc "The integer that a parameter is, NaN and nothing being 0."
  @spec integer(term()) :: {:ok, integer()} | :error
  def integer(value) when is_integer(value), do: {:ok, value}
  def integer(value) when is_float(value) and value == trunc(value), do: {:ok, trunc(value)}
  def integer(nan) when nan in [:nan, nil], do: {:ok, 0}
  def integer({:nan, _bits}), do: {:ok, 0}
  def integer(_other), do: :error

  defp within?(number, {:values, values}), do: number in values
  defp within?(number, {:flags, mask}), do: number >= 0 and band(number, bnot(mask)) == 0
  defp within?(number, {:index, min, max}), do: number in min..max

  @doc "Describes the values of a parameter."
  @spec text(kind()) :: String.t()
  def text({:values, values}), do: "one of #{Enum.join(values, ", ")}"
  def text({:flags, 1}), do: "0 or 1"
  def text({:flags, mask}), do: "an integer with bits of #{mask}"
  def text({:index, min, max}), do: "an integer from #{min} to #{max}"
end
