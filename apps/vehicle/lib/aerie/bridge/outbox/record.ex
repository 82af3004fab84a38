defmodule Aerie.Bridge.Outbox.Record do
  @moduledoc """
  One event in the outbox: what is needed to publish it again.

  On disk: length of the rest (32 bits), CRC-32 of the rest (32 bits), then id, vehicle and subject, each with a length
  byte, and the body. A record that is cut off or damaged ends the readable part of its file.
  """

  @enforce_keys [:id, :vehicle, :subject, :body]
  defstruct [:id, :vehicle, :subject, :body]

  @typedoc "`id` of the event; `vehicle`, whose events stay in order; `subject` and `body` of the message."
  @type t :: %__MODULE__{id: String.t(), vehicle: String.t(), subject: String.t(), body: binary()}

  @max_bytes 131_072

  @doc "The largest record in bytes."
  @spec max_bytes() :: pos_integer()
  def max_bytes, do: @max_bytes

  @doc "The bytes of a record, or `:too_large`."
  @spec encode(t()) :: {:ok, binary()} | :too_large
  def encode(%__MODULE__{id: id, vehicle: vehicle, subject: subject, body: body})
      when byte_size(id) < 256 and byte_size(vehicle) < 256 and byte_size(subject) < 256 and
             byte_size(id) + byte_size(vehicle) + byte_size(subject) + byte_size(body) + 11 <= @max_bytes do
    rest =
      <<byte_size(id), id::binary, byte_size(vehicle), vehicle::binary, byte_size(subject), subject::binary,
        body::binary>>

    {:ok, <<byte_size(rest)::32, :erlang.crc32(rest)::32, rest::binary>>}
  end

  def encode(%__MODULE__{}), do: :too_large

  @doc "The records at the start of `bytes`, at most `limit`, each with its size on disk; and why decoding stopped."
  @spec decode(binary(), non_neg_integer() | :all) ::
          {[{t(), pos_integer()}], :limit | :end | :cut | :damaged}
  def decode(bytes, limit), do: decode(bytes, limit, [])

  defp decode(_bytes, 0, records), do: {Enum.reverse(records), :limit}
  defp decode(<<>>, _limit, records), do: {Enum.reverse(records), :end}

  defp decode(<<length::32, crc::32, rest::binary-size(length), more::binary>>, limit, records)
       when length <= @max_bytes do
    with true <- :erlang.crc32(rest) == crc,
         <<i, id::binary-size(i), v, vehicle::binary-size(v), s, subject::binary-size(s), body::binary>> <-
           rest do
      record = %__MODULE__{id: id, vehicle: vehicle, subject: subject, body: body}
      decode(more, less(limit), [{record, length + 8} | records])
    else
      _ -> {Enum.reverse(records), :damaged}
    end
  end

  defp decode(<<length::32, _::binary>>, _limit, records) when length > @max_bytes,
    do: {Enum.reverse(records), :damaged}

  defp decode(_cut, _limit, records), do: {Enum.reverse(records), :cut}

  defp less(:all), do: :all
  defp less(limit), do: limit - 1
end
