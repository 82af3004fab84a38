# What a frame costs in the pure core of a vehicle's session (Aerie.Vehicle.Session.Core), its processes, links and
# store left out.
#
#     bin/bench core [--frames 20000] [--rates 10,50,200]
#
# One vehicle sends the usual telemetry, 33 messages of common and ardupilotmega at their usual shares, each frame in a
# read of its own, and the core's clock ticks ten times a second as the session's does. Prints a table in Markdown, for
# each number of frames a second: µs and reductions per frame, of which so many are the tick's, and how many actions of
# which kind come of a thousand frames.

Code.require_file("harness.exs", __DIR__)

defmodule CoreBench do
  alias Aerie.Vehicle.{Options, Settings}
  alias Aerie.Vehicle.Session.Core
  alias Bench.{Sample, Table, TelemetryMix}

  @tick_us 100_000
  @rounds 5

  def main(options) do
    Table.head([
      "frames/s",
      "µs a frame",
      "of them ticks",
      "reductions a frame",
      "of them ticks",
      "actions of 1,000 frames"
    ])

    for rate <- Bench.Options.numbers(options[:rates]), do: row(rate, options[:frames])
  end

  defp row(rate, count) do
    events = events(rate, count)
    core = run(events, %{} |> Settings.from() |> Options.new({"net", 1}) |> Core.new())
    # Once more in the vehicle's later life: it is known by now.
    later = for event <- events, do: later(event, div(count * 1_000_000, rate) + @tick_us)
    # The ticks alone take what all events take less what the frames take without them.
    frames = Enum.filter(later, &match?({:frames, _link, _frames}, &1))
    measured = for _round <- 1..@rounds, do: {spent(later, core), spent(frames, core)}
    {{us, reductions}, {frames_us, frames_reductions}} = Enum.min(measured)
    per = &Float.round(&1 / count, 1)

    actions =
      for {kind, n} <- Enum.sort_by(actions(later, core), &(-elem(&1, 1))),
          do: "#{kind} #{round(n * 1_000 / count)}"

    of_ticks = [max(us - frames_us, 0), max(reductions - frames_reductions, 0)]
    [us, ticks_us, reductions, ticks] = Enum.map([us, hd(of_ticks), reductions, List.last(of_ticks)], per)
    Table.row([rate, us, ticks_us, reductions, ticks, Enum.join(actions, ", ")])
  end

  defp run(events, core), do: Enum.reduce(events, core, &elem(Core.handle(&2, &1), 0))

  defp spent(events, core) do
    task = Task.async(fn -> Sample.cost(fn -> run(events, core) && :ok end) end)
    {us, reductions, :ok} = Task.await(task, :infinity)
    {us, reductions}
  end

  defp actions(events, core) do
    {actions, _core} =
      Enum.flat_map_reduce(events, core, fn event, core -> core |> Core.handle(event) |> swap() end)

    Enum.frequencies_by(actions, &if(is_tuple(&1), do: elem(&1, 0), else: &1))
  end

  defp swap({core, actions}), do: {actions, core}

  defp events(rate, count) do
    messages = for {1, _message} = message <- TelemetryMix.messages(count * 4), do: message

    {events, _parser} =
      messages
      |> Enum.take(count)
      |> TelemetryMix.frames()
      |> Enum.with_index()
      |> Enum.flat_map_reduce(MavCodec.Parser.new(), fn {bytes, n}, parser ->
        {frames, parser} = MavCodec.Parser.push(parser, bytes, div(n * 1_000_000, rate))
        {[{:frames, "link", frames}], parser}
      end)

    ticks = for n <- 1..max(div(count * 1_000_000, rate * @tick_us), 1), do: {:tick, n * @tick_us}
    Enum.sort_by(events ++ ticks, &at/1)
  end

  defp at({:frames, _link, [frame | _]}), do: frame.at
  defp at({:tick, now}), do: now

  defp later({:tick, now}, by), do: {:tick, now + by}

  defp later({:frames, link, frames}, by),
    do: {:frames, link, for(frame <- frames, do: %{frame | at: frame.at + by})}
end

CoreBench.main(Bench.Options.read(__ENV__.file, frames: 20_000, rates: "10,50,200"))
