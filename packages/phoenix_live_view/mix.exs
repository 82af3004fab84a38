defmodule PhoenixLiveView.MixProject do
  use Mix.Project

  def project do
    [
      app: :phoenix_live_view,
      version: "1.2.12",
      elixir: "~> 1.20",
      elixirc_paths: elixirc_paths(Mix.env()),
      test_coverage: [summary: [threshold: 85]]
    ]
  end

  def application do
    [extra_applications: [:logger, :crypto, :cowboy] ++ test_applications(Mix.env())]
  end

  # PropEr is Debian's, not a dependency that Mix knows; naming it keeps it on the code path of the tests.
  defp test_applications(:test), do: [:proper]
  defp test_applications(_env), do: []

  defp elixirc_paths(:test), do: ["lib", "test/support", Path.expand("../../test/browser", __DIR__)]
  defp elixirc_paths(_env), do: ["lib"]
end
