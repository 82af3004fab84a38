defmodule MavCodec.Frame do
  @moduledoc """
  One MAVLink frame as it was received: the header's fields, the payload as on the wire, and the original bytes.

  A frame is cheap: payload and bytes are references into the binary that was read, and message fields are decoded on demand
  only (`MavCodec.decode/2`). A router forwards `bytes` unchanged (R3, S10).

  ## Layout on the wire (F1, F2, N1)

      v1  FE len seq sys comp id                                payload crc16
      v2  FD len incompat compat seq sys comp id24              payload crc16 [signature 13]
      2.1 FD len incompat compat seq sys32 comp id24 [target32] payload crc16 [signature 13]
  """

  import Bitwise

  @signed 0x01
  @source32 0x02
  @target32 0x04

  defstruct version: 2,
            seq: 0,
            system: 0,
            component: 0,
            id: 0,
            payload: "",
            incompat: 0,
            compat: 0,
            crc_extra: nil,
            signature: nil,
            target_system: nil,
            bytes: "",
            at: nil

  @typedoc """
    * `version` - 1 or 2
    * `seq` - 0..255
    * `system` - the source's system id, 1..255, or up to 32 bits with MAVLink 2.1's long ids
    * `component` - the source's component id, 0..255 (F3 forbids 0, real ground stations send it)
    * `id` - the message id, 0..0xFFFFFF
    * `payload` - as received: trailing zeros may have been cut (F7), surplus bytes may follow (F9)
    * `incompat`, `compat` - the flags of a v2 frame, 0 for v1
    * `crc_extra` - the value that gave the right CRC; `nil`: unknown id, the CRC could not be checked
    * `signature` - the signature block of a signed frame: its link id, its time stamp (10 us units since 2015) and the
      six bytes; `MavCodec.Signing` checks it
    * `target_system` - the 32-bit addressee in a 2.1 header, else `nil`: see `target/2`
    * `bytes` - the whole frame
    * `at` - time of arrival in unix microseconds, or `nil`
  """
  @type t :: %__MODULE__{
          version: 1 | 2,
          seq: 0..255,
          system: non_neg_integer(),
          component: 0..255,
          id: 0..0xFFFFFF,
          payload: binary(),
          incompat: 0..255,
          compat: 0..255,
          crc_extra: 0..255 | nil,
          signature: signature() | nil,
          target_system: non_neg_integer() | nil,
          bytes: binary(),
          at: integer() | nil
        }

  @type signature :: %{link_id: 0..255, timestamp: 0..0xFFFF_FFFF_FFFF, signature: <<_::48>>}

  @doc "Whether the frame has a signature, valid or not."
  @spec signed?(t()) :: boolean()
  def signed?(%__MODULE__{signature: signature}), do: signature != nil

  @doc "Whether the message id is known and the CRC correct. Frames with unknown ids are only routed (R4)."
  @spec known?(t()) :: boolean()
  def known?(%__MODULE__{crc_extra: extra}), do: extra != nil

  @doc """
  The addressee `{target_system, target_component}`, or `nil` when the message has none or is not in the dialect.

  Bytes that were cut off read as 0, which is a broadcast (F10), and so does a field that the message lacks. The 32-bit
  addressee of a 2.1 header takes precedence over the byte in the payload (N1).
  """
  @spec target(t(), module()) :: {non_neg_integer(), 0..255} | nil
  def target(%__MODULE__{payload: payload} = frame, dialect \\ MavCodec.Dialects.All) do
    case {dialect.targets(frame.id), frame.target_system} do
      {nil, nil} -> nil
      {nil, system} -> {system, 0}
      {{system_at, component_at}, nil} -> {byte_at(payload, system_at), byte_at(payload, component_at)}
      {{_system_at, component_at}, system} -> {system, byte_at(payload, component_at)}
    end
  end

  defp byte_at(payload, offset) when is_integer(offset) and offset < byte_size(payload),
    do: :binary.at(payload, offset)

  defp byte_at(_payload, _offset), do: 0

  @doc """
  Reads the header of a frame at the start of `data`, without checking CRC or source.

  Returns `{:ok, header_size, payload_size, total_size, id, source_system}`, `:more` if the header is incomplete, or
  `:error` without a magic. Sizes follow from the flags, those of 2.1 included (N3).
  """
  @spec header(binary()) ::
          {:ok, pos_integer(), 0..255, pos_integer(), 0..0xFFFFFF, non_neg_integer()} | :more | :error
  def header(<<0xFD, len, incompat, _compat, _seq, system, _comp, id::24-little, _::binary>>)
      when (incompat &&& (@source32 ||| @target32)) == 0 do
    {:ok, 10, len, 12 + len + signature_size(incompat), id, system}
  end

  def header(<<0xFD, len, incompat, _::2-binary, system::32-little, _comp, id::24-little, _::binary>>)
      when (incompat &&& @source32) != 0 do
    size = if (incompat &&& @target32) == 0, do: 13, else: 17
    {:ok, size, len, size + len + 2 + signature_size(incompat), id, system}
  end

  def header(<<0xFD, len, incompat, _::2-binary, system, _comp, id::24-little, _::binary>>)
      when (incompat &&& @source32) == 0 do
    {:ok, 14, len, 16 + len + signature_size(incompat), id, system}
  end

  def header(<<0xFE, len, _seq, system, _comp, id, _::binary>>), do: {:ok, 6, len, len + 8, id, system}
  def header(<<magic, _::binary>>) when magic in [0xFD, 0xFE], do: :more
  def header(<<>>), do: :more
  def header(_data), do: :error

  defp signature_size(incompat) when (incompat &&& @signed) == 0, do: 0
  defp signature_size(_incompat), do: 13

  @doc """
  The version for what is sent in place of a frame, or as the answer to it, with a system id of `system`: that of the
  frame, because its peers may know no other one. Ids above 255 are in version 2 only (N1).
  """
  @spec version_for(t(), non_neg_integer()) :: 1 | 2
  def version_for(%__MODULE__{version: version}, system), do: if(system > 255, do: 2, else: version)

  @doc """
  The frame with exactly these bytes. Nothing is checked: use it for bytes that a parser has accepted or that
  `MavCodec.encode/2` returned.
  """
  @spec from_bytes(binary(), 0..255 | nil, integer() | nil) :: t()
  def from_bytes(bytes, crc_extra, at \\ nil)

  def from_bytes(
        <<0xFE, len, seq, system, component, id, payload::binary-size(len), _::binary>> = bytes,
        extra,
        at
      ) do
    %__MODULE__{
      version: 1,
      seq: seq,
      system: system,
      component: component,
      id: id,
      payload: payload,
      crc_extra: extra,
      bytes: bytes,
      at: at
    }
  end

  def from_bytes(
        <<0xFD, len, 0, compat, seq, system, component, id::24-little, payload::binary-size(len), _crc::16>> =
          bytes,
        extra,
        at
      ) do
    %__MODULE__{
      seq: seq,
      system: system,
      component: component,
      id: id,
      payload: payload,
      compat: compat,
      crc_extra: extra,
      bytes: bytes,
      at: at
    }
  end

  def from_bytes(<<0xFD, len, incompat, compat, seq, _::binary>> = bytes, extra, at) do
    {:ok, header, ^len, total, id, system} = header(bytes)
    <<fields::binary-size(^header), payload::binary-size(^len), _crc::16, tail::binary>> = bytes
    ^total = byte_size(bytes)
    component_at = if (incompat &&& @source32) == 0, do: 6, else: 9

    %__MODULE__{
      seq: seq,
      system: system,
      component: :binary.at(fields, component_at),
      id: id,
      payload: payload,
      incompat: incompat,
      compat: compat,
      crc_extra: extra,
      signature: signature(tail),
      target_system: target_system(fields, incompat),
      bytes: bytes,
      at: at
    }
  end

  defp signature(<<link_id, timestamp::48-little, signature::6-binary>>),
    do: %{link_id: link_id, timestamp: timestamp, signature: signature}

  defp signature(<<>>), do: nil

  defp target_system(fields, incompat) when (incompat &&& @target32) != 0 do
    size = byte_size(fields) - 4
    <<_::binary-size(^size), target::32-little>> = fields
    target
  end

  defp target_system(_fields, _incompat), do: nil
end
