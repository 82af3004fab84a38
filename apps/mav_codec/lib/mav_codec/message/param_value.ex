defmodule MavCodec.Message.ParamValue do
  @moduledoc """
  The value of a parameter and the float that PARAM_VALUE and PARAM_SET carry (P2).

  PX4, Betaflight and iNav put the bytes of an integer into the float (`:bytewise`), ArduPilot converts the number
  (`:c_cast`). Ground stations take the bytes from every autopilot but ArduPilot. A float has 24 bits for a number, so
  the conversion can change integers from 2^24 (16,777,216) on: such a value is marked as not exact when it is read,
  and refused when it would be changed on sending.
  """

  alias MavCodec.Message.Value

  @ranges %{
    1 => {0, 0xFF},
    2 => {-0x80, 0x7F},
    3 => {0, 0xFFFF},
    4 => {-0x8000, 0x7FFF},
    5 => {0, 0xFFFFFFFF},
    6 => {-0x80000000, 0x7FFFFFFF}
  }
  @integers Map.keys(@ranges)
  @bits %{1 => 8, 2 => 8, 3 => 16, 4 => 16, 5 => 32, 6 => 32}
  @uint32 5
  @real32 9
  @exact_limit 0x1000000

  @type encoding :: :c_cast | :bytewise
  @type wire :: Value.extended_float()

  @doc "The value and whether it is exact; `:error` for NaN and infinity."
  @spec decode(wire(), type :: integer(), encoding()) :: {:ok, number(), exact? :: boolean()} | :error
  def decode(wire, type, :bytewise) when type in @integers,
    do: {:ok, integer(<<Value.bits32(wire)::32>>, type), true}

  def decode(wire, type, :c_cast) when type in @integers and is_float(wire) do
    value = round(wire)
    {:ok, value, abs(value) < @exact_limit}
  end

  def decode(wire, _type, _encoding) when is_float(wire), do: {:ok, wire, true}
  def decode(_wire, _type, _encoding), do: :error

  @doc """
  The number that a PARAM_SET asks for, or why that is not known. With `:c_cast` the float is the number, whatever the
  type says.

  With `:bytewise` an integer type has bytes, and REAL32 a number, which also sets an integer. Bytes that make the float
  a whole number are an error, unless they may be an unsigned integer of 32 bits: somebody converted the number, or,
  with 8 or 16 bits, the other bytes are what was in memory, as older ones of QGroundControl send them.
  """
  @spec asked(wire(), type :: integer(), encoding()) :: {:ok, number()} | {:error, String.t()}
  def asked(wire, type, :bytewise) when type in @integers do
    {:ok, value, _exact?} = decode(wire, type, :bytewise)

    if type != @uint32 and number?(wire, type) and wire != value,
      do:
        {:error, "it has an integer's type, and its float is a number: send the integer's bytes, or REAL32"},
      else: {:ok, value}
  end

  def asked(wire, _type, _encoding) when is_float(wire), do: {:ok, wire}
  def asked(_wire, _type, _encoding), do: {:error, "it is not a number"}

  defp number?(wire, type) when is_float(wire) do
    {low, high} = @ranges[type]
    abs(wire) >= 1 and abs(wire) <= @exact_limit and wire == trunc(wire) and wire >= low and wire <= high
  end

  defp number?(_special, _type), do: false

  @doc "The float for a value, or an error that says why the value cannot be sent unchanged."
  @spec encode(number(), type :: integer(), encoding()) :: {:ok, wire()} | {:error, String.t()}
  def encode(value, type, encoding) when type in @integers do
    {lowest, highest} = Map.fetch!(@ranges, type)

    cond do
      value != trunc(value) ->
        {:error, "expected an integer, got #{value}"}

      value < lowest or value > highest ->
        {:error, "expected #{lowest} to #{highest}, got #{trunc(value)}"}

      encoding == :bytewise ->
        size = @bits[type]
        <<bits::32>> = <<0::size(32 - size), trunc(value)::size(size)>>
        {:ok, Value.float32(bits)}

      trunc(float32(value)) != trunc(value) ->
        {:error,
         "#{trunc(value)} would become #{trunc(float32(value))}: " <>
           "this firmware takes integers as floats, which have 24 bits"}

      true ->
        {:ok, value * 1.0}
    end
  end

  def encode(value, @real32, _encoding) do
    if abs(value) <= Value.largest_float(),
      do: {:ok, float32(value)},
      else: {:error, "#{value} is too large for a 32-bit float"}
  end

  def encode(_value, type, _encoding),
    do: {:error, "parameters of type #{type} do not fit into PARAM_SET"}

  @doc "Whether two values are the same for a vehicle: floats with 32 bits, integers exactly. nil is not a number."
  @spec same?(number() | nil, number() | nil) :: boolean()
  def same?(a, b) when a == nil or b == nil, do: a == b
  def same?(a, b) when is_integer(a) and is_integer(b), do: a == b
  def same?(a, b), do: a == b or float32(a) == float32(b)

  @doc "The nearest number that a 32-bit float can have; the number itself if it is too large for one."
  @spec float32(number()) :: number()
  def float32(number) do
    if abs(number) <= Value.largest_float() do
      <<float::float-32>> = <<number * 1.0::float-32>>
      float
    else
      number
    end
  end

  @doc "Lowest and highest value of an integer type, nil for floats."
  @spec range(integer()) :: {integer(), integer()} | nil
  def range(type), do: @ranges[type]

  defp integer(<<_::24, value::unsigned-8>>, 1), do: value
  defp integer(<<_::24, value::signed-8>>, 2), do: value
  defp integer(<<_::16, value::unsigned-16>>, 3), do: value
  defp integer(<<_::16, value::signed-16>>, 4), do: value
  defp integer(<<value::unsigned-32>>, 5), do: value
  defp integer(<<value::signed-32>>, 6), do: value
end
