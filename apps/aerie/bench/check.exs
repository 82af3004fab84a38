# Compares what the main paths cost with the figures that the repository keeps, and ends with status 1 if one of them costs more than
# 20 % more. For a developer at a quiet machine, before a change lands: not a test.
#
#     bin/bench --check [--only core,codec] [--save]
#
# Machines differ, so figures are ratios: a figure of a benchmark divided by the time that a fixed piece of Elixir takes in the same minute. One that
# looks worse is measured again, and the better of both counts. --save writes the new figures into bench/figures.json, to be committed with the change that
# explains them.

Code.require_file("../../mav_codec/bench/support/options.ex", __DIR__)
Code.require_file("support/reference.ex", __DIR__)

defmodule CheckBench do
  @moduledoc false
  alias Aerie.Bench.Reference

  @loss 0.2
  @file_name Path.join(__DIR__, "figures.json")
  @bench Path.expand("../../../bin/bench", __DIR__)
  @number "([\\d,]+(?:\\.\\d+)?)"

  # Each benchmark, its options, and where its output has which figure.
  @benches [
    {"codec", ~w(--ms 1000),
     [
       {"codec: decode MAVLink 2, ns a frame", ~r/^MAVLink 2 +#{@number} /m},
       {"codec: decode MAVLink 1, ns a frame", ~r/^MAVLink 1 +#{@number} /m},
       {"codec: signed and verified, ns a frame", ~r/^signed, verified +#{@number} /m},
       {"codec: 1 % damaged, ns a frame", ~r/^1 % damaged +#{@number} /m},
       {"codec: encode, ns a frame", ~r/^encode +#{@number} /m}
     ]},
    {"core", [],
     for(rate <- [10, 50, 200], do: {"core: #{rate} frames/s, us a frame", ~r/^\| #{rate} \| #{@number} \|/m})},
    {"hub", ~w(--vehicles 200 --fakes 0 --seconds 6),
     [{"hub: 200 vehicles x 50/s, us a frame", ~r/^\| 200 +\|(?:[^|]*\|){6} #{@number} /m}]},
    {"console", ~w(--vehicles 50 --viewers 20 --seconds 8),
     [{"console: 50 vehicles x 20 viewers, % of a core", ~r/^\| 50 \| 20 \| [\d.]+ \| #{@number} \|/m}]}
  ]

  def main(argv) do
    options = MavCodec.Bench.Options.read(__ENV__.file, argv, only: "", save: false)
    only = String.split(options[:only], ",", trim: true)
    benches = for {name, _options, _figures} = bench <- @benches, only == [] or name in only, do: bench
    kept = kept()
    IO.puts("| figure | measured | ratio | kept | change |\n|---|---|---|---|---|")
    found = Enum.flat_map(benches, &bench(&1, kept))

    if options[:save],
      do:
        save(Map.merge(kept, Map.new(found, fn {name, ratio, _worse?} -> {name, Float.round(ratio, 4)} end)))

    worse = for {name, _ratio, true} <- found, do: name

    if worse != [] and not options[:save] do
      IO.puts("\nmore than #{round(@loss * 100)} % worse: #{Enum.join(worse, "; ")}")
      System.halt(1)
    end
  end

  defp bench({name, options, figures}, kept) do
    first = measure(name, options, figures)
    again? = Enum.any?(figures, fn {figure, _pattern} -> worse?(first[figure], kept[figure]) end)
    second = if again?, do: measure(name, options, figures), else: first

    for {figure, _pattern} <- figures do
      {number, ratio} = Enum.min_by([first[figure], second[figure]], &elem(&1, 1))
      row([figure, number, Float.round(ratio, 4), kept[figure] || "new", change(ratio, kept[figure])])
      {figure, ratio, worse?({number, ratio}, kept[figure])}
    end
  end

  # The reference before and after, because machines change their pace.
  defp measure(name, options, figures) do
    before = Reference.us()
    {output, status} = System.cmd(@bench, [name | options], env: clean(), stderr_to_stdout: true)
    if status != 0, do: raise("bin/bench #{name} ended with status #{status}:\n#{output}")
    reference = (before + Reference.us()) / 2

    for {figure, pattern} <- figures, into: %{} do
      [_all, text] =
        Regex.run(pattern, output) || raise("bin/bench #{name} did not print #{inspect(figure)}:\n#{output}")

      {number, ""} = text |> String.replace(",", "") |> Float.parse()
      {figure, {number, number / reference}}
    end
  end

  # As from a plain shell.
  defp clean, do: for(name <- ~w(MIX_ENV MIX_BUILD_PATH AERIE_CODE ERL_AFLAGS), do: {name, nil})

  defp worse?(_found, nil), do: false
  defp worse?({_number, ratio}, kept), do: ratio > kept * (1 + @loss)

  defp change(_ratio, nil), do: "–"
  defp change(ratio, kept), do: "#{round((ratio / kept - 1) * 100)} %"

  defp kept do
    case File.read(@file_name) do
      {:ok, text} -> JSON.decode!(text)
      {:error, :enoent} -> %{}
    end
  end

  defp save(figures) do
    lines = for {name, ratio} <- Enum.sort(figures), do: "  #{JSON.encode!(name)}: #{ratio}"
    File.write!(@file_name, "{\n#{Enum.join(lines, ",\n")}\n}\n")
  end

  defp row(cells), do: IO.puts("| " <> Enum.map_join(cells, " | ", &to_string/1) <> " |")
end

CheckBench.main(System.argv())
