defmodule MavCodec.Frame.Splitter do
  @moduledoc """
  Cuts bytes on their way out into whole frames. It does not search for frames, as a parser would: bytes that do not begin with a
  frame have none.
  """

  alias MavCodec.{CRC, Dialects, Frame}

  @doc """
  The frames at the beginning of `bytes`, and the rest. Their `crc_extra` is nil; `checked/1` finds it out where it is needed.
  """
  @spec frames(binary, integer | nil) :: {[Frame.t()], binary}
  def frames(bytes, at \\ nil), do: frames(bytes, at, [])

  defp frames(bytes, at, found) do
    case Frame.header(bytes) do
      {:ok, _header, _payload, size, _id, _system} when byte_size(bytes) >= size ->
        <<frame::binary-size(^size), rest::binary>> = bytes
        frames(rest, at, [Frame.from_bytes(frame, nil, at) | found])

      _no_frame ->
        {Enum.reverse(found), bytes}
    end
  end

  @doc "The frame with its `crc_extra`, nil for an unknown message."
  @spec checked(Frame.t()) :: Frame.t()
  def checked(%Frame{crc_extra: nil} = frame), do: %{frame | crc_extra: extra(frame, frame.id)}
  def checked(frame), do: frame

  # The value, of those that the message may have, with which the CRC is right.
  defp extra(%Frame{bytes: bytes, signature: signature}, id) do
    size = byte_size(bytes) - if(signature, do: 15, else: 2)
    <<_::binary-size(^size), crc::16-little, _::binary>> = bytes

    id
    |> Dialects.All.crc_extra()
    |> List.wrap()
    |> Enum.find(&(CRC.frame(bytes, size - 1, &1) == crc))
  end
end
