defmodule SimVehicle.Ftp.Pack do
  @moduledoc """
  ArduPilot's `@PARAM/param.pck`: all parameters in a file. Names share what they begin with with the name before, and zeros keep
  a value from lying in two reads.
  """

  alias SimVehicle.Params

  @magic 0x671B
  @magic_defaults 0x671C

  @doc "The file for reads of `piece` bytes."
  @spec file(Params.t(), pos_integer, boolean) :: binary
  def file(params, piece, defaults?) do
    count = Params.count(params)
    magic = if defaults?, do: @magic_defaults, else: @magic
    header = <<magic::little-16, count::little-16, count::little-16>>

    {bytes, _last} =
      Enum.reduce(0..(count - 1)//1, {header, ""}, fn index, {bytes, last} ->
        name = Params.name_at(params, index)
        {value, type} = Map.fetch!(params.values, name)
        record = record(name, last, value, type, defaults?)
        {bytes <> padding(byte_size(bytes), byte_size(record), piece) <> record, name}
      end)

    bytes
  end

  # Every value is its own default but odd ones, which have one of 0.
  defp record(name, last, value, type, defaults?) do
    common = min(:binary.longest_common_prefix([name, last]), min(15, byte_size(name) - 1))
    rest = binary_part(name, common, byte_size(name) - common)
    default? = defaults? and is_integer(value) and rem(value, 2) == 1
    flags = if default?, do: 1, else: 0
    type = %{2 => 1, 4 => 2, 6 => 3, 9 => 4}[type]

    <<flags::4, type::4, byte_size(rest) - 1::4, common::4, rest::binary, bytes(type, value)::binary,
      if(default?, do: bytes(type, 0), else: "")::binary>>
  end

  defp padding(at, size, piece) do
    left = piece - rem(at, piece)
    if size > left, do: <<0::size(left * 8)>>, else: ""
  end

  defp bytes(1, value), do: <<value::signed-8>>
  defp bytes(2, value), do: <<value::little-signed-16>>
  defp bytes(3, value), do: <<value::little-signed-32>>
  defp bytes(4, value), do: <<value::little-float-32>>
end
