defmodule MavCodec.Frame.Raw do
  @moduledoc """
  Puts a payload into a frame: header, truncation, CRC. It needs id, payload and CRC_EXTRA; for message structs use
  `MavCodec.encode/2`.
  """

  import Bitwise

  alias MavCodec.{CRC, Message}
  alias MavCodec.Message.EncodeError

  @payload "a payload of at most 255 bytes (its size)"

  @typedoc """
    * `:system` - the source's system id, 1..255; with `sysid32: true` up to 32 bits. Required.
    * `:component` - the source's component id, 0..255; default 1
    * `:seq` - sequence number, only its low 8 bits count; default 0
    * `:version` - 2 (default) or 1
    * `:sysid32` - allow MAVLink 2.1's long ids, used only where an id is above 255 (N1); default `false`
    * `:target_system` - the addressee for a 2.1 header, if above 255
    * `:incompat_flags`, `:compat_flags` - flags of a v2 header that are not implied; default 0
    * `:truncate` - cut trailing zeros off a v2 payload (F7); default `true`
  """
  @type option ::
          {:system, pos_integer()}
          | {:component, 0..255}
          | {:seq, non_neg_integer()}
          | {:version, 1 | 2}
          | {:sysid32, boolean()}
          | {:target_system, non_neg_integer() | nil}
          | {:incompat_flags, 0..255}
          | {:compat_flags, 0..255}
          | {:truncate, boolean()}

  @doc """
  The bytes of a frame with message `id` and `payload`, unsigned.

  `payload` is as the message defines it: at most 255 bytes, for version 1 without extension fields. Raises
  `MavCodec.Message.EncodeError` if it cannot be sent in the requested version.
  """
  @spec frame(0..0xFFFFFF, binary(), 0..255, [option()]) :: binary()
  def frame(id, payload, crc_extra, options) do
    case version(options) do
      2 -> v2(id, payload, crc_extra, options)
      1 -> v1(id, payload, crc_extra, options)
    end
  end

  @doc "The version requested by `options`. Raises `MavCodec.Message.EncodeError` for one that does not exist."
  @spec version([option()]) :: 1 | 2
  def version(options) do
    version = Keyword.get(options, :version, 2)
    check(version in [1, 2], :version, version, "1 or 2")
    version
  end

  defp v1(id, payload, extra, options) do
    system = Keyword.fetch!(options, :system)
    check(id in 0..255, :id, id, "a message id from 0 to 255 for MAVLink 1")
    check(byte_size(payload) <= 255, :payload, byte_size(payload), @payload)
    check(system in 1..255, :system, system, "a system id from 1 to 255")
    close(<<0xFE, byte_size(payload), seq(options), system, component(options), id>>, payload, extra)
  end

  defp v2(id, payload, extra, options) do
    system = Keyword.fetch!(options, :system)
    target = Keyword.get(options, :target_system)
    highest = if Keyword.get(options, :sysid32, false), do: 0xFFFF_FFFF, else: 255
    check(id in 0..0xFFFFFF, :id, id, "a message id from 0 to 16777215")
    check(byte_size(payload) <= 255, :payload, byte_size(payload), @payload)
    check(system in 1..highest, :system, system, "a system id from 1 to #{highest}")
    check(target == nil or target in 0..highest, :target_system, target, "a system id from 0 to #{highest}")

    payload = if Keyword.get(options, :truncate, true), do: Message.trim(payload), else: payload
    incompat = Keyword.get(options, :incompat_flags, 0)
    compat = Keyword.get(options, :compat_flags, 0)
    seq = seq(options)
    component = component(options)
    size = byte_size(payload)

    header =
      case {system > 255, target != nil and target > 255} do
        {false, false} ->
          <<0xFD, size, incompat, compat, seq, system, component, id::24-little>>

        {true, false} ->
          <<0xFD, size, incompat ||| 0x02, compat, seq, system::32-little, component, id::24-little>>

        {false, true} ->
          <<0xFD, size, incompat ||| 0x04, compat, seq, system, component, id::24-little, target::32-little>>

        {true, true} ->
          <<0xFD, size, incompat ||| 0x06, compat, seq, system::32-little, component, id::24-little,
            target::32-little>>
      end

    close(header, payload, extra)
  end

  defp close(header, payload, extra) do
    frame = <<header::binary, payload::binary>>
    crc = CRC.frame(frame, byte_size(frame) - 1, extra)
    <<frame::binary, crc::16-little>>
  end

  defp seq(options), do: Keyword.get(options, :seq, 0)

  defp component(options) do
    component = Keyword.get(options, :component, 1)
    check(component in 0..255, :component, component, "a component id from 0 to 255")
    component
  end

  defp check(true, _field, _got, _expected), do: :ok
  defp check(false, field, got, expected), do: raise(EncodeError, field: field, got: got, expected: expected)
end
