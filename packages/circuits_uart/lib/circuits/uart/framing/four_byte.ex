defmodule Circuits.UART.Framing.FourByte do
  @moduledoc """
  Each message is four bytes. Sent bytes are left as they are. Use `:rx_framing_timeout` to get back into step after a
  lost byte: the one to three bytes that are there then come as one short message.
  """

  @behaviour Circuits.UART.Framing

  @impl Circuits.UART.Framing
  def init(_args), do: {:ok, ""}

  @impl Circuits.UART.Framing
  def add_framing(data, part) when is_binary(data), do: {:ok, data, part}

  @impl Circuits.UART.Framing
  def remove_framing(data, part) do
    bytes = part <> data
    whole = byte_size(bytes) - rem(byte_size(bytes), 4)
    <<messages::binary-size(^whole), rest::binary>> = bytes
    status = if rest == "", do: :ok, else: :in_frame
    {status, for(<<message::binary-4 <- messages>>, do: message), rest}
  end

  @impl Circuits.UART.Framing
  def frame_timeout(""), do: {:ok, [], ""}
  def frame_timeout(part), do: {:ok, [part], ""}

  @impl Circuits.UART.Framing
  def flush(:transmit, part), do: part
  def flush(_receive_or_both, _part), do: ""
end
