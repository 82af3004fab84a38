defmodule SimVehicle.Real32 do
  @moduledoc """
  32-bit floats as bit patterns, for PX4's habit of carrying an integer's bytes in a float field.

  A pattern that is no number is what the codec makes of it: `:infinity`, `:neg_infinity`, `:nan` or `{:nan, bits}`.
  """

  @type value :: float | integer | :nan | :infinity | :neg_infinity | {:nan, non_neg_integer}

  @doc "The value whose 32 bits are `bits`."
  @spec from_bits(non_neg_integer) :: value
  def from_bits(bits) do
    case <<bits::32>> do
      <<value::float-32>> -> value
      <<0x7F80_0000::32>> -> :infinity
      <<0xFF80_0000::32>> -> :neg_infinity
      _nan -> {:nan, bits}
    end
  end

  @doc "The 32 bits of a value."
  @spec to_bits(value) :: non_neg_integer
  def to_bits(:nan), do: 0x7FC0_0000
  def to_bits({:nan, bits}), do: bits
  def to_bits(:infinity), do: 0x7F80_0000
  def to_bits(:neg_infinity), do: 0xFF80_0000

  def to_bits(number) do
    <<bits::32>> = <<number::float-32>>
    bits
  end

  @doc "The number, or nil for anything that is not finite."
  @spec number(value | nil) :: float | integer | nil
  def number(value) when is_number(value), do: value
  def number(_other), do: nil

  @doc "The value as a 32-bit float keeps it (what comes back after a trip over the wire)."
  @spec round32(value) :: value
  def round32(value), do: value |> to_bits() |> from_bits()
end
