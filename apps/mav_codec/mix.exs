defmodule MavCodec.MixProject do
  use Mix.Project

  def project do
    [
      app: :mav_codec,
      version: "0.1.0",
      build_path: "../../_build",
      config_path: "../../config/config.exs",
      deps_path: "../../deps",
      lockfile: "../../mix.lock",
      elixir: "~> 1.20",
      elixirc_paths: elixirc_paths(Mix.env()),
      test_coverage: [summary: [threshold: 85]],
      deps: deps()
    ]
  end

  def application do
    [extra_applications: [:crypto, :xmerl] ++ test_applications(Mix.env())]
  end

  # PropEr is Debian's, not a dependency that Mix knows; naming it keeps it on the code path of the tests.
  defp test_applications(:test), do: [:proper]
  defp test_applications(_env), do: []

  defp elixirc_paths(:test), do: ["lib", "test/support"]
  defp elixirc_paths(_env), do: ["lib"]

  defp deps, do: []
end
