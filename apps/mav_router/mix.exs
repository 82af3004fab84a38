Code.require_file("../project.exs", __DIR__)

defmodule MavRouter.MixProject do
  use Mix.Project

  def project do
    Aerie.Project.of(:mav_router,
      # What the tests are made of is not what they test.
      test_coverage: [summary: [threshold: 88], ignore_modules: [~r/^Aerie\./]],
      deps:
        [
          {:mav_codec, in_umbrella: true},
          {:base, in_umbrella: true},
          {:msp, in_umbrella: true}
        ] ++
          Aerie.Packages.deps([:telemetry, :circuits_uart])
    )
  end

  def application, do: Aerie.Project.application([:logger, :crypto, :ssl, :cowlib])
end
