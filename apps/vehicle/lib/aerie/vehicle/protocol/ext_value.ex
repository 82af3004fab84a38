defmodule Aerie.Vehicle.Protocol.ExtValue do
  @moduledoc """
  The value of an extended parameter and the 128 bytes that PARAM_EXT_VALUE, PARAM_EXT_SET and PARAM_EXT_ACK carry (P8).

  A number is in the first bytes, little-endian, as its MAV_PARAM_EXT_TYPE says: integers of 8 to 64 bits, floats of 32
  and 64. The type CUSTOM, and any that MAVLink does not know, has text, or bytes: a value that is not printable text is
  `base64:` followed by them, so that each value can be shown, stored and sent back as it was. Text ends at the first
  zero: what a component left behind it does not count, nor do zeros at the end of bytes.
  """

  alias MavCodec.Message.Value

  @bytes 128
  @mark "base64:"
  @numbers %{
    1 => :uint8,
    2 => :int8,
    3 => :uint16,
    4 => :int16,
    5 => :uint32,
    6 => :int32,
    7 => :uint64,
    8 => :int64,
    9 => :float,
    10 => :double
  }
  @floats [9, 10]

  @typedoc "A number, or text; nil for a float that is not a number or infinite."
  @type t :: number() | String.t() | nil

  @doc "The value in the bytes of a message."
  @spec decode(binary(), type :: 0..255) :: t()
  def decode(<<value::8, _::binary>>, 1), do: value
  def decode(<<value::signed-8, _::binary>>, 2), do: value
  def decode(<<value::little-16, _::binary>>, 3), do: value
  def decode(<<value::little-signed-16, _::binary>>, 4), do: value
  def decode(<<value::little-32, _::binary>>, 5), do: value
  def decode(<<value::little-signed-32, _::binary>>, 6), do: value
  def decode(<<value::little-64, _::binary>>, 7), do: value
  def decode(<<value::little-signed-64, _::binary>>, 8), do: value
  def decode(<<value::float-little-32, _::binary>>, 9), do: value
  def decode(<<value::float-little-64, _::binary>>, 10), do: value
  def decode(_not_finite, type) when type in @floats, do: nil

  def decode(bytes, _custom) do
    bytes = String.trim_trailing(bytes, <<0>>)
    [text | _left_behind] = :binary.split(bytes, <<0>>)

    if (text != "" or bytes == "") and String.printable?(text) and not String.starts_with?(text, @mark),
      do: text,
      else: @mark <> Base.encode64(bytes)
  end

  @doc "The bytes for a value, or why it cannot be one of this type."
  @spec encode(term(), type :: 0..255) :: {:ok, binary()} | {:error, String.t()}
  def encode(value, type) when is_map_key(@numbers, type) and is_number(value) do
    # 5.0 is what a browser makes of 5.
    value = if type not in @floats and trunc(value) == value, do: trunc(value), else: value

    with {:error, expected} <- Value.encode(value, @numbers[type], nil) do
      expected = if type in @floats, do: "a number that fits a #{@numbers[type]}", else: expected
      {:error, "expected #{expected}, got #{value}"}
    end
  end

  def encode(_value, type) when is_map_key(@numbers, type), do: {:error, "expected a number"}

  def encode(@mark <> coded, _custom) do
    case Base.decode64(coded) do
      {:ok, bytes} when byte_size(bytes) <= @bytes -> {:ok, bytes}
      _other -> {:error, "expected base64 of at most #{@bytes} bytes behind #{@mark}"}
    end
  end

  def encode(value, _custom) when is_binary(value) and byte_size(value) <= @bytes do
    if String.contains?(value, <<0>>),
      do: {:error, "expected text without zeros, or #{@mark} and the bytes"},
      else: {:ok, value}
  end

  def encode(_value, _custom), do: {:error, "expected text of at most #{@bytes} bytes"}
end
