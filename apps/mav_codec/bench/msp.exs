# Measures MSP: framing and decoding what a real Betaflight 4.5.5 answered, with YAMSPy on the same bytes; and hostile bytes.
#
#     bin/bench msp [--ms 1500]
#
# Each row is measured for so many milliseconds.

for file <- ~w(measure options yamspy), do: Code.require_file("support/#{file}.ex", __DIR__)
Code.require_file("../test/support/msp_transcript.ex", __DIR__)

alias MavCodec.Bench.{Measure, Yamspy}
alias MavCodec.Msp
alias MavCodec.Msp.Parser

milliseconds = MavCodec.Bench.Options.read(__ENV__.file, System.argv(), ms: 1500)[:ms]

# YAMSPy knows neither version 2 over 1 nor refusals.
replies =
  for {_, _, _, <<"$", letter, ?>, _size, id, _::binary>> = reply} <-
        MavCodec.Test.MspTranscript.read(:betaflight),
      letter == ?X or id != 255,
      do: reply

count = length(replies)
stream = IO.iodata_to_binary(replies)
target = {:betaflight, {1, 46}}

defmodule Bench.Reads do
  def cut("", _size), do: []
  def cut(bytes, size) when byte_size(bytes) <= size, do: [bytes]

  def cut(bytes, size) do
    <<read::binary-size(^size), rest::binary>> = bytes
    [read | cut(rest, size)]
  end
end

push = fn reads -> Enum.reduce(reads, Parser.new(), &elem(Parser.push(&2, &1), 1)) end

decode = fn reads ->
  Enum.reduce(reads, Parser.new(), fn read, parser ->
    {frames, parser} = Parser.push(parser, read)
    for frame <- frames, do: {:ok, _values} = Msp.decode(frame, target)
    parser
  end)
end

damaged =
  for {byte, at} <- Enum.with_index(:binary.bin_to_list(stream)),
      into: <<>>,
      do: <<if(rem(at, 100) == 99, do: Bitwise.bxor(byte, 1), else: byte)>>

hostile = :binary.copy("$X>" <> <<0, 1, 0, 2000::16-little>>, 7_500)
random = :rand.bytes(60_000)
reads = fn bytes -> Bench.Reads.cut(bytes, 64) end

rows = [
  Measure.run("framing, reads of 64 bytes", count, fn -> push.(reads.(stream)) end, milliseconds),
  Measure.run("framing, each reply a read", count, fn -> push.(replies) end, milliseconds),
  Measure.run("framing and decoding, each reply a read", count, fn -> decode.(replies) end, milliseconds),
  Measure.run("framing, 1 % of the bytes damaged", count, fn -> push.(reads.(damaged)) end, milliseconds)
]

peer =
  case Yamspy.python() do
    nil -> []
    python -> [Measure.row("YAMSPy, framing and decoding", count, Yamspy.parse(python, stream, 20))]
  end

IO.puts("#{count} replies of Betaflight 4.5.5, #{div(byte_size(stream), count)} bytes each on average\n")
IO.puts(Measure.table(rows ++ peer))

IO.puts("\nns a byte of 60,000: beginnings of frames of 2,000 bytes, and random ones\n")

for {name, bytes} <- [{"hostile", hostile}, {"random", random}] do
  row = Measure.run(name, byte_size(bytes), fn -> push.(Bench.Reads.cut(bytes, 4096)) end, milliseconds)
  IO.puts("#{String.pad_trailing(name, 8)} #{Float.round(row.best, 1)}")
end
