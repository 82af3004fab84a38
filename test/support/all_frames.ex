defmodule Aerie.AllFrames do
  @moduledoc """
  Frames of every message of the definitions, and of every command, with extremes in their fields. The sequence number of each
  tells what its fields are filled with, so that who counts what arrives can tell them apart (`fills/0`).
  """

  alias MavCodec.Dialects.All
  alias MavCodec.Enums.MavCmd
  alias MavCodec.Messages, as: M

  # `:force` has the numbers that make a disarming or an arming a forced one.
  @fills [:zero, :max, :nan, :infinity, :force]
  @invented_ids [0x2FFF, 0xABCDEF, 0xFFFFFE]
  # None of the definitions, of vendors, and of nobody.
  @invented_commands [1, 5_555, 43_999, 60_000]
  @carriers [M.CommandLong.id(), M.CommandInt.id()]
  @take_control MavCmd.value(:MAV_CMD_REQUEST_OPERATOR_CONTROL)

  @doc "What fields can be filled with, in the order of the sequence numbers."
  @spec fills() :: [atom(), ...]
  def fills, do: @fills

  @doc "All commands, and some that there are not; not the one that takes control, after which others may do nothing."
  @spec commands() :: [non_neg_integer(), ...]
  def commands do
    known = for number <- 0..65_535, MavCmd.name(number), number != @take_control, do: number
    Enum.uniq(known ++ @invented_commands)
  end

  @doc """
  Frames of all messages from a system. `options`: `targets` (pairs; messages without a target are sent once), `fills`, `versions`,
  `component`, `except` (ids).
  """
  @spec messages(1..255, keyword()) :: [binary()]
  def messages(system, options) do
    for id <- All.ids() -- (options[:except] || []),
        target <- if(All.targets(id), do: options[:targets], else: [{0, 0}]),
        fill <- options[:fills],
        version <- options[:versions],
        version == 2 or id <= 255,
        do: frame(id, target, fill, version, system, options)
  end

  @doc "Frames with ids of no definition. Their checks cannot be looked at."
  @spec invented(1..255) :: [binary()]
  def invented(system) do
    for id <- @invented_ids,
        payload <- [<<1, 1>>, :binary.copy(<<0xFF>>, 200)],
        do: MavCodec.Frame.Raw.frame(id, payload, 0, system: system, component: 190)
  end

  @doc "Frames of all commands from a system, by COMMAND_LONG and COMMAND_INT. Options as those of `messages/2`."
  @spec commands(1..255, keyword()) :: [binary()]
  def commands(system, options) do
    for number <- options[:commands] || commands(),
        id <- @carriers,
        target <- options[:targets],
        fill <- options[:fills],
        version <- options[:versions],
        do: frame({id, number}, target, fill, version, system, options)
  end

  defp frame({id, number}, target, fill, version, system, options) do
    <<before::binary-28, _command::16, rest::binary>> = payload(id, target, fill, version)
    send_as(id, <<before::binary, number::16-little, rest::binary>>, fill, version, system, options)
  end

  defp frame(id, target, fill, version, system, options),
    do: send_as(id, payload(id, target, fill, version), fill, version, system, options)

  defp send_as(id, payload, fill, version, system, options) do
    MavCodec.Frame.Raw.frame(id, payload, All.crc_extra(id),
      system: system,
      component: options[:component] || 190,
      seq: Enum.find_index(@fills, &(&1 == fill)),
      version: version
    )
  end

  defp payload(id, target, fill, version) do
    {_id, _extra, base, extensions} = id |> All.module_for() |> All.layout()
    fields = if version == 2, do: base ++ extensions, else: base
    bytes = for {key, type, length} <- fields, _n <- 1..(length || 1), into: "", do: value(type, fill, key)
    aimed(bytes, All.targets(id), target)
  end

  defp aimed(bytes, nil, _target), do: bytes

  defp aimed(bytes, {system_at, component_at}, {system, component}),
    do: bytes |> put(system_at, system) |> put(component_at, component)

  defp put(bytes, at, value) when is_integer(at) and at < byte_size(bytes) do
    <<before::binary-size(^at), _byte, rest::binary>> = bytes
    <<before::binary, value, rest::binary>>
  end

  defp put(bytes, _none, _value), do: bytes

  defp value(:float, fill, key), do: float(fill, key)
  defp value(:double, :max, _key), do: <<0x7FEFFFFFFFFFFFFF::64-little>>
  defp value(:double, :nan, _key), do: <<0x7FF8000000000000::64-little>>
  defp value(:double, :infinity, _key), do: <<0x7FF0000000000000::64-little>>
  defp value(:double, _fill, _key), do: <<0::64>>
  defp value(type, fill, _key), do: integer(bits(type), fill)

  defp float(:max, _key), do: <<0x7F7FFFFF::32-little>>
  defp float(:nan, _key), do: <<0x7FC00000::32-little>>
  defp float(:infinity, _key), do: <<0x7F800000::32-little>>
  defp float(:force, :param1), do: <<1.0::float-32-little>>
  defp float(:force, :param2), do: <<21_196.0::float-32-little>>
  defp float(_fill, _key), do: <<0::32>>

  defp bits(type) when type in [:int8, :uint8, :char], do: {8, type == :int8}
  defp bits(type) when type in [:int16, :uint16], do: {16, type == :int16}
  defp bits(type) when type in [:int32, :uint32], do: {32, type == :int32}
  defp bits(type) when type in [:int64, :uint64], do: {64, type == :int64}

  defp integer({bits, signed?}, :max) do
    top = if signed?, do: Bitwise.bsl(1, bits - 1) - 1, else: Bitwise.bsl(1, bits) - 1
    <<top::size(bits)-little>>
  end

  defp integer({bits, _signed?}, :nan), do: <<1::size(bits)-little>>
  defp integer({bits, _signed?}, _fill), do: <<0::size(bits)>>
end
