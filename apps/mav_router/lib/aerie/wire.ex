defmodule Aerie.Wire do
  @moduledoc """
  Whole frames in bytes that are on their way out: what we made ourselves, or forward. Nothing is searched for in them, as a
  parser would: what does not begin with a frame is none.
  """

  alias MavCodec.{CRC, Dialects, Frame}

  @doc """
  The frames that `bytes` begin with, and the rest. Their `crc_extra` is nil: `checked/1` finds it out, for those that need
  it.
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

  @doc "The frame with the `crc_extra` that it was made with; nil for an unknown message."
  @spec checked(Frame.t()) :: Frame.t()
  def checked(%Frame{crc_extra: nil} = frame), do: %{frame | crc_extra: extra(frame, frame.id)}
  def checked(frame), do: frame

  # The one of a message's values with which the frame was made.
  defp extra(%Frame{bytes: bytes, signature: signature}, id) do
    size = byte_size(bytes) - if(signature, do: 15, else: 2)
    <<_::binary-size(^size), crc::16-little, _::binary>> = bytes

    id
    |> Dialects.All.crc_extra()
    |> List.wrap()
    |> Enum.find(&(CRC.frame(bytes, size - 1, &1) == crc))
  end
end
