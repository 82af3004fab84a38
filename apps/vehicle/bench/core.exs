# What a frame costs in the pure core of a vehicle's session (Aerie.Vehicle.Core), its processes, links and store left out.
#
#     mix run bench/core.exs [--frames 20000] [--rates 10,50,200]          or  bin/bench core
#
# One vehicle sends the usual telemetry, 33 messages of common and ardupilotmega at their usual shares, each frame in a read of its own,
# and the core's clock ticks ten times a second as the session's does. Prints a table in Markdown, for each number of frames a second:
# µs and reductions per frame, of which so many are the tick's, and how many actions of which kind come of a thousand frames.

Code.require_file("../../mav_codec/bench/support/options.ex", __DIR__)
Code.require_file("../../mav_codec/bench/support/flight_messages.ex", __DIR__)
Code.require_file("../../mav_codec/bench/support/telemetry_mix.ex", __DIR__)

defmodule CoreBench do
  alias Aerie.Vehicle.{Core, Options, Settings}
  alias MavCodec.Bench.TelemetryMix

  @tick_us 100_000
  @rounds 5

  def main(argv) do
    options = MavCodec.Bench.Options.read(__ENV__.file, argv, frames: 20_000, rates: "10,50,200")

    IO.puts(
      "| frames/s | µs a frame | of them ticks | reductions a frame | of them ticks | actions of 1,000 frames |"
    )

    IO.puts("|---|---|---|---|---|---|")
    for rate <- String.split(options[:rates], ","), do: row(String.to_integer(rate), options[:frames])
  end

  defp row(rate, count) do
    events = events(rate, count)
    core = Enum.reduce(events, new(), &elem(Core.handle(&2, &1), 0))
    # Once more in the vehicle's later life: it is known by now.
    later = for event <- events, do: later(event, div(count * 1_000_000, rate) + @tick_us)
    measured = for _round <- 1..@rounds, do: isolated(fn -> run(later, core) end)
    {ns, reductions, ticks_ns, ticks_reductions, actions} = Enum.min(measured)
    per = &Float.round(&1 / count, 1)
    kinds = for {kind, n} <- Enum.sort_by(actions, &(-elem(&1, 1))), do: "#{kind} #{round(n * 1_000 / count)}"

    cells = [
      rate,
      per.(ns / 1_000),
      per.(ticks_ns / 1_000),
      per.(reductions),
      per.(ticks_reductions),
      Enum.join(kinds, ", ")
    ]

    IO.puts("| " <> Enum.join(cells, " | ") <> " |")
  end

  defp run(events, core) do
    actions =
      Enum.reduce(events, {core, %{}}, fn event, {core, kinds} ->
        {core, actions} = Core.handle(core, event)
        {core, Enum.reduce(actions, kinds, &count/2)}
      end)
      |> elem(1)

    {ns, reductions} = spent(events, core)
    # The ticks alone take what all events take less what the frames take without them.
    {frames_ns, frames_reductions} = spent(Enum.filter(events, &match?({:frames, _link, _frames}, &1)), core)
    {ns, reductions, max(ns - frames_ns, 0), max(reductions - frames_reductions, 0), actions}
  end

  defp count(action, kinds) do
    kind = if is_tuple(action), do: elem(action, 0), else: action
    Map.update(kinds, kind, 1, &(&1 + 1))
  end

  defp spent(events, core) do
    {:reductions, before} = Process.info(self(), :reductions)
    from = System.monotonic_time(:nanosecond)
    Enum.reduce(events, core, fn event, core -> elem(Core.handle(core, event), 0) end)
    to = System.monotonic_time(:nanosecond)
    {:reductions, now} = Process.info(self(), :reductions)
    {to - from, now - before}
  end

  defp isolated(fun), do: fun |> Task.async() |> Task.await(:infinity)

  defp new, do: %{} |> Settings.from() |> Options.new({"net", 1}) |> Core.new()

  defp events(rate, count) do
    bytes =
      (count * 4)
      |> TelemetryMix.messages()
      |> Enum.filter(&(elem(&1, 0) == 1))
      |> Enum.take(count)
      |> TelemetryMix.frames()

    {events, _parser} =
      bytes
      |> Enum.with_index()
      |> Enum.flat_map_reduce(MavCodec.Parser.new(), fn {bytes, n}, parser ->
        at = div(n * 1_000_000, rate)
        {frames, parser} = MavCodec.Parser.push(parser, bytes, at)
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

CoreBench.main(System.argv())
