Code.require_file("../../packages/packages.exs", __DIR__)

defmodule Aerie.Console.MixProject do
  use Mix.Project

  def project do
    [
      app: :console,
      version: "0.1.0",
      build_path: "../../_build",
      config_path: "../../config/config.exs",
      deps_path: "../../deps",
      lockfile: "../../mix.lock",
      elixir: "~> 1.20",
      elixirc_paths: elixirc_paths(Mix.env()),
      # What the tests are made of is not what they test.
      test_coverage: [summary: [threshold: 85], ignore_modules: [~r/Case$/, Aerie.Browser]],
      deps: deps()
    ]
  end

  def application do
    [extra_applications: [:logger, :cowboy] ++ test_applications(Mix.env())]
  end

  # PropEr is Debian's, not a dependency that Mix knows; naming it keeps it on the code path of the tests.
  defp test_applications(:test), do: [:proper, :inets]
  defp test_applications(_env), do: []

  defp elixirc_paths(:test), do: ["lib", "test/support", Path.expand("../../test/browser", __DIR__)]
  defp elixirc_paths(_env), do: ["lib"]

  defp deps,
    do:
      [
        {:mav_codec, in_umbrella: true},
        {:base, in_umbrella: true},
        {:mav_router, in_umbrella: true},
        {:vehicle, in_umbrella: true},
        {:protocols, in_umbrella: true},
        {:control, in_umbrella: true},
        {:fleet, in_umbrella: true},
        {:access, in_umbrella: true},
        # The HTTP server, on which the tests try the pages.
        {:api, in_umbrella: true, only: :test}
      ] ++ Aerie.Packages.deps([:telemetry, :phoenix_live_view])
end
