# Measures the codec: parsing, decoding and encoding a mix of telemetry, and hostile bytes.
#
#     bin/bench codec [--ms 1500]
#
# Each row is measured for so many milliseconds, a hostile one for a third of that.

Code.require_file("harness.exs", __DIR__)
Code.require_file("../../apps/mav_codec/test/support/hostile.ex", __DIR__)

defmodule CodecBench do
  alias Bench.{Python, Rounds, Table, TelemetryMix}
  alias MavCodec.{CRC, Parser, Signing}
  alias MavCodec.Dialects.Ardupilot.Ardupilotmega

  # Of each stream, and of the file that is pushed at once: 8 MB.
  @count 20_000
  @many 200_000
  @read 4096
  @datagram 65_507

  def main(ms) do
    frames = @count |> TelemetryMix.messages() |> TelemetryMix.frames()
    parser = Parser.new(dialects: [Ardupilotmega])
    average = Float.round(IO.iodata_length(frames) / @count, 1)

    IO.puts(
      "33 messages of three vehicles, #{average} bytes a frame on average, reads of #{@read} bytes, one core"
    )

    architecture = :erlang.system_info(:system_architecture)
    IO.puts("Erlang/OTP #{System.otp_release()}, Elixir #{System.version()}, #{architecture}")
    {damaged, whole} = TelemetryMix.damage(frames)
    python = Python.find("pymavlink")

    IO.puts("\nBytes to message structs, every CRC checked\n")
    structs(frames, damaged, length(whole), parser, python, ms)
    IO.puts("\nParts of it, MAVLink 2\n")
    parts(Enum.take(frames, 2000), parser, ms)
    IO.puts("\nUndamaged frames found in the damaged stream\n")
    found(damaged, Enum.take(whole, 5000), parser, python)
    IO.puts("\nHostile bytes, one datagram of 65,507\n")
    hostile(parser, div(ms, 3))
  end

  defp structs(frames, damaged, whole, parser, python, ms) do
    messages = TelemetryMix.messages(@count)
    v1_frames = TelemetryMix.frames(messages, 1)
    [v2, v1] = Enum.map([frames, v1_frames], &IO.iodata_to_binary/1)
    file = @many |> TelemetryMix.messages() |> TelemetryMix.frames() |> IO.iodata_to_binary()
    {signed, key} = signed(messages)
    run = &Rounds.run(&1, &2, &3, ms)

    rows = [
      run.("MAVLink 2", @count, fn -> full(cut(v2), parser) end),
      run.("MAVLink 1", length(v1_frames), fn -> full(cut(v1), parser) end),
      run.("signed, verified", @count, fn -> verified(cut(signed), parser, Signing.new(key)) end),
      run.("1 % damaged", whole, fn -> full(cut(damaged), parser) end),
      run.("MAVLink 2, 8 MB in reads", @many, fn -> full(cut(file), parser) end),
      run.("MAVLink 2, 8 MB in one reduce", @many, fn -> whole(file, parser) end),
      run.("MAVLink 2, 8 MB in one push", @many, fn -> full([file], parser) end)
    ]

    peers =
      for {name, data} <- [{"MAVLink 2", v2}, {"MAVLink 1", v1}, {"1 % damaged", damaged}], python != nil do
        {times, _found} = pymavlink(python, data, 400_000, 3)
        Rounds.row(times, "#{name}, pymavlink")
      end

    Rounds.table(rows ++ peers)
    if python == nil, do: IO.puts("pymavlink is not there (set AERIE_VENV to a venv that has it): left out")
  end

  defp signed(messages) do
    key = Signing.key("a key for the benchmark")
    {messages |> TelemetryMix.signed(key) |> IO.iodata_to_binary(), key}
  end

  defp pymavlink(python, data, most, rounds),
    do: Python.parse(python, "pymavlink_parse.py", binary_part(data, 0, min(byte_size(data), most)), rounds)

  defp parts(first, parser, ms) do
    reads = cut(IO.iodata_to_binary(first))
    {parsed, _} = Parser.push(parser, IO.iodata_to_binary(first))
    ^first = Enum.map(parsed, & &1.bytes)
    messages = TelemetryMix.messages(2000)
    {signed, key} = signed(messages)
    {parsed_signed, _} = Parser.push(parser, binary_part(signed, 0, 100_000))
    run = &Rounds.run(&1, &2, &3, ms)

    Rounds.table([
      run.("CRC only", 2000, fn -> Enum.each(first, &CRC.frame(&1, byte_size(&1) - 3, 50)) end),
      run.("framing and CRC (push)", 2000, fn -> push(reads, parser) end),
      run.("the same, a datagram each", 2000, fn -> datagrams(first, parser) end),
      run.("decode of parsed frames", 2000, fn -> decode(parsed) end),
      run.("check of signatures", length(parsed_signed), fn -> check(parsed_signed, Signing.new(key)) end),
      run.("encode", 2000, fn -> Enum.reduce(messages, 0, &encode/2) end)
    ])
  end

  defp found(damaged, wanted, parser, python) do
    {found, broken} = Parser.push(parser, damaged)
    {rest, _} = Parser.flush(broken)
    IO.puts("ours: #{share(found ++ rest, wanted)} %")

    if python do
      {_times, bytes} = pymavlink(python, damaged, 300_000, 1)
      {theirs, _} = Parser.push(parser, bytes)
      IO.puts("pymavlink: #{share(theirs, wanted)} %")
    end
  end

  defp share(found, wanted) do
    found = MapSet.new(found, & &1.bytes)
    Float.round(100 * Enum.count(wanted, &MapSet.member?(found, &1)) / length(wanted), 2)
  end

  defp hostile(parser, ms) do
    :rand.seed(:exsss, {3, 5, 7})

    # What rows with frames in them have to be compared with.
    valid =
      for message <- [%MavCodec.Messages.SystemTime{}, %MavCodec.Messages.Heartbeat{type: 2}] do
        frame = MavCodec.encode(message, system: 1)

        {"valid frames of #{byte_size(frame)} bytes",
         :binary.copy(frame, div(@datagram, byte_size(frame)) + 1)}
      end

    widths = [42, 14, 16, 14, 14, 8]
    Table.columns(["", "best ns/byte", "median ns/byte", "p99 ns/byte", "times random", "frames"], widths)

    rows =
      for {name, data} <-
            [{"random bytes", :rand.bytes(@datagram)} | valid] ++ MavCodec.Test.Hostile.all(@datagram) do
        data = binary_part(data, 0, @datagram)
        {frames, _} = Parser.push_datagram(parser, data)
        {Rounds.run(name, @datagram, fn -> Parser.push_datagram(parser, data) end, ms), length(frames)}
      end

    {%{best: random}, _} = hd(rows)

    for {row, frames} <- rows do
      numbers = for n <- [row.best, row.median, row.p99, row.best / random], do: Float.round(n * 1.0, 1)
      Table.columns([row.name | numbers] ++ [frames], widths)
    end
  end

  ## The work of each row. It keeps nothing but the last result.

  defp cut(data), do: TelemetryMix.cut(data, @read)
  defp push(reads, parser), do: Enum.reduce(reads, parser, &elem(Parser.push(&2, &1), 1))
  defp datagrams(reads, parser), do: Enum.reduce(reads, parser, &elem(Parser.push_datagram(&2, &1), 1))

  defp full(reads, parser) do
    Enum.reduce(reads, parser, fn read, parser ->
      {frames, parser} = Parser.push(parser, read)
      decode(frames)
      parser
    end)
  end

  defp whole(file, parser), do: Parser.reduce(parser, file, :ok, fn frame, :ok -> decode([frame]) end)

  defp verified(reads, parser, signing) do
    Enum.reduce(reads, {parser, signing}, fn read, {parser, signing} ->
      {frames, parser} = Parser.push(parser, read)
      signing = check(frames, signing)
      decode(frames)
      {parser, signing}
    end)
  end

  # An unknown id is noise of a damaged stream.
  defp decode(frames), do: Enum.each(frames, &MavCodec.decode(&1, Ardupilotmega))

  defp check(frames, signing) do
    Enum.reduce(frames, signing, fn frame, signing ->
      {:signed, signing} = Signing.check(signing, frame)
      signing
    end)
  end

  defp encode({system, message}, seq) do
    _bytes = MavCodec.encode(message, system: system, component: 1, seq: rem(seq, 256))
    seq + 1
  end
end

CodecBench.main(Bench.Options.read(__ENV__.file, ms: 1500)[:ms])
