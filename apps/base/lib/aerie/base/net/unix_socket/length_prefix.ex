defmodule Aerie.Base.Net.UnixSocket.LengthPrefix do
  @moduledoc """
  The form of `mavlink.sock`: a 4-byte little-endian length before each frame, both ways. Pure.

  A length that no frame has means that the other end does not use this form. There is no way to resynchronise, so
  it is an error that ends the connection.
  """

  # The shortest is a MAVLink 1 frame without payload, the longest a signed MAVLink 2 one (F1); ids of 32 bits take some more.
  @shortest 8
  @longest 288

  @doc "The frames that are complete in what was received, and the rest. Fewer than #{@longest + 4} bytes are kept."
  @spec split(binary()) :: {:ok, [binary()], rest :: binary()} | {:error, length :: non_neg_integer()}
  def split(received), do: split(received, [])

  defp split(<<length::32-little, _::binary>>, _frames) when length not in @shortest..@longest,
    do: {:error, length}

  defp split(<<length::32-little, frame::binary-size(length), rest::binary>>, frames),
    do: split(rest, [frame | frames])

  defp split(rest, frames), do: {:ok, Enum.reverse(frames), rest}

  @doc "A frame with its length before it."
  @spec wrap(binary()) :: iodata()
  def wrap(frame), do: [<<byte_size(frame)::32-little>>, frame]
end
