# Measures the codec: parsing, decoding and encoding a mix of telemetry, and hostile bytes.
#
#     bin/bench codec [--ms 1500]
#
# Each row is measured for so many milliseconds, a hostile one for a third of that.

for file <- ~w(measure options flight_messages telemetry_mix pymavlink),
    do: Code.require_file("support/#{file}.ex", __DIR__)

Code.require_file("../test/support/hostile.ex", __DIR__)

alias MavCodec.Bench.{Measure, Pymavlink, TelemetryMix}
alias MavCodec.{CRC, Parser, Signing}
alias MavCodec.Dialects.Ardupilot.Ardupilotmega
alias MavCodec.Test.Hostile

milliseconds = MavCodec.Bench.Options.read(__ENV__.file, System.argv(), ms: 1500)[:ms]
# Of each stream, and of the file that is pushed at once: 8 MB.
count = 20_000
many = 200_000

defmodule Bench.Loops do
  # The work of each row without what it is given to: loops that keep nothing but the last result.
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

  def whole(file, parser) do
    {:ok, parser} = Parser.reduce(parser, file, :ok, fn frame, :ok -> decode([frame]) end)
    parser
  end

  def verified([read | reads], parser, signing) do
    {frames, parser} = Parser.push(parser, read)
    verified(reads, parser, decode_signed(frames, signing))
  end

  def verified([], parser, _signing), do: parser

  # An unknown id is noise of a damaged stream.
  def decode([frame | frames]) do
    _message = MavCodec.decode(frame, Ardupilotmega)
    decode(frames)
  end

  def decode([]), do: :ok

  defp decode_signed([frame | frames], signing) do
    {:signed, signing} = Signing.check(signing, frame)
    {:ok, _message} = MavCodec.decode(frame, Ardupilotmega)
    decode_signed(frames, signing)
  end

  defp decode_signed([], signing), do: signing

  def check([frame | frames], signing) do
    {:signed, signing} = Signing.check(signing, frame)
    check(frames, signing)
  end

  def check([], signing), do: signing

  def encode([{system, message} | messages], seq) do
    _bytes = MavCodec.encode(message, system: system, component: 1, seq: rem(seq, 256))
    encode(messages, seq + 1)
  end

  def encode([], _seq), do: :ok

  def crc([frame | frames]) do
    _crc = CRC.frame(frame, byte_size(frame) - 3, 50)
    crc(frames)
  end

  def crc([]), do: :ok
end

read = 4096
messages = TelemetryMix.messages(count)
key = Signing.key("a key for the benchmark")
frames = TelemetryMix.frames(messages)
first = Enum.take(frames, 2000)
data = IO.iodata_to_binary(frames)
file = many |> TelemetryMix.messages() |> TelemetryMix.frames() |> IO.iodata_to_binary()
some = Enum.take(messages, 2000)
signed = messages |> TelemetryMix.signed(key) |> IO.iodata_to_binary()
v1_frames = TelemetryMix.frames(messages, 1)
v1 = IO.iodata_to_binary(v1_frames)
{damaged, whole} = TelemetryMix.damage(frames)

parser = Parser.new(dialects: [Ardupilotmega])
{parsed, _} = Parser.push(parser, IO.iodata_to_binary(first))
^first = Enum.map(parsed, & &1.bytes)
{parsed_signed, _} = Parser.push(parser, binary_part(signed, 0, 100_000))

cut = &TelemetryMix.cut(&1, read)
run = fn name, frames, fun -> Measure.run(name, frames, fun, milliseconds) end
heading = fn text -> IO.puts("\n#{text}\n") end

IO.puts(
  "33 messages of three vehicles, #{Float.round(byte_size(data) / count, 1)} bytes a frame on average, reads of #{read} bytes, one core"
)

IO.puts(
  "Erlang/OTP #{System.otp_release()}, Elixir #{System.version()}, #{:erlang.system_info(:system_architecture)}"
)

heading.("Bytes to message structs, every CRC checked")
python = Pymavlink.python()

python_row = fn name, data ->
  {found, times, _} = Pymavlink.parse(python, data, 3)
  Measure.row("#{name}, pymavlink", found, times)
end

part = fn data -> binary_part(data, 0, min(byte_size(data), 400_000)) end

rows = [
  run.("MAVLink 2", count, fn -> Bench.Loops.full(cut.(data), parser) end),
  run.("MAVLink 1", length(v1_frames), fn -> Bench.Loops.full(cut.(v1), parser) end),
  run.("signed, verified", count, fn -> Bench.Loops.verified(cut.(signed), parser, Signing.new(key)) end),
  run.("1 % damaged", length(whole), fn -> Bench.Loops.full(cut.(damaged), parser) end),
  run.("MAVLink 2, 8 MB in reads", many, fn -> Bench.Loops.full(cut.(file), parser) end),
  run.("MAVLink 2, 8 MB in one reduce", many, fn -> Bench.Loops.whole(file, parser) end),
  run.("MAVLink 2, 8 MB in one push", many, fn -> Bench.Loops.full([file], parser) end)
]

peers =
  if python,
    do: [
      python_row.("MAVLink 2", part.(data)),
      python_row.("MAVLink 1", part.(v1)),
      python_row.("1 % damaged", part.(damaged))
    ],
    else: []

IO.puts(Measure.table(rows ++ peers))
unless python, do: IO.puts("pymavlink is not there (set AERIE_VENV to a venv that has it): left out")

heading.("Parts of it, MAVLink 2")
reads = cut.(IO.iodata_to_binary(first))

IO.puts(
  Measure.table([
    run.("CRC only", 2000, fn -> Bench.Loops.crc(first) end),
    run.("framing and CRC (push)", 2000, fn -> Bench.Loops.push(reads, parser) end),
    run.("the same, a datagram each", 2000, fn -> Bench.Loops.datagrams(first, parser) end),
    run.("decode of parsed frames", 2000, fn -> Bench.Loops.decode(parsed) end),
    run.("check of signatures", length(parsed_signed), fn ->
      Bench.Loops.check(parsed_signed, Signing.new(key))
    end),
    run.("encode", 2000, fn -> Bench.Loops.encode(some, 0) end)
  ])
)

heading.("Undamaged frames found in the damaged stream")
wanted = Enum.take(whole, 5000)
{found, broken} = Parser.push(parser, damaged)
{rest, _} = Parser.flush(broken)
ours = MapSet.new(for frame <- found ++ rest, do: frame.bytes)
share = fn found -> Float.round(100 * Enum.count(wanted, &MapSet.member?(found, &1)) / length(wanted), 2) end
IO.puts("ours: #{share.(ours)} %")

if python do
  {_, _, bytes} = Pymavlink.parse(python, binary_part(damaged, 0, min(byte_size(damaged), 300_000)), 1)
  {theirs, _} = Parser.push(parser, bytes)
  IO.puts("pymavlink: #{share.(MapSet.new(theirs, & &1.bytes))} %")
end

heading.("Hostile bytes, one datagram of 65,507")
size = 65_507
:rand.seed(:exsss, {3, 5, 7})
random = {"random bytes", :rand.bytes(size)}

# What rows with frames in them have to be compared with.
valid =
  for message <- [%MavCodec.Messages.SystemTime{}, %MavCodec.Messages.Heartbeat{type: 2}] do
    frame = MavCodec.encode(message, system: 1)
    {"valid frames of #{byte_size(frame)} bytes", :binary.copy(frame, div(size, byte_size(frame)) + 1)}
  end

hostile =
  for {name, data} <- [random | valid] ++ Hostile.all(size) do
    data = binary_part(data, 0, size)
    {frames, _} = Parser.push_datagram(parser, data)
    row = Measure.run(name, size, fn -> Parser.push_datagram(parser, data) end, div(milliseconds, 3))
    {row, length(frames)}
  end

{%{best: base}, _} = hd(hostile)

line = fn cells ->
  Enum.zip_with(cells, [42, 14, 16, 14, 14, 8], &String.pad_trailing/2) |> Enum.join() |> IO.puts()
end

line.(["", "best ns/byte", "median ns/byte", "p99 ns/byte", "times random", "frames"])

for {row, frames} <- hostile do
  [best, median, p99] = for n <- [row.best, row.median, row.p99], do: "#{Float.round(n * 1.0, 1)}"
  line.([row.name, best, median, p99, "#{Float.round(row.best / base, 1)}", "#{frames}"])
end
