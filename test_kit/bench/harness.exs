# What benchmarks share: options, samples, tables, gateways, loads, peers. A benchmark is one file of numbers that
# begins with
#
#     Code.require_file("harness.exs", __DIR__)
#     options = Bench.Options.read(__ENV__.file, seconds: 3)

{:ok, _modules, _diagnostics} =
  __DIR__
  |> Path.join("support/*.ex")
  |> Path.wildcard()
  |> Kernel.ParallelCompiler.require(return_diagnostics: true)

Logger.configure(level: :none)
