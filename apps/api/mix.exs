Code.require_file("../../packages/packages.exs", __DIR__)

defmodule Aerie.Api.MixProject do
  use Mix.Project

  def project do
    [
      app: :api,
      version: "0.1.0",
      build_path: "../../_build",
      config_path: "../../config/config.exs",
      deps_path: "../../deps",
      lockfile: "../../mix.lock",
      elixir: "~> 1.20",
      elixirc_paths: elixirc_paths(Mix.env()),
      # What the tests are made of is not what they test.
      test_coverage: [summary: [threshold: 85], ignore_modules: [~r/Case$/, Aerie.WSClient]],
      deps: deps()
    ]
  end

  def application do
    [extra_applications: [:logger, :cowboy] ++ test_applications(Mix.env())]
  end

  defp test_applications(:test), do: [:inets]
  defp test_applications(_env), do: []

  defp elixirc_paths(:test), do: ["lib", "test/support"]
  defp elixirc_paths(_env), do: ["lib"]

  defp deps,
    do:
      [
        {:mav_codec, in_umbrella: true},
        {:base, in_umbrella: true},
        {:mav_router, in_umbrella: true},
        {:vehicle, in_umbrella: true},
        {:control, in_umbrella: true},
        {:fleet, in_umbrella: true},
        {:access, in_umbrella: true}
      ] ++ Aerie.Packages.deps([:telemetry])
end
