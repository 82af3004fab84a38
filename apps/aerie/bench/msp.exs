# Measures MSP: framing and decoding what a real Betaflight 4.5.5 answered, with YAMSPy on the same bytes; hostile bytes; and, in simulated
# time, a session at a line of 115,200 baud to a flight controller that takes a request in 10 ms: how many requests it makes a second, what
# share of the line that is, and how long a client waits for a parameter meanwhile. Then the same in real time: a whole gateway at a pseudo terminal that passes
# bytes as fast as such a line, with a simulated Betaflight at its end.
#
#     bin/bench msp [--ms 1500] [--seconds 20] [--requests 200]
#
# Each row of the first table is measured for so many milliseconds; polls are counted for so many seconds.

codec = Path.expand("../../mav_codec", __DIR__)
for file <- ~w(measure options), do: Code.require_file("bench/support/#{file}.ex", codec)
Code.require_file("test/support/msp_transcript.ex", codec)
for file <- ~w(yamspy os_process config msp_cable), do: Code.require_file("support/#{file}.ex", __DIR__)
for file <- ~w(line controller), do: Code.require_file("../../msp/test/support/#{file}.ex", __DIR__)

alias MavCodec.Bench.Measure
alias Aerie.Bench.Yamspy
alias Msp.Test.{Controller, Line}
alias MavCodec.Msp.Parser

options = MavCodec.Bench.Options.read(__ENV__.file, System.argv(), ms: 1500, seconds: 20, requests: 200)
milliseconds = options[:ms]
Logger.configure(level: :error)

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
    for frame <- frames, do: {:ok, _values} = MavCodec.Msp.decode(frame, target)
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

defmodule Bench.Session do
  alias MavCodec.Messages, as: M

  @second 1_000_000
  @byte_us 10 * 1_000_000 / 115_200
  @turn_us 10_000
  @from 1_000_000_000_000

  def open(line_of), do: line_of.(&took/3) |> Line.run(5 * @second)

  # The request on the line, the firmware's next turn, the reply on the line.
  defp took(request, reply, now) do
    arrived = now + round(byte_size(request) * @byte_us)
    turn = (div(arrived, @turn_us) + 1) * @turn_us
    turn - now + round(byte_size(reply) * @byte_us)
  end

  def requests(line, seconds) do
    written = fn line ->
      {length(line.written), line.written |> Enum.map(&byte_size(elem(&1, 1))) |> Enum.sum()}
    end

    {before, sent_before} = written.(line)
    heard_before = MavCodec.Msp.Parser.counters(line.session.exchange.parser).frames
    line = Line.run(line, round(seconds * @second))
    {now, sent} = written.(line)
    heard = MavCodec.Msp.Parser.counters(line.session.exchange.parser).frames
    {(now - before) / seconds, (sent - sent_before) / seconds, (heard - heard_before) / seconds}
  end

  # Times from request to value, in ms.
  def latencies(line, count) do
    read =
      MavCodec.encode(%M.ParamRequestRead{target_system: 42, param_id: "p_roll", param_index: -1},
        system: 255,
        component: 190
      )

    {_line, times} =
      Enum.reduce(1..count, {line, []}, fn n, {line, times} ->
        # At another moment of the polls each time.
        line = Line.run(%{line | told: []}, 61_003 + rem(n * 7_919, 50_000))
        asked = line.now
        line = line |> Line.handle({:mavlink, read}) |> Line.run(500_000)
        {line, for({at, _value} <- Line.told(line, M.ParamValue), do: (at + @from - asked) / 1000) ++ times}
      end)

    Enum.sort(times)
  end

  def list(line),
    do:
      Line.handle(
        line,
        {:mavlink, MavCodec.encode(%M.ParamRequestList{target_system: 42}, system: 255, component: 190)}
      )
end

gps = %{
  fix: 2,
  satellites: 12,
  lat: 473_977_420,
  lon: 85_455_940,
  altitude: 500,
  ground_speed: 1000,
  course: 900,
  dop: 120
}

battery = %{cells: 4, capacity: 1500, voltage_dv: 168, drawn: 300, current: 1234, state: 0, voltage: 1655}
channels = %{entries: List.duplicate(%{channel: 1500}, 16)}

pid =
  for {:ok, message} <- [MavCodec.Msp.Messages.fetch(:betaflight, "PID")],
      field <- message.reply,
      into: %{},
      do: {field.key, 45}

answers =
  Controller.betaflight(%{"RAW_GPS" => gps, "BATTERY_STATE" => battery, "RC" => channels, "PID" => pid})

line = Bench.Session.open(fn delay -> Line.open(answers, delay: delay) end)

IO.puts("\nA session at 115,200 baud, in simulated time; the firmware takes at most 100 requests a second\n")
{polls, sent, replies} = Bench.Session.requests(line, 30)

IO.puts(
  "polls a second                    #{Float.round(polls, 1)} (#{round(sent)} bytes a second out, #{Float.round(replies, 1)} replies)"
)

times = Bench.Session.latencies(line, 300)
at = fn share -> Float.round(Enum.at(times, round(share * (length(times) - 1))), 1) end
IO.puts("a parameter with polling on, ms   p50 #{at.(0.5)}, p99 #{at.(0.99)} of #{length(times)}")
{most, _sent, _replies} = line |> Bench.Session.list() |> Bench.Session.requests(0.25)
IO.puts("requests a second at most         #{Float.round(most, 1)} (while a list is read)")

IO.puts("\nA gateway at a pseudo terminal of 115,200 baud, in real time\n")
IO.puts(Aerie.Bench.MspCable.table(options[:seconds], options[:requests]))
