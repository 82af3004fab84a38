defmodule MavCodec.Tlog.Reader do
  @moduledoc """
  Reads tlog files as streams, so that a file of any size needs little memory (G1).

      "flight.tlog" |> MavCodec.Tlog.Reader.frames!() |> Enum.each(&IO.inspect(&1.at))

  Each frame has the time of its record. A damaged part loses only itself, a truncated file only its last record: see
  `MavCodec.Tlog.Decoder`.
  """

  alias MavCodec.{Frame, Tlog}

  @chunk 65_536

  @doc """
  The frames of a file, and a `MavCodec.Tlog.Damage` wherever bytes were skipped, in the order of the file.

  The file is opened when the stream is run, and again for each run; `File.Error` is raised when that fails. Options are
  those of `MavCodec.Parser.new/1`.
  """
  @spec stream!(Path.t(), [MavCodec.Parser.option()]) :: Enumerable.t(Frame.t() | Tlog.Damage.t())
  def stream!(path, options \\ []) do
    path
    |> File.stream!(@chunk)
    |> Stream.transform(
      fn -> Tlog.Decoder.new(options) end,
      fn chunk, decoder -> Tlog.Decoder.push(decoder, chunk) end,
      fn decoder -> {Tlog.Decoder.finish(decoder), decoder} end,
      fn _decoder -> :ok end
    )
  end

  @doc "Only the frames of a file."
  @spec frames!(Path.t(), [MavCodec.Parser.option()]) :: Enumerable.t(Frame.t())
  def frames!(path, options \\ []), do: path |> stream!(options) |> Stream.filter(&is_struct(&1, Frame))
end
