# Measures MSP: framing and decoding what a real Betaflight 4.5.5 answered, with YAMSPy on the same bytes; hostile
# bytes; and, in simulated time, a session at a line of 115,200 baud to a flight controller that takes a request in 10
# ms: how many requests it makes a second, what share of the line that is, and how long a client waits for a parameter
# meanwhile. Then the same in real time: a whole gateway at a pseudo terminal that passes bytes as fast as such a line,
# with a simulated Betaflight at its end.
#
#     bin/bench msp [--ms 1500] [--seconds 20] [--requests 200]
#
# Each row of the first table is measured for so many milliseconds; polls are counted for so many seconds.

Code.require_file("harness.exs", __DIR__)

for file <- ~w(mav_codec/test/support/msp_transcript msp/test/support/line msp/test/support/controller),
    do: Code.require_file("../../apps/#{file}.ex", __DIR__)

defmodule MspBench do
  @moduledoc "Bytes."
  alias Bench.{Python, Rounds, TelemetryMix}
  alias MavCodec.Msp.Parser

  @target {:betaflight, {1, 46}}

  def main(ms) do
    # YAMSPy knows neither version 2 over 1 nor refusals.
    replies =
      for {_, _, _, <<"$", letter, ?>, _size, id, _::binary>> = reply} <-
            MavCodec.Test.MspTranscript.read(:betaflight),
          letter == ?X or id != 255,
          do: reply

    count = length(replies)
    stream = IO.iodata_to_binary(replies)
    run = &Rounds.run(&1, count, &2, ms)

    rows = [
      run.("framing, reads of 64 bytes", fn -> push(cut(stream, 64)) end),
      run.("framing, each reply a read", fn -> push(replies) end),
      run.("framing and decoding, each reply a read", fn -> decode(replies) end),
      run.("framing, 1 % of the bytes damaged", fn -> push(cut(damaged(stream), 64)) end)
    ]

    IO.puts("#{count} replies of Betaflight 4.5.5, #{div(byte_size(stream), count)} bytes each on average\n")
    Rounds.table(rows ++ peer(Python.find("yamspy"), stream))
    IO.puts("\nns a byte of 60,000: beginnings of frames of 2,000 bytes, and random ones\n")
    hostile = :binary.copy("$X>" <> <<0, 1, 0, 2000::16-little>>, 7_500)

    for {name, bytes} <- [{"hostile", hostile}, {"random", :rand.bytes(60_000)}] do
      row = Rounds.run(name, byte_size(bytes), fn -> push(cut(bytes, 4096)) end, ms)
      IO.puts("#{String.pad_trailing(name, 8)} #{Float.round(row.best, 1)}")
    end
  end

  defp peer(nil, _stream), do: []

  defp peer(python, stream) do
    {times, _found} = Python.parse(python, "yamspy_parse.py", stream, 20)
    [Rounds.row(times, "YAMSPy, framing and decoding")]
  end

  defp cut(bytes, size), do: TelemetryMix.cut(bytes, size)
  defp push(reads), do: Enum.reduce(reads, Parser.new(), &elem(Parser.push(&2, &1), 1))

  defp decode(reads) do
    Enum.reduce(reads, Parser.new(), fn read, parser ->
      {frames, parser} = Parser.push(parser, read)
      for frame <- frames, do: {:ok, _values} = MavCodec.Msp.decode(frame, @target)
      parser
    end)
  end

  defp damaged(stream) do
    for {byte, at} <- stream |> :binary.bin_to_list() |> Enum.with_index(),
        into: <<>>,
        do: <<if(rem(at, 100) == 99, do: Bitwise.bxor(byte, 1), else: byte)>>
  end
end

defmodule MspBench.Session do
  @moduledoc "A session at a line, in simulated time."
  alias MavCodec.Messages, as: M
  alias MavCodec.Msp.Parser
  alias Msp.Test.{Controller, Line}

  @second 1_000_000
  @byte_us 10 * 1_000_000 / 115_200
  @turn_us 10_000
  @from 1_000_000_000_000

  def main do
    line = answers() |> Line.open(delay: &took/3) |> Line.run(5 * @second)

    IO.puts(
      "\nA session at 115,200 baud, in simulated time; the firmware takes at most 100 requests a second\n"
    )

    [polls, sent, replies] = requests(line, 30)
    out = "#{round(sent)} bytes a second out, #{Float.round(replies, 1)} replies"
    IO.puts("polls a second                    #{Float.round(polls, 1)} (#{out})")
    times = latencies(line, 300)
    [p50, p99] = for ms <- Bench.Sample.spread(times, [0.5, 0.99]), do: Float.round(ms, 1)
    IO.puts("a parameter with polling on, ms   p50 #{p50}, p99 #{p99} of #{length(times)}")
    [most | _rest] = line |> ask(%M.ParamRequestList{target_system: 42}) |> requests(0.25)
    IO.puts("requests a second at most         #{Float.round(most, 1)} (while a list is read)")
  end

  defp answers do
    position = %{lat: 473_977_420, lon: 85_455_940, altitude: 500}
    gps = Map.merge(position, %{fix: 2, satellites: 12, ground_speed: 1000, course: 900, dop: 120})
    battery = %{cells: 4, capacity: 1500, voltage_dv: 168, drawn: 300, current: 1234, state: 0, voltage: 1655}
    channels = %{entries: List.duplicate(%{channel: 1500}, 16)}
    {:ok, pid} = MavCodec.Msp.Messages.fetch(:betaflight, "PID")
    pid = Map.new(pid.reply, &{&1.key, 45})
    Controller.betaflight(%{"RAW_GPS" => gps, "BATTERY_STATE" => battery, "RC" => channels, "PID" => pid})
  end

  # The request on the line, the firmware's next turn, the reply on the line.
  defp took(request, reply, now) do
    arrived = now + round(byte_size(request) * @byte_us)
    turn = (div(arrived, @turn_us) + 1) * @turn_us
    turn - now + round(byte_size(reply) * @byte_us)
  end

  # Requests, bytes and replies a second.
  defp requests(line, seconds) do
    now = line |> Line.run(round(seconds * @second)) |> counted()
    Enum.zip_with(now, counted(line), &((&1 - &2) / seconds))
  end

  defp counted(line) do
    bytes = Enum.sum_by(line.written, &byte_size(elem(&1, 1)))
    [length(line.written), bytes, Parser.counters(line.session.exchange.parser).frames]
  end

  # Times from request to value, in ms.
  defp latencies(line, count) do
    read = %M.ParamRequestRead{target_system: 42, param_id: "p_roll", param_index: -1}

    {times, _line} =
      Enum.flat_map_reduce(1..count, line, fn n, line ->
        # At another moment of the polls each time.
        line = Line.run(%{line | told: []}, 61_003 + rem(n * 7_919, 50_000))
        asked = line.now
        line = line |> ask(read) |> Line.run(500_000)
        {for({at, _value} <- Line.told(line, M.ParamValue), do: (at + @from - asked) / 1000), line}
      end)

    times
  end

  defp ask(line, message),
    do: Line.handle(line, {:mavlink, MavCodec.encode(message, system: 255, component: 190)})
end

defmodule MspBench.Cable do
  @moduledoc """
  A whole gateway at a serial line (a pseudo terminal) to a simulated Betaflight, which takes a request in 10 ms.
  """
  alias Aerie.Base.Store
  alias Bench.{Gateway, OSProcess, Sample, Socket}
  alias MavCodec.Messages, as: M
  alias MavCodec.Msp.{Frame, Parser}

  @script Path.expand("support/msp_line.py", __DIR__)
  @baud 115_200
  @system 7
  @firmware_limit 100

  def main(seconds, count) do
    IO.puts("\nA gateway at a pseudo terminal of 115,200 baud, in real time\n")

    case System.find_executable("python3") do
      nil -> IO.puts("no python3: no serial line")
      python -> Gateway.in_folder("msp", &measured(python, &1, seconds, count))
    end
  end

  defp measured(python, dir, seconds, count) do
    {:ok, sim} = SimVehicle.Msp.start_link(firmware: :betaflight, uid: @system)
    args = ["-u", @script, "#{SimVehicle.Msp.port(sim)}", "#{@baud}"]
    line = Port.open({:spawn_executable, python}, [:binary, :exit_status, args: args])
    "pty " <> device = OSProcess.line(line, "pty ")
    share = OSProcess.free_port(:gen_tcp)
    url = "msp:#{device},#{@baud}?sysid=#{@system}&share=#{share}"
    off = [{"nats.mode", "off"}, {"http.enabled", false}, {"links", [%{"id" => "line", "url" => url}]}]
    gateway = make_ref()
    pid = Gateway.whole(gateway, Gateway.config(dir, off))

    Sample.until(
      fn ->
        get_in(Store.vehicle(gateway, {"main", @system}) || %{}, [:groups, :health, :data, :ready_to_arm])
      end,
      50
    )

    polls = counted(line, fn -> Process.sleep(seconds * 1_000) end)
    station = Socket.open({:tcp, Gateway.client(gateway, %{url: "tcpin:127.0.0.1:0", id: "bench"})})
    parameter = times(count, fn -> parameter(station) end)
    program = Socket.open({:tcp, share})
    request = times(count, fn -> request(program) end)
    list = counted(line, fn -> list(station) end)

    IO.puts("""
    polls a second                      #{one(polls.requests)} (#{one(polls.share)} % of the line)
    a client's parameter, ms            #{parameter}
    a program's MSP request, ms         #{request}
    requests a second while a list is read  #{one(list.requests)} (#{one(list.share)} % of the line; \
    the firmware takes #{@firmware_limit})
    """)

    Process.unlink(pid)
    Aerie.Gateway.stop(gateway)
    Port.close(line)
  end

  defp one(number), do: Sample.round(number)

  # What went over the line a second, and the share of it in the direction that has more.
  defp counted(line, fun) do
    before = said(line)
    ms = Sample.ms(fun)
    [requests, to, from] = Enum.zip_with(said(line), before, &((&1 - &2) * 1000 / ms))
    %{requests: requests, share: 100 * max(to, from) / (@baud / 10)}
  end

  defp said(line) do
    "line " <> numbers = OSProcess.ask(line, "", "line ")
    numbers |> String.split() |> Enum.map(&String.to_integer/1)
  end

  # At another moment of the polls each time.
  defp times(count, fun) do
    times = for n <- 1..count, Process.sleep(20 + rem(n * 7_919, 50)) == :ok, do: Sample.ms(fun)
    [p50, p99] = for ms <- Sample.spread(times, [0.5, 0.99]), do: one(ms)
    "p50 #{p50}, p99 #{p99} of #{count}"
  end

  defp parameter(socket) do
    tell(socket, %M.ParamRequestRead{
      target_system: @system,
      target_component: 1,
      param_id: "p_roll",
      param_index: -1
    })

    value(socket, &match?({:ok, %M.ParamValue{param_id: "p_roll"}}, MavCodec.decode(&1)))
  end

  defp list(socket) do
    tell(socket, %M.ParamRequestList{target_system: @system, target_component: 1})
    value(socket, &match?({:ok, %M.ParamValue{param_index: 1}}, MavCodec.decode(&1)))
  end

  defp tell(socket, message),
    do: :ok = :gen_tcp.send(socket, MavCodec.encode(message, system: 255, component: 190))

  defp value(socket, wanted?), do: await(socket, MavCodec.Parser, MavCodec.Parser.new(), wanted?)

  defp request(socket) do
    :ok = :gen_tcp.send(socket, Frame.encode(%Frame{id: 112}))
    await(socket, Parser, Parser.new(), &(&1.id == 112 and &1.direction == :reply))
  end

  defp await(socket, module, parser, wanted?) do
    {:ok, bytes} = :gen_tcp.recv(socket, 0, 30_000)
    {frames, parser} = module.push(parser, bytes)
    if Enum.any?(frames, wanted?), do: :ok, else: await(socket, module, parser, wanted?)
  end
end

options = Bench.Options.read(__ENV__.file, ms: 1500, seconds: 20, requests: 200)
MspBench.main(options[:ms])
MspBench.Session.main()
MspBench.Cable.main(options[:seconds], options[:requests])
