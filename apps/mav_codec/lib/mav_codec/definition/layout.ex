defmodule MavCodec.Definition.Layout do
  @moduledoc """
  The layout of a message on the wire: field order (F4), CRC_EXTRA (F5), lengths, and the position of its target ids.
  """

  import Bitwise

  alias MavCodec.Definition.Document.{Field, Message}

  @enforce_keys [:base, :extensions, :min, :max, :crc_extra]
  defstruct [:base, :extensions, :min, :max, :crc_extra, :target_system, :target_component]

  @typedoc """
  `base` and `extensions` are the fields in wire order; `min` and `max` the payload's length without and with
  extensions; `target_*` byte offsets in the payload, `nil` where the message has no such field.
  """
  @type t :: %__MODULE__{
          base: [Field.t()],
          extensions: [Field.t()],
          min: 0..255,
          max: 1..255,
          crc_extra: 0..255,
          target_system: 0..254 | nil,
          target_component: 0..254 | nil
        }

  @sizes %{
    char: 1,
    int8: 1,
    uint8: 1,
    int16: 2,
    uint16: 2,
    int32: 4,
    uint32: 4,
    int64: 8,
    uint64: 8,
    float: 4,
    double: 8
  }

  @doc "Size in bytes of one element of a type."
  @spec size(Field.scalar()) :: 1 | 2 | 4 | 8
  def size(type), do: Map.fetch!(@sizes, type)

  @doc "Size of a whole field in bytes."
  @spec bytes(Field.t()) :: pos_integer()
  def bytes(%Field{type: type, length: nil}), do: size(type)
  def bytes(%Field{type: type, length: length}) when is_integer(length), do: size(type) * length

  @doc "The layout of a message."
  @spec of(Message.t()) :: t()
  def of(%Message{fields: fields} = message) do
    {base, extensions} = order(fields)
    min = base |> Enum.map(&bytes/1) |> Enum.sum()
    max = extensions |> Enum.map(&bytes/1) |> Enum.sum() |> Kernel.+(min)
    offsets = offsets(base ++ extensions)

    %__MODULE__{
      base: base,
      extensions: extensions,
      min: min,
      max: max,
      crc_extra: crc_extra(message.name, base),
      target_system: offsets["target_system"] || manual_control_target(message, offsets),
      target_component: offsets["target_component"]
    }
  end

  @doc "The wire order of fields (F4): base fields by element size, largest first, then extensions in XML order."
  @spec order([Field.t()]) :: {base :: [Field.t()], extensions :: [Field.t()]}
  def order(fields) do
    {extensions, base} = Enum.split_with(fields, & &1.extension)
    {Enum.sort_by(base, &size(&1.type), :desc), extensions}
  end

  # The only message whose target system has another name; routers must know it too.
  defp manual_control_target(%Message{name: "MANUAL_CONTROL"}, offsets), do: offsets["target"]
  defp manual_control_target(_message, _offsets), do: nil

  defp offsets(fields) do
    {offsets, _end} = Enum.map_reduce(fields, 0, &{{&1.name, &2}, &2 + bytes(&1)})
    Map.new(offsets)
  end

  # F5: CRC-16/MCRF4XX over the name and the base fields, folded to one byte.
  defp crc_extra(name, base) do
    crc =
      Enum.reduce(base, crc(name <> " ", 0xFFFF), fn field, crc ->
        crc = crc(type_name(field) <> " " <> field.name <> " ", crc)
        if field.length, do: crc(<<field.length>>, crc), else: crc
      end)

    bxor(crc &&& 0xFF, crc >>> 8)
  end

  @doc "A type, or the type of a field's elements, as the XML writes it."
  @spec type_name(Field.scalar() | Field.t()) :: String.t()
  def type_name(%Field{bytes: true}), do: "char"
  def type_name(%Field{type: type}), do: type_name(type)
  def type_name(type) when type in [:char, :float, :double], do: Atom.to_string(type)
  def type_name(type), do: Atom.to_string(type) <> "_t"

  # Bit by bit, because it runs only at compile time, over a few hundred bytes a message.
  defp crc(<<byte, rest::binary>>, crc), do: crc(rest, Enum.reduce(1..8, bxor(crc, byte), &crc_bit/2))
  defp crc(<<>>, crc), do: crc

  defp crc_bit(_bit, crc) when (crc &&& 1) == 1, do: bxor(crc >>> 1, 0x8408)
  defp crc_bit(_bit, crc), do: crc >>> 1
end
