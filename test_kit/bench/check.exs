# Compares what the main paths cost with the figures that the repository keeps, and ends with status 1 if one of them
# costs more than 20 % more. For a developer at a quiet machine, before a change lands: not a test.
#
#     bin/bench --check [--only core,codec] [--save]
#
# Machines differ, so figures are ratios: a figure of a benchmark divided by the time that a fixed piece of Elixir
# takes in the same minute, or one that is a ratio already (`:plain`). One that looks worse is measured again, and the
# better of both counts. --save writes the new figures into figures.json, to be committed with the change that explains
# them.

Code.require_file("harness.exs", __DIR__)

defmodule CheckBench do
  alias Bench.{Reference, Table}

  @loss 0.2
  @file_name Path.join(__DIR__, "figures.json")
  @bench Path.expand("../../bin/bench", __DIR__)
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
    {"overload", ~w(--times 1,5 --loops 0 --seconds 6),
     [
       {"overload: frames received before it, of 100 in it",
        {:plain, ~r/^received at one time, .*: #{@number}$/m}}
     ]},
    {"console", ~w(--vehicles 50 --viewers 20 --seconds 8),
     [{"console: 50 vehicles x 20 viewers, % of a core", ~r/^\| 50 \| 20 \| [\d.]+ \| #{@number} \|/m}]}
  ]

  def main(options) do
    only = String.split(options[:only], ",", trim: true)
    kept = if File.exists?(@file_name), do: JSON.decode!(File.read!(@file_name)), else: %{}
    Table.head(["figure", "measured", "ratio", "kept", "change"])

    found =
      for {name, _options, _figures} = bench <- @benches,
          only == [] or name in only,
          found <- bench(bench, kept),
          do: found

    if options[:save] do
      save(Map.merge(kept, Map.new(found, fn {name, ratio, _worse?} -> {name, Float.round(ratio, 4)} end)))
    else
      worse = for {name, _ratio, true} <- found, do: name
      if worse != [], do: refuse(worse)
    end
  end

  defp refuse(worse) do
    IO.puts("\nmore than #{round(@loss * 100)} % worse: #{Enum.join(worse, "; ")}")
    System.halt(1)
  end

  defp bench({name, options, figures}, kept) do
    first = measure(name, options, figures)
    again? = Enum.any?(figures, fn {figure, _pattern} -> worse?(first[figure], kept[figure]) end)
    second = if again?, do: measure(name, options, figures), else: first

    for {figure, _pattern} <- figures do
      {number, ratio} = Enum.min_by([first[figure], second[figure]], &elem(&1, 1))
      change = if kept[figure], do: "#{round((ratio / kept[figure] - 1) * 100)} %"
      Table.row([figure, number, Float.round(ratio, 4), kept[figure] || "new", change])
      {figure, ratio, worse?({number, ratio}, kept[figure])}
    end
  end

  # The reference before and after, because machines change their pace.
  defp measure(name, options, figures) do
    before = Reference.us()
    # As from a plain shell.
    env = for name <- ~w(MIX_ENV MIX_BUILD_PATH AERIE_CODE), do: {name, nil}
    {output, status} = System.cmd(@bench, [name | options], env: env, stderr_to_stdout: true)
    if status != 0, do: raise("bin/bench #{name} ended with status #{status}:\n#{output}")
    reference = (before + Reference.us()) / 2

    for {figure, pattern} <- figures, into: %{} do
      {pattern, of} =
        with {:plain, pattern} <- pattern, do: {pattern, 1}, else: (pattern -> {pattern, reference})

      [_all, text] =
        Regex.run(pattern, output) || raise("bin/bench #{name} did not print #{inspect(figure)}:\n#{output}")

      {number, ""} = text |> String.replace(",", "") |> Float.parse()
      {figure, {number, number / of}}
    end
  end

  defp worse?(_found, nil), do: false
  defp worse?({_number, ratio}, kept), do: ratio > kept * (1 + @loss)

  defp save(figures) do
    lines = for {name, ratio} <- Enum.sort(figures), do: "  #{JSON.encode!(name)}: #{ratio}"
    File.write!(@file_name, "{\n#{Enum.join(lines, ",\n")}\n}\n")
  end
end

CheckBench.main(Bench.Options.read(__ENV__.file, only: "", save: false))
