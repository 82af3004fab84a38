defmodule Nkey.MixProject do
  use Mix.Project

  def project do
    [
      app: :nkey,
      version: "1.0.0",
      elixir: "~> 1.20",
      test_coverage: [summary: [threshold: 85]],
      deps: []
    ]
  end

  def application do
    [extra_applications: [:crypto] ++ test_applications(Mix.env())]
  end

  # PropEr is Debian's, not a dependency that Mix knows; naming it keeps it on the code path of the tests.
  defp test_applications(:test), do: [:proper]
  defp test_applications(_env), do: []
end
