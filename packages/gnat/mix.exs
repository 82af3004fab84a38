Code.require_file("../packages.exs", __DIR__)

defmodule Gnat.MixProject do
  use Mix.Project

  def project do
    [
      app: :gnat,
      version: "1.16.0",
      elixir: "~> 1.20",
      elixirc_paths: elixirc_paths(Mix.env()),
      test_coverage: [summary: [threshold: 85]],
      deps: Aerie.Packages.deps([:telemetry, :nkey])
    ]
  end

  def application do
    [extra_applications: [:logger, :crypto, :ssl] ++ test_applications(Mix.env())]
  end

  # PropEr is Debian's, not a dependency that Mix knows; naming it keeps it on the code path of the tests.
  defp test_applications(:test), do: [:proper]
  defp test_applications(_env), do: []

  defp elixirc_paths(:test), do: ["lib", "test/support"]
  defp elixirc_paths(_env), do: ["lib"]
end
