defmodule Aerie.Control.Ftp.Reading do
  @moduledoc """
  Which parts of a file were received, and what to request next. First the file is read to its end by bursts. Then the gaps are
  filled: by further bursts while there are many, and by single reads when few are left.

  The size that the vehicle gives on opening means nothing for a file that it generates while it is read, such as ArduPilot's
  parameter file. The file ends where the vehicle says EOF: in answer to a request after the last byte, or in a burst directly after it.
  ArduPilot ends a burst with a short packet instead, which counts if it ends at the opened size, or in a generated file.
  All requests are for 239 bytes: ArduPilot's parameter file can be read only in pieces of one size.
  """

  alias Aerie.Control.Ftp.Ranges
  alias MavCodec.Ftp.Packet

  @chunk Packet.max_data()
  @many 8
  # Gaps are filled before more is read once there are this many.
  @max_gaps 256

  @enforce_keys [:ranges, :max_bytes]
  defstruct [:ranges, :max_bytes, :size, :last, :told, bursts?: true, eof?: false, heard?: false, cursor: 0]

  @type t :: %__MODULE__{}

  @doc "A read that continues at `offset`."
  @spec new(non_neg_integer(), pos_integer()) :: t()
  def new(offset, max_bytes), do: %__MODULE__{ranges: Ranges.new(offset), max_bytes: max_bytes}

  @doc "Records the size of the opened file; `:made` for a file that the vehicle generates while it is read."
  @spec opened(t(), non_neg_integer() | nil | :made) :: t()
  def opened(reading, told), do: %{reading | told: told}

  @doc "The number of bytes from the beginning without a gap."
  @spec offset(t()) :: non_neg_integer()
  def offset(reading), do: Ranges.contiguous(reading.ranges)

  @doc "The number of bytes received."
  @spec size(t()) :: non_neg_integer()
  def size(reading), do: Ranges.size(reading.ranges)

  @doc "The parts of a packet that are new, as `{offset, bytes}`."
  @spec took(t(), Packet.t()) :: {[{non_neg_integer(), binary()}] | :too_large, t()}
  def took(reading, %{offset: from, data: data} = packet) do
    to = from + byte_size(data)

    if to > reading.max_bytes do
      {:too_large, reading}
    else
      gaps =
        for {a, b} <- Ranges.gaps(reading.ranges, to), a < to and b > from, do: {max(a, from), min(b, to)}

      new = for {a, b} <- gaps, do: {a, binary_part(data, a - from, b - a)}
      ranges = Ranges.add(reading.ranges, from, to)
      reading = %{reading | ranges: ranges, heard?: true, last: {packet.seq, to}, cursor: to}
      {new, if(last?(reading, from, to), do: %{reading | size: to, eof?: true}, else: reading)}
    end
  end

  defp last?(%{told: told} = reading, from, to),
    do: to - from < @chunk and to > from and told in [to, :made] and to == Ranges.top(reading.ranges)

  @doc "Records that the vehicle said EOF."
  @spec ended(t(), Packet.t(), request :: Packet.t()) :: t()
  def ended(reading, nak, request) do
    top = Ranges.top(reading.ranges)
    after_last? = reading.last == {Bitwise.band(nak.seq - 1, 0xFFFF), top}

    answer? =
      nak.request == request.opcode and nak.seq == Bitwise.band(request.seq + 1, 0xFFFF) and
        request.offset >= top

    if after_last? or answer?,
      do: %{reading | size: top, eof?: true},
      else: %{reading | eof?: true}
  end

  @doc "Records that the vehicle does not support bursts."
  @spec without_bursts(t()) :: t()
  def without_bursts(reading), do: %{reading | bursts?: false}

  @doc "The next request, or that the file is complete."
  @spec next(t()) :: {:done, non_neg_integer()} | {:burst | :read, offset :: non_neg_integer(), t()}
  def next(reading) do
    top = Ranges.top(reading.ranges)
    gaps = Ranges.gaps(reading.ranges, top)

    cond do
      gaps == [] and reading.size == top -> {:done, top}
      # After EOF, bytes before it may still be missing: a read there shows it.
      gaps == [] and reading.eof? -> {:read, top, reading}
      gaps == [] -> forward(reading, top)
      not reading.eof? and length(gaps) < @max_gaps -> forward(reading, top)
      true -> fill(reading, gaps)
    end
  end

  defp forward(%{bursts?: true} = reading, top), do: {:burst, top, %{reading | heard?: false}}
  defp forward(reading, top), do: {:read, top, reading}

  defp fill(%{bursts?: true} = reading, gaps) when length(gaps) > @many do
    {from, _to} = Enum.find(gaps, hd(gaps), fn {from, _to} -> from >= reading.cursor end)
    {:burst, from, %{reading | heard?: false}}
  end

  defp fill(reading, [{from, to} | _rest]) when to - from > @many * @chunk and reading.bursts?,
    do: {:burst, from, %{reading | heard?: false}}

  defp fill(reading, [{from, _to} | _rest]), do: {:read, from, reading}
end
