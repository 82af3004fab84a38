Code.require_file("../project.exs", __DIR__)

defmodule Aerie.Api.MixProject do
  use Mix.Project

  def project do
    Aerie.Project.of(:api,
      test_coverage: [summary: [threshold: 85], ignore_modules: [~r/Case$/, Aerie.WSClient]],
      deps:
        [
          {:base, in_umbrella: true},
          {:mav_router, in_umbrella: true},
          {:vehicle, in_umbrella: true},
          {:control, in_umbrella: true},
          {:fleet, in_umbrella: true},
          {:access, in_umbrella: true}
        ] ++ Aerie.Packages.deps([:telemetry])
    )
  end

  def application, do: Aerie.Project.application([:logger, :cowboy], [:inets])
end
