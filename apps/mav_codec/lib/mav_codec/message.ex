defmodule MavCodec.Message do
  @moduledoc """
  Messages as structs: the behaviour of the modules under `MavCodec.Messages`, and the encoding of a struct to a payload.

  Integers, enums and bitmasks are integers; floats are floats, or `:nan`, `:infinity`, `:neg_infinity` and
  `{:nan, bits}`; `char[]` is text without trailing NULs; `uint8_t[]` and a `char[]` that holds bytes are binaries; other arrays are lists. A new
  struct is all zeros, so only the fields that matter need to be set.
  """

  alias MavCodec.Message.EncodeError
  alias MavCodec.Message.{Field, Value}

  @type t :: struct()

  @doc "The message id."
  @callback id() :: 0..0xFFFFFF
  @doc "The name in the XML, such as `\"HEARTBEAT\"`."
  @callback name() :: String.t()
  @doc "The fields in the order of the XML."
  @callback fields() :: [Field.t()]
  @doc "The struct of a payload. Missing bytes read as zero, surplus ones are ignored (F7, F9); it never fails."
  @callback decode(payload :: binary()) :: struct()

  @doc """
  Encodes a message to its payload with the layout of a dialect.

  `version` 2 has the extensions and cuts trailing zeros (F7); `version` 1 does neither, and has only ids up to 255. All
  fields are checked in both.
  Returns the id and the CRC_EXTRA that the frame needs.
  """
  @spec encode_payload(t(), 1 | 2, module()) ::
          {:ok, id :: 0..0xFFFFFF, crc_extra :: 0..255, payload :: binary()} | {:error, EncodeError.t()}
  def encode_payload(%module{} = message, version, dialect) when version in [1, 2] do
    case dialect.encoder(module) do
      {id, _crc_extra, _min, _layout} when version == 1 and id > 255 ->
        {:error, %EncodeError{message: module, got: id, expected: "an id up to 255 for MAVLink 1"}}

      {id, crc_extra, min, layout} ->
        case module.__encode__(layout, message) || encode(module.__wire__(layout), message) do
          {:error, error} -> {:error, error}
          payload when version == 1 -> {:ok, id, crc_extra, binary_part(payload, 0, min)}
          payload -> {:ok, id, crc_extra, trim(payload)}
        end

      nil ->
        {:error, %EncodeError{message: module, got: module, expected: "a message of #{inspect(dialect)}"}}
    end
  end

  defp encode({base, extensions}, message) do
    case put(base ++ extensions, message) do
      {:error, error} -> {:error, error}
      bytes -> :erlang.iolist_to_binary(bytes)
    end
  end

  defp put([{key, type, length} | fields], message) do
    value = :erlang.map_get(key, message)

    case Value.encode(value, type, length) do
      {:ok, bytes} ->
        case put(fields, message) do
          {:error, error} -> {:error, error}
          rest -> [bytes | rest]
        end

      {:error, expected} ->
        {:error, %EncodeError{message: message.__struct__, field: key, got: value, expected: expected}}
    end
  end

  defp put([], _message), do: []

  @doc """
  What a message cannot say in a version: `:id` if version 1 has no such message (F2), the key of an extension field
  that is not zero and would be lost (F9), or nil.
  """
  @spec unsayable(t(), 1 | 2) :: :id | atom() | nil
  def unsayable(_message, 2), do: nil

  def unsayable(%module{} = message, 1) do
    if module.id() > 255,
      do: :id,
      else:
        Enum.find_value(module.fields(), &(&1.extension and not zero?(Map.get(message, &1.key)) and &1.key))
  end

  defp zero?(values) when is_list(values), do: Enum.all?(values, &zero?/1)
  defp zero?(bytes) when is_binary(bytes), do: trim(bytes) in ["", <<0>>]
  defp zero?(number), do: number == 0

  @doc "A payload without its trailing zeros; its first byte always stays (F7)."
  @spec trim(binary()) :: binary()
  def trim(<<payload::binary>>), do: trim(payload, byte_size(payload))

  defp trim(payload, size) when size > 8 do
    case payload do
      <<_::binary-size(^size - 8), 0::64, _::binary>> -> trim(payload, size - 8)
      _other -> trim_byte(payload, size)
    end
  end

  defp trim(payload, size), do: trim_byte(payload, size)

  defp trim_byte(payload, size) when size > 1 do
    case :binary.at(payload, size - 1) do
      0 -> trim_byte(payload, size - 1)
      _other -> binary_part(payload, 0, size)
    end
  end

  defp trim_byte(payload, size), do: binary_part(payload, 0, size)
end
