# What the codec costs: `bin/bench codec`, or in apps/mav_codec `MIX_ENV=prod mix run bench/codec.exs`.
#
# BENCH_MS: milliseconds per row (default 1500).

for file <- ~w(measure telemetry_mix pymavlink), do: Code.require_file("support/#{file}.ex", __DIR__)

alias MavCodec.Bench.{Measure, Pymavlink, TelemetryMix}
alias MavCodec.{CRC, Frame, Parser}

count = 2000
milliseconds = String.to_integer(System.get_env("BENCH_MS", "1500"))
messages = TelemetryMix.messages(count)
frames = TelemetryMix.frames(messages)
data = IO.iodata_to_binary(frames)
reads = TelemetryMix.reads(frames, 1400)
parser = Parser.new()
{parsed, _} = Parser.push(parser, data)
^frames = Enum.map(parsed, & &1.bytes)

defmodule Bench.Loops do
  # The work of each row without what it is given to: loops that keep nothing but the last result.
  def cut(<<>>), do: :ok

  def cut(data) do
    {:ok, _header, _len, size, _id, _system} = Frame.header(data)
    <<bytes::binary-size(^size), rest::binary>> = data
    _frame = Frame.from_bytes(bytes, nil)
    cut(rest)
  end

  def push([read | reads], parser) do
    {_frames, parser} = Parser.push(parser, read)
    push(reads, parser)
  end

  def push([], parser), do: parser

  def datagrams([read | reads], parser) do
    {_frames, parser} = Parser.push_datagram(parser, read)
    datagrams(reads, parser)
  end

  def datagrams([], parser), do: parser

  def full([read | reads], parser) do
    {frames, parser} = Parser.push(parser, read)
    decode(frames)
    full(reads, parser)
  end

  def full([], parser), do: parser

  def decode([frame | frames]) do
    {:ok, _message} = MavCodec.decode(frame)
    decode(frames)
  end

  def decode([]), do: :ok

  def encode([message | messages], seq) do
    _bytes = MavCodec.encode(message, system: 1, component: 1, seq: seq)
    encode(messages, seq + 1)
  end

  def encode([], _seq), do: :ok

  def crc([frame | frames]) do
    _crc = CRC.frame(frame, byte_size(frame) - 3, 50)
    crc(frames)
  end

  def crc([]), do: :ok
end

average = Float.round(byte_size(data) / count, 1)

IO.puts(
  "#{count} frames of a telemetry mix, #{average} bytes on average, reads of up to 1400 bytes, one core"
)

IO.puts(
  "Erlang/OTP #{System.otp_release()}, Elixir #{System.version()}, #{:erlang.system_info(:system_architecture)}\n"
)

rows = [
  Measure.run("CRC only", count, fn -> Bench.Loops.crc(frames) end, milliseconds),
  Measure.run("framing only", count, fn -> Enum.each(reads, &Bench.Loops.cut/1) end, milliseconds),
  Measure.run("framing + CRC (Parser.push)", count, fn -> Bench.Loops.push(reads, parser) end, milliseconds),
  Measure.run(
    "the same, a datagram each",
    count,
    fn -> Bench.Loops.datagrams(frames, parser) end,
    milliseconds
  ),
  Measure.run("decode of parsed frames", count, fn -> Bench.Loops.decode(parsed) end, milliseconds),
  Measure.run("full decode to structs", count, fn -> Bench.Loops.full(reads, parser) end, milliseconds),
  Measure.run("encode", count, fn -> Bench.Loops.encode(messages, 0) end, milliseconds)
]

python = Pymavlink.python()

peer =
  if python do
    {^count, times, _} = Pymavlink.parse(python, data, 5)
    [Measure.row("pymavlink, full decode", count, times)]
  else
    []
  end

IO.puts(Measure.table(rows ++ peer))
unless python, do: IO.puts("pymavlink is not there (set AERIE_VENV to a venv that has it): left out")

# One byte in a hundred damaged: how many of the frames that stayed whole are found?
damaged = TelemetryMix.damage(frames, 100)
whole = for {frame, frame} <- Enum.zip(frames, damaged), do: frame
stream = IO.iodata_to_binary(damaged)
{found, broken} = Parser.push(parser, stream)
{rest, _} = Parser.flush(broken)
found = for frame <- found ++ rest, Frame.known?(frame), do: frame.bytes
ours = length(whole) - length(whole -- found)
percent = fn n -> "#{Float.round(100 * n / length(whole), 2)} %" end
IO.puts("\n1 % of the bytes damaged: #{length(whole)} of #{count} frames stayed whole")
IO.puts("found: #{ours} (#{percent.(ours)})")

row =
  Measure.run(
    "damaged stream",
    length(whole),
    fn -> Bench.Loops.push([stream], parser) end,
    milliseconds
  )

IO.puts("time per whole frame: #{round(row.best)} ns")

if python do
  {_, _, bytes} = Pymavlink.parse(python, stream, 1)
  {theirs, _} = Parser.push(parser, bytes)
  theirs = length(whole) - length(whole -- Enum.map(theirs, & &1.bytes))
  IO.puts("found by pymavlink: #{theirs} (#{percent.(theirs)})")
end
