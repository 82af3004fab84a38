Code.require_file("../../test_kit/bench/support/options.ex", __DIR__)

defmodule Aerie.Gate.BenchOptionsTest do
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
end
