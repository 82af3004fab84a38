defmodule MavCodec.Message do
  @moduledoc """
  Messages as structs: what every module under `MavCodec.Messages` has, and the way from a struct to a payload.

  Integers, enums and bitmasks are integers; floats are floats, or `:nan`, `:infinity`, `:neg_infinity` and
  `{:nan, bits}`; `char[]` is text without the NULs behind it; `uint8_t[]` is a binary; other arrays are lists. A new
  struct is all zeros, so it can be encoded with only the fields set that matter.
  """

  alias MavCodec.EncodeError
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
  Encodes a message to its payload as one dialect lays it out.

  `version` 2 has the extensions and cuts trailing zeros (F7); `version` 1 has neither, and only ids up to 255.
  Returns the id and the CRC_EXTRA that the frame needs.
  """
  @spec encode_payload(t(), 1 | 2, module()) ::
          {:ok, id :: 0..0xFFFFFF, crc_extra :: 0..255, payload :: binary()} | {:error, EncodeError.t()}
  def encode_payload(message, version \\ 2, dialect \\ MavCodec.Dialects.All)

  def encode_payload(%module{} = message, version, dialect) when version in [1, 2] do
    case dialect.layout(module) do
      {id, _crc_extra, _base, _extensions} when version == 1 and id > 255 ->
        {:error, %EncodeError{message: module, got: id, expected: "an id up to 255 for MAVLink 1"}}

      {id, crc_extra, base, _extensions} when version == 1 ->
        with {:ok, payload} <- put(base, message, <<>>), do: {:ok, id, crc_extra, payload}

      {id, crc_extra, base, extensions} ->
        with {:ok, payload} <- put(base, message, <<>>),
             {:ok, payload} <- put(extensions, message, payload),
             do: {:ok, id, crc_extra, trim(payload)}

      nil ->
        {:error, %EncodeError{message: module, got: module, expected: "a message of #{inspect(dialect)}"}}
    end
  end

  defp put([{key, type, length} | fields], message, acc) do
    value = :erlang.map_get(key, message)

    case Value.encode(value, type, length) do
      {:ok, bytes} ->
        put(fields, message, <<acc::binary, bytes::binary>>)

      {:error, expected} ->
        {:error, %EncodeError{message: message.__struct__, field: key, got: value, expected: expected}}
    end
  end

  defp put([], _message, acc), do: {:ok, acc}

  @doc "A payload without its trailing zeros; its first byte always stays (F7)."
  @spec trim(binary()) :: binary()
  def trim(<<payload::binary>>), do: trim(payload, byte_size(payload))

  defp trim(payload, size) when size > 1 do
    case :binary.at(payload, size - 1) do
      0 -> trim(payload, size - 1)
      _other -> binary_part(payload, 0, size)
    end
  end

  defp trim(payload, size), do: binary_part(payload, 0, size)
end
