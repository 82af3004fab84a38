defmodule MavCodec.Ftp.PackedParams do
  @moduledoc """
  ArduPilot's parameter file, `@PARAM/param.pck`: all parameters in about 12 bytes each, integers with all their bits, and with
  `?withdefaults=1` the firmware's defaults.

  The file has a header (magic, number of parameters, total number), then for each parameter type and flags, lengths, the part of the name
  that differs from the name before, and the value. Zeros in between are padding.
  """

  import Bitwise, only: [band: 2]

  @magic 0x671B
  @magic_defaults 0x671C
  # The file's type numbers => MAV_PARAM_TYPE.
  @types %{1 => 2, 2 => 4, 3 => 6, 4 => 9}
  @file_types Map.new(@types, fn {file, mavlink} -> {mavlink, file} end)

  @path "@PARAM/param.pck"

  @typedoc "The default is nil if it is not known. A float that is not a number (NaN or infinite) is nil."
  @type param ::
          {name :: String.t(), type :: 2 | 4 | 6 | 9, value :: number() | nil, default :: number() | nil}

  @doc "The path of the file, with or without defaults."
  @spec path(defaults? :: boolean()) :: String.t()
  def path(true), do: @path <> "?withdefaults=1"
  def path(false), do: @path

  @doc "Whether a name can be that of a parameter: 1 to 16 printable ASCII characters without spaces (P1)."
  @spec name?(term()) :: boolean()
  def name?(name) when is_binary(name) and byte_size(name) in 1..16,
    do: for(<<byte <- name>>, byte not in 33..126, do: byte) == []

  def name?(_other), do: false

  @doc "The parameters of a complete file that has `max` of them at most; the error says what is wrong with it."
  @spec decode(binary(), max :: pos_integer()) :: {:ok, [param()]} | {:error, String.t()}
  def decode(<<magic::little-16, count::little-16, total::little-16, rest::binary>>, max)
      when magic in [@magic, @magic_defaults] do
    cond do
      total > max -> {:error, "#{total} parameters, more than #{max}"}
      count != total -> {:error, "the file has #{count} of #{total} parameters"}
      true -> rest |> records("", magic == @magic_defaults, [], total) |> complete(total)
    end
  end

  def decode(_other, _max), do: {:error, "not a parameter file: it begins with other bytes"}

  defp complete({:ok, params}, total) do
    if params |> MapSet.new(&elem(&1, 0)) |> MapSet.size() == total,
      do: {:ok, Enum.reverse(params)},
      else: {:error, "a parameter comes twice"}
  end

  defp complete({:short, left}, total),
    do: {:error, "the file ends after #{total - left} of #{total} parameters"}

  defp complete(:long, total), do: {:error, "the file goes on after #{total} parameters"}
  defp complete({:error, reason}, _total), do: {:error, reason}

  defp records(<<0, rest::binary>>, last, defaults?, params, left),
    do: records(rest, last, defaults?, params, left)

  defp records("", _last, _defaults?, params, 0), do: {:ok, params}
  defp records(_more, _last, _defaults?, _params, 0), do: :long
  defp records(rest, _last, _defaults?, _params, left) when byte_size(rest) < 2, do: {:short, left}

  defp records(<<flags::4, type::4, length::4, common::4, rest::binary>>, last, defaults?, params, left)
       when is_map_key(@types, type) and common <= byte_size(last) do
    length = length + 1

    with <<part::binary-size(^length), rest::binary>> <- rest,
         name = binary_part(last, 0, common) <> part,
         true <- name?(name),
         {value, rest} <- value(type, rest),
         {default, rest} <- default(type, defaults?, band(flags, 1), value, rest) do
      records(rest, name, defaults?, [{name, @types[type], value, default} | params], left - 1)
    else
      false -> {:error, "an impossible name after #{place(last)}"}
      _short -> {:short, left}
    end
  end

  defp records(_unreadable, last, _defaults?, _params, _left),
    do: {:error, "unknown type or name after #{place(last)}"}

  defp place(""), do: "the header"
  defp place(name), do: name

  defp default(_type, false, _flag, _value, rest), do: {nil, rest}
  # A parameter without a default in the file has its default value.
  defp default(_type, true, 0, value, rest), do: {value, rest}
  defp default(type, true, 1, _value, rest), do: value(type, rest)

  defp value(1, <<value::signed-8, rest::binary>>), do: {value, rest}
  defp value(2, <<value::little-signed-16, rest::binary>>), do: {value, rest}
  defp value(3, <<value::little-signed-32, rest::binary>>), do: {value, rest}
  defp value(4, <<value::float-little-32, rest::binary>>), do: {value, rest}
  # NaN or infinite.
  defp value(4, <<_no_number::binary-size(4), rest::binary>>), do: {nil, rest}
  defp value(_type, _short), do: :error

  @doc "The file for reads of `piece` bytes: no value lies in two of them."
  @spec encode([param()], defaults? :: boolean(), piece :: pos_integer()) :: binary()
  def encode(params, defaults?, piece) do
    magic = if defaults?, do: @magic_defaults, else: @magic
    count = length(params)
    header = <<magic::little-16, count::little-16, count::little-16>>

    {bytes, _last} =
      Enum.reduce(params, {header, ""}, fn {name, _type, _value, _default} = param, {bytes, last} ->
        record = record(param, last, defaults?)
        padding = padding(byte_size(bytes), byte_size(record), piece)
        {<<bytes::binary, 0::size(padding * 8), record::binary>>, name}
      end)

    bytes
  end

  defp record({name, type, value, default}, last, defaults?) do
    common = min(:binary.longest_common_prefix([name, last]), min(15, byte_size(name) - 1))
    rest = binary_part(name, common, byte_size(name) - common)
    type = Map.fetch!(@file_types, type)
    default = if defaults? and default not in [nil, value], do: bytes(type, default), else: ""
    flags = if default == "", do: 0, else: 1

    <<flags::4, type::4, byte_size(rest) - 1::4, common::4, rest::binary, bytes(type, value)::binary,
      default::binary>>
  end

  defp padding(at, size, piece) do
    left = piece - rem(at, piece)
    if size > left, do: left, else: 0
  end

  defp bytes(1, value), do: <<value::signed-8>>
  defp bytes(2, value), do: <<value::little-signed-16>>
  defp bytes(3, value), do: <<value::little-signed-32>>
  defp bytes(4, value), do: <<value::little-float-32>>
end
