defmodule MavCodec.Message.Value do
  @moduledoc """
  Single values on the wire, little-endian (F2): decoding of arrays, text and special floats for the generated decoders, and
  the encoding of every type.
  """

  import Bitwise

  @typedoc "A float, or a special value of IEEE 754; `{:nan, bits}` is a NaN other than the usual quiet one."
  @type extended_float :: float() | :nan | :infinity | :neg_infinity | {:nan, non_neg_integer()}

  @nan32 0x7FC00000
  @infinity32 0x7F800000
  @nan64 0x7FF8000000000000
  @infinity64 0x7FF0000000000000
  # The largest float plus half of its last place: from here on, rounding gives infinity.
  @float_limit ((1 <<< 25) - 1) <<< 103
  @double_limit ((1 <<< 53) - 1) <<< 971

  ## Decoding

  @doc "The float of 32 bits given as an integer."
  @spec float32(0..0xFFFFFFFF) :: extended_float()
  def float32(bits) do
    case <<bits::32>> do
      <<float::float-32>> -> float
      _other -> special32(bits)
    end
  end

  defp special32(@nan32), do: :nan
  defp special32(@infinity32), do: :infinity
  defp special32(0xFF800000), do: :neg_infinity
  defp special32(bits), do: {:nan, bits}

  @doc "The 32 bits of a float or of a number that 32 bits have; the inverse of `float32/1`."
  @spec bits32(extended_float() | integer()) :: 0..0xFFFFFFFF
  def bits32(:nan), do: @nan32
  def bits32(:infinity), do: @infinity32
  def bits32(:neg_infinity), do: 0xFF800000
  def bits32({:nan, bits}), do: bits

  def bits32(number) do
    <<bits::32>> = <<number::float-32>>
    bits
  end

  @doc "The double of 64 bits given as an integer."
  @spec float64(0..0xFFFFFFFFFFFFFFFF) :: extended_float()
  def float64(bits) do
    case <<bits::64>> do
      <<float::float-64>> -> float
      _other -> special64(bits)
    end
  end

  defp special64(@nan64), do: :nan
  defp special64(@infinity64), do: :infinity
  defp special64(0xFFF0000000000000), do: :neg_infinity
  defp special64(bits), do: {:nan, bits}

  @doc "Text up to the first NUL (F14)."
  @spec text(binary()) :: binary()
  def text(bytes), do: text(bytes, bytes, 0)

  defp text(<<0, _::binary>>, bytes, size), do: binary_part(bytes, 0, size)
  defp text(<<_, rest::binary>>, bytes, size), do: text(rest, bytes, size + 1)
  defp text(<<>>, bytes, _size), do: bytes

  @doc "The elements of an array."
  @spec list(binary(), MavCodec.Definition.Document.Field.scalar()) :: [integer() | extended_float()]
  def list(bytes, :float), do: floats(bytes)
  def list(bytes, :double), do: doubles(bytes)
  def list(bytes, :int8), do: for(<<x::signed-8 <- bytes>>, do: x)
  def list(bytes, :int16), do: for(<<x::little-signed-16 <- bytes>>, do: x)
  def list(bytes, :uint16), do: for(<<x::little-16 <- bytes>>, do: x)
  def list(bytes, :int32), do: for(<<x::little-signed-32 <- bytes>>, do: x)
  def list(bytes, :uint32), do: for(<<x::little-32 <- bytes>>, do: x)
  def list(bytes, :int64), do: for(<<x::little-signed-64 <- bytes>>, do: x)
  def list(bytes, :uint64), do: for(<<x::little-64 <- bytes>>, do: x)

  defp floats(<<float::float-little-32, rest::binary>>), do: [float | floats(rest)]
  defp floats(<<bits::little-32, rest::binary>>), do: [special32(bits) | floats(rest)]
  defp floats(<<>>), do: []

  defp doubles(<<float::float-little-64, rest::binary>>), do: [float | doubles(rest)]
  defp doubles(<<bits::little-64, rest::binary>>), do: [special64(bits) | doubles(rest)]
  defp doubles(<<>>), do: []

  ## Encoding

  @doc "The largest number that 32 bits have."
  @spec largest_float() :: float()
  def largest_float, do: 3.4028234663852886e38

  @doc "The least and the largest value of an integer type."
  @spec range(MavCodec.Definition.Document.Field.scalar()) :: {integer(), integer()}
  def range(type)

  @doc """
  The bytes of a field's value, or what was expected instead. No value wraps or is truncated; text and bytes
  shorter than the field are filled with zeros.
  """
  @spec encode(term(), MavCodec.Definition.Document.Field.scalar(), 1..255 | nil) ::
          {:ok, binary()} | {:error, expected :: String.t()}
  def encode(value, type, nil) when type != :char, do: scalar(value, type)
  def encode("", :char, nil), do: {:ok, <<0>>}
  def encode(<<character>>, :char, nil) when character != 0, do: {:ok, <<character>>}
  def encode(_value, :char, nil), do: {:error, "text of one character or none"}

  def encode(value, type, length) when type in [:char, :uint8] do
    cond do
      not is_binary(value) or byte_size(value) > length ->
        {:error, "a binary of at most #{length} bytes"}

      type == :char and byte_size(text(value)) < byte_size(value) ->
        {:error, "text without NUL bytes"}

      true ->
        {:ok, <<value::binary, 0::size(length - byte_size(value))-unit(8)>>}
    end
  end

  def encode(value, type, length) when is_list(value), do: elements(value, type, length, <<>>, length)
  def encode(_value, type, length), do: {:error, list_of(type, length)}

  defp elements([], _type, _length, acc, 0), do: {:ok, acc}

  defp elements([value | rest], type, length, acc, left) when left > 0 do
    case scalar(value, type) do
      {:ok, bytes} -> elements(rest, type, length, <<acc::binary, bytes::binary>>, left - 1)
      {:error, expected} -> {:error, "#{list_of(type, length)}, each #{expected}"}
    end
  end

  defp elements(_list, type, length, _acc, _left), do: {:error, list_of(type, length)}

  defp list_of(type, length), do: "a list of #{length} #{type} values"

  for {type, size} <- [
        uint8: 8,
        uint16: 16,
        uint32: 32,
        uint64: 64,
        int8: 8,
        int16: 16,
        int32: 32,
        int64: 64
      ] do
    {low, high} =
      if type in [:int8, :int16, :int32, :int64],
        do: {-(1 <<< (size - 1)), (1 <<< (size - 1)) - 1},
        else: {0, (1 <<< size) - 1}

    @low low
    @high high

    def range(unquote(type)), do: {@low, @high}

    defp scalar(value, unquote(type)) when is_integer(value) and value >= @low and value <= @high,
      do: {:ok, <<value::little-size(unquote(size))>>}

    defp scalar(_value, unquote(type)), do: {:error, unquote("an integer from #{low} to #{high}")}
  end

  defp scalar(:nan, :float), do: {:ok, <<@nan32::little-32>>}
  defp scalar(:infinity, :float), do: {:ok, <<@infinity32::little-32>>}
  defp scalar(:neg_infinity, :float), do: {:ok, <<0xFF800000::little-32>>}

  defp scalar({:nan, bits}, :float)
       when is_integer(bits) and bits in 0..0xFFFFFFFF and (bits &&& 0x7FFFFFFF) > @infinity32,
       do: {:ok, <<bits::little-32>>}

  defp scalar(:nan, :double), do: {:ok, <<@nan64::little-64>>}
  defp scalar(:infinity, :double), do: {:ok, <<@infinity64::little-64>>}
  defp scalar(:neg_infinity, :double), do: {:ok, <<0xFFF0000000000000::little-64>>}

  defp scalar({:nan, bits}, :double)
       when is_integer(bits) and bits in 0..0xFFFFFFFFFFFFFFFF and (bits &&& 0x7FFFFFFFFFFFFFFF) > @infinity64,
       do: {:ok, <<bits::little-64>>}

  # Erlang would turn a double that is too large for 32 bits into an infinity, and raises for an integer that is too
  # large for 64.
  defp scalar(value, :float) when is_number(value) and abs(value) < @float_limit,
    do: {:ok, <<value::float-little-32>>}

  defp scalar(value, :double) when is_float(value), do: {:ok, <<value::float-little-64>>}

  defp scalar(value, :double) when is_integer(value) and abs(value) <= @double_limit,
    do: {:ok, <<value::float-little-64>>}

  defp scalar(_value, type) when type in [:float, :double],
    do: {:error, "a number that fits a #{type}, :nan, :infinity, :neg_infinity or {:nan, bits}"}
end
