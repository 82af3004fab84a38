defmodule Aerie.Params.Packed do
  @moduledoc """
  ArduPilot's parameter file, `@PARAM/param.pck`: all parameters in about 12 bytes each, integers with all their bits, and with
  `?withdefaults=1` the firmware's defaults.

  The file has a header (magic, number of parameters, total number), then for each parameter type and flags, lengths, the part of the name
  that differs from the name before, and the value. Zeros in between are padding.
  """

  alias Aerie.Params.{Param, Table}
  alias Aerie.Protocol.ParamValue

  @magic 0x671B
  @magic_defaults 0x671C
  # The file's type numbers => MAV_PARAM_TYPE.
  @types %{1 => 2, 2 => 4, 3 => 6, 4 => 9}
  @file_types Map.new(@types, fn {file, mavlink} -> {mavlink, file} end)
  @max_bytes 262_144

  @path "@PARAM/param.pck"

  @doc "The path of the file, with or without defaults."
  @spec path(defaults? :: boolean()) :: String.t()
  def path(true), do: @path <> "?withdefaults=1"
  def path(false), do: @path

  @doc "No parameter file is larger."
  @spec max_bytes() :: pos_integer()
  def max_bytes, do: @max_bytes

  @doc "The parameters of a complete file; the error says what is wrong with it."
  @spec decode(binary()) :: {:ok, [Param.t()]} | {:error, String.t()}
  def decode(<<magic::little-16, count::little-16, total::little-16, rest::binary>>)
      when magic in [@magic, @magic_defaults] do
    cond do
      total > Table.max() -> {:error, "#{total} parameters, more than #{Table.max()}"}
      count != total -> {:error, "the file has #{count} of #{total} parameters"}
      true -> records(rest, "", magic == @magic_defaults, [], total)
    end
  end

  def decode(_other), do: {:error, "not a parameter file: it begins with other bytes"}

  defp records(<<0, rest::binary>>, last, defaults?, params, total),
    do: records(rest, last, defaults?, params, total)

  defp records("", _last, _defaults?, params, total) do
    names = MapSet.new(params, & &1.name)

    cond do
      length(params) != total -> {:error, "the file ends after #{length(params)} of #{total} parameters"}
      MapSet.size(names) != total -> {:error, "a parameter comes twice"}
      true -> {:ok, Enum.reverse(params)}
    end
  end

  defp records(_more, _last, _defaults?, params, total) when length(params) == total,
    do: {:error, "the file goes on after #{total} parameters"}

  defp records(<<flags::4, type::4, length::4, common::4, rest::binary>>, last, defaults?, params, total)
       when is_map_key(@types, type) and common <= byte_size(last) do
    length = length + 1

    with <<part::binary-size(^length), rest::binary>> <- rest,
         name = binary_part(last, 0, common) <> part,
         true <- ParamValue.name?(name),
         {value, rest} <- value(type, rest),
         {default, rest} <- default(type, defaults?, Bitwise.band(flags, 1), value, rest) do
      param = %Param{name: name, value: value, type: @types[type], default: default}
      records(rest, name, defaults?, [param | params], total)
    else
      false -> {:error, "an impossible name after #{place(last)}"}
      _short -> {:error, "the file ends after #{length(params)} of #{total} parameters"}
    end
  end

  defp records(<<_byte>>, _last, _defaults?, params, total),
    do: {:error, "the file ends after #{length(params)} of #{total} parameters"}

  defp records(_unreadable, last, _defaults?, _params, _total),
    do: {:error, "unknown type or name after #{place(last)}"}

  @doc "The file as the vehicle gives it to who reads it in pieces of so many bytes: no value lies in two of them."
  @spec encode(Table.t(), defaults? :: boolean(), piece :: pos_integer()) :: binary()
  def encode(table, defaults?, piece) do
    count = Table.count(table)
    magic = if defaults?, do: @magic_defaults, else: @magic

    {bytes, _last} =
      Enum.reduce(table.order, {<<magic::little-16, count::little-16, count::little-16>>, ""}, fn name,
                                                                                                  {bytes,
                                                                                                   last} ->
        record = record(table.params[name], last, defaults?)
        {<<bytes::binary, padding(byte_size(bytes), byte_size(record), piece)::binary, record::binary>>, name}
      end)

    bytes
  end

  defp record(param, last, defaults?) do
    name = param.name
    common = min(:binary.longest_common_prefix([name, last]), min(15, byte_size(name) - 1))
    rest = binary_part(name, common, byte_size(name) - common)
    type = Map.fetch!(@file_types, param.type)
    default = if defaults? and param.default not in [nil, param.value], do: param.default
    flags = if default, do: 1, else: 0

    <<flags::4, type::4, byte_size(rest) - 1::4, common::4, rest::binary, bytes(type, param.value)::binary,
      if(default, do: bytes(type, default), else: "")::binary>>
  end

  defp padding(at, size, piece) do
    left = piece - rem(at, piece)
    if size > left, do: <<0::size(left * 8)>>, else: ""
  end

  defp bytes(1, value), do: <<value::signed-8>>
  defp bytes(2, value), do: <<value::little-signed-16>>
  defp bytes(3, value), do: <<value::little-signed-32>>
  defp bytes(4, value), do: <<value::little-float-32>>

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
end
