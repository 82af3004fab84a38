Code.require_file("../../test_kit/bench/support/options.ex", __DIR__)

defmodule Aerie.Gate.BenchTest do
  use ExUnit.Case, async: true

  alias Bench.Options

  @defaults [seconds: :integer, rate: 50, clients: "1,5", quick: false]

  test "options have their defaults and their types" do
    assert Options.parse([], @defaults) == {:ok, rate: 50, clients: "1,5", quick: false}
    assert {:ok, options} = Options.parse(~w(--seconds 4 --clients 20 --quick), @defaults)
    assert Enum.sort(options) == [clients: "20", quick: true, rate: 50, seconds: 4]
    assert Options.parse([], []) == {:ok, []}
  end

  test "--help, and whatever is unknown is refused with the list" do
    for help <- ["--help", "-h"], do: assert(Options.parse([help], @defaults) == :help)

    for {argv, about} <- [
          {~w(--speed 7), "--speed is unknown"},
          {~w(--rate fast), "--rate cannot be fast"},
          {~w(--rate), "--rate is unknown or lacks its value"},
          {~w(5), "5 is not an option"}
        ] do
      assert {:error, text} = Options.parse(argv, @defaults)
      assert text =~ about
      assert text =~ "--seconds N, --rate N, --clients TEXT, --quick, --help"
    end
  end

  # Whoever adds a benchmark reads its options here.
  test "every benchmark reads its options so" do
    benches =
      Path.wildcard(Path.expand("../../test_kit/bench/*.exs", __DIR__))
      |> Enum.reject(&(&1 =~ "/harness.exs"))

    assert length(benches) >= 9

    for file <- benches,
        do: assert({file, File.read!(file) =~ "Bench.Options.read(__ENV__.file"} == {file, true})
  end

  @ours ~w(Aerie MavCodec MavRouter Msp Protocols SimVehicle)a

  # Nothing compiles them but a run.
  test "no benchmark calls a function or reads a file that has gone" do
    for file <- Path.wildcard(Path.expand("../../test_kit/bench/**/*.{ex,exs}", __DIR__)),
        text = File.read!(file) do
      ast = Code.string_to_quoted!(text)
      aliases = ast |> found(&aliases/1) |> Map.new()

      for {[first | rest], function} <- found(ast, &call/1),
          [top | _] = parts <- [Map.get(aliases, first, [first]) ++ rest],
          top in @ours,
          module = Module.concat(parts),
          do:
            assert(
              Code.ensure_loaded?(module) and function in Keyword.keys(module.module_info(:exports)),
              "#{file}: #{inspect(module)}.#{function}"
            )

      for [_all, path] <- Regex.scan(~r/require_file\("(\.\.[^"#]+)"/, text),
          do: assert(File.exists?(Path.expand(path, Path.dirname(file))), "#{file}: #{path}")
    end
  end

  defp found(ast, fun), do: ast |> Macro.prewalker() |> Enum.flat_map(fun)

  defp aliases({:alias, _, [{:__aliases__, _, parts}, [as: {:__aliases__, _, [name]}]]}), do: [{name, parts}]
  defp aliases({:alias, _, [{:__aliases__, _, parts} | _]}), do: [{List.last(parts), parts}]

  defp aliases({:alias, _, [{{:., _, [{:__aliases__, _, parts}, :{}]}, _, names}]}),
    do: for({:__aliases__, _, more} <- names, do: {List.last(more), parts ++ more})

  defp aliases(_other), do: []

  defp call({{:., _, [{:__aliases__, _, parts}, function]}, _, args})
       when is_list(args) and function not in [:{}, :t],
       do: [{parts, function}]

  defp call(_other), do: []
end
