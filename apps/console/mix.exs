Code.require_file("../project.exs", __DIR__)

defmodule Aerie.Console.MixProject do
  use Mix.Project

  def project do
    Aerie.Project.of(:console,
      support: ["test/support", Path.expand("../../test/browser", __DIR__)],
      test_coverage: [summary: [threshold: 85], ignore_modules: [~r/Case$/, Aerie.Browser]],
      deps:
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
    )
  end

  def application,
    do: Aerie.Project.application([:logger, :cowboy, :crypto, :ssl, :public_key], [:proper, :inets])
end
