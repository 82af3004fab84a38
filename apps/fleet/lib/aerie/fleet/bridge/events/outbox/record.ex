defmodule Aerie.Fleet.Bridge.Events.Outbox.Record do
  @moduledoc """
  One event in the outbox: what is needed to publish it again.

  On disk: length of the rest (32 bits), CRC-32 of the rest (32 bits), then id, vehicle and subject, each with a length
  byte, and the body. A record that is cut off or damaged ends the readable part of its file.
  """

  alias Aerie.Base.Segments.Segment

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

  @doc "Reads the next record of a file (`t:Aerie.Base.Segments.Segment.codec/0`)."
  @spec read(:file.fd()) :: {:ok, t(), pos_integer()} | Segment.ending() | {:error, term()}
  def read(file) do
    case :file.read(file, 8) do
      {:ok, <<length::32, _::binary>>} when length > @max_bytes -> :damaged
      {:ok, <<length::32, _crc::32>> = head} -> rest(:file.read(file, length), head)
      {:ok, cut} -> {:torn, cut}
      eof_or_error -> eof_or_error
    end
  end

  defp rest({:ok, rest}, <<length::32, crc::32>>) when byte_size(rest) == length do
    with true <- :erlang.crc32(rest) == crc,
         <<i, id::binary-size(i), v, vehicle::binary-size(v), s, subject::binary-size(s), body::binary>> <-
           rest do
      {:ok, %__MODULE__{id: id, vehicle: vehicle, subject: subject, body: body}, length + 8}
    else
      _other -> :damaged
    end
  end

  defp rest({:ok, rest}, head), do: {:torn, head <> rest}
  defp rest(:eof, head), do: {:torn, head}
  defp rest(error, _head), do: error
end
