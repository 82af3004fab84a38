defmodule SimVehicle.Real32 do
  @moduledoc """
  32-bit floats as bit patterns, for PX4's habit of carrying an integer's bytes in a float field.

  A pattern that is not a number is what the codec makes of it: `:infinity`, `:neg_infinity`, `:nan` or `{:nan, bits}`.
  """

  alias MavCodec.Message.Value

  @type value :: Value.extended_float() | integer

  @doc "The value whose 32 bits are `bits`."
  @spec from_bits(non_neg_integer) :: value
  defdelegate from_bits(bits), to: Value, as: :float32

  @doc "The 32 bits of a value."
  @spec to_bits(value) :: non_neg_integer
  defdelegate to_bits(value), to: Value, as: :bits32

  @doc "The number, or nil for anything that is not finite."
  @spec number(value | nil) :: float | integer | nil
  def number(value) when is_number(value), do: value
  def number(_other), do: nil

  @doc "The value as a 32-bit float keeps it (what comes back after a trip over the wire)."
  @spec round32(value) :: value
  def round32(value), do: value |> to_bits() |> from_bits()
end
