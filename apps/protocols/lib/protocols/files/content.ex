defmodule Protocols.Files.Content do
  @moduledoc """
  A file that is read by MAVLink FTP, on the side that has it: the answers to reads and bursts (T3).

  ArduPilot makes its parameter file while it is read, so that no value lies in two pieces. Such a file is read in
  pieces of one size, at multiples of it.
  """

  alias MavCodec.Ftp.Packet

  @burst_packets 60
  @pieces 32..239
  # ArduPilot says this of every file that it makes while it is read.
  @made_size 16_704

  defstruct [:make, :bytes, :piece]

  @typedoc "`make`: the bytes for pieces of a size; `piece`: that size, once it was read"
  @type t :: %__MODULE__{
          make: (pos_integer() -> binary()) | nil,
          bytes: binary() | nil,
          piece: pos_integer() | nil
        }

  @doc "A file with these bytes."
  @spec stored(binary()) :: t()
  def stored(bytes), do: %__MODULE__{bytes: bytes}

  @doc "A file that is made for the size of the pieces in which it is read."
  @spec made((pos_integer() -> binary())) :: t()
  def made(make), do: %__MODULE__{make: make}

  @doc "The size that a station gets when it opens the file."
  @spec size(t()) :: non_neg_integer()
  def size(%{make: nil, bytes: bytes}), do: byte_size(bytes)
  def size(_made), do: @made_size

  @doc "All of it; what is made, for pieces of the largest size."
  @spec bytes(t()) :: binary()
  def bytes(%{make: nil, bytes: bytes}), do: bytes
  def bytes(%{make: make}), do: make.(@pieces.last)

  @doc """
  The answers to a read or a burst, numbered from the request on. At the end a burst has a short piece that is complete
  (`:short`, as with ArduPilot), or EOF (`:eof`, as with PX4).
  """
  @spec answers(t(), Packet.t(), :short | :eof) :: {:ok, [Packet.t(), ...], t()} | :error
  def answers(content, request, ending) do
    with {:ok, content} <- begun(content, request) do
      if Packet.operation(request) == :burst,
        do: {:ok, burst(content, request, ending, @burst_packets), content},
        else: {:ok, [piece(content, request)], content}
    end
  end

  defp begun(%{make: nil} = content, _request), do: {:ok, content}

  defp begun(%{piece: nil} = content, %{size: size} = request) when size in @pieces,
    do: begun(%{content | piece: size, bytes: content.make.(size)}, request)

  # The last piece may be a short one: where it ends is not a multiple.
  defp begun(%{bytes: bytes} = content, %{offset: offset}) when offset >= byte_size(bytes), do: {:ok, content}

  defp begun(%{piece: size} = content, %{size: size, offset: offset}) when rem(offset, size) == 0,
    do: {:ok, content}

  defp begun(_content, _request), do: :error

  defp piece(%{bytes: bytes} = content, %{offset: offset, size: size} = request) do
    if beyond?(content, request),
      do: Packet.nak(request, :eof),
      else: Packet.ack(request, binary_part(bytes, offset, min(size, byte_size(bytes) - offset)))
  end

  defp beyond?(%{bytes: bytes}, %{offset: offset, size: size}), do: offset >= byte_size(bytes) or size == 0

  defp burst(content, %{size: size} = request, ending, left) do
    answer = piece(content, request)
    at = request.offset + size

    cond do
      beyond?(content, request) -> [answer]
      left == 1 or (ending == :short and at > byte_size(content.bytes)) -> [%{answer | complete: true}]
      true -> [answer | burst(content, %{request | offset: at, seq: request.seq + 1}, ending, left - 1)]
    end
  end
end
