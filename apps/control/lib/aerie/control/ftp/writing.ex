defmodule Aerie.Control.Ftp.Writing do
  @moduledoc "How much of a file has been written. Pieces are written in order, and each is acknowledged."

  alias MavCodec.Ftp.Packet

  @enforce_keys [:bytes, :offset]
  defstruct [:bytes, :offset]

  @type t :: %__MODULE__{bytes: binary(), offset: non_neg_integer()}

  @doc "A write that continues at `offset`."
  @spec new(binary(), non_neg_integer()) :: t()
  def new(bytes, offset), do: %__MODULE__{bytes: bytes, offset: min(offset, byte_size(bytes))}

  @doc "Whether anything has been written."
  @spec begun?(t()) :: boolean()
  def begun?(writing), do: writing.offset > 0

  @doc "A write from the beginning."
  @spec again(t()) :: t()
  def again(writing), do: %{writing | offset: 0}

  @doc "The number of bytes written."
  @spec offset(t()) :: non_neg_integer()
  def offset(writing), do: writing.offset

  @doc "The next piece."
  @spec next(t()) :: {offset :: non_neg_integer(), binary()} | :done
  def next(%{bytes: bytes, offset: offset}) when offset == byte_size(bytes), do: :done

  def next(%{bytes: bytes, offset: offset}),
    do: {offset, binary_part(bytes, offset, min(Packet.max_data(), byte_size(bytes) - offset))}

  @doc "Records that a piece was acknowledged."
  @spec written(t(), Packet.t()) :: {t(), list()}
  def written(writing, %{offset: offset, data: data}) do
    done = offset + byte_size(data)
    {%{writing | offset: done}, [{:progress, done, byte_size(writing.bytes)}]}
  end
end
