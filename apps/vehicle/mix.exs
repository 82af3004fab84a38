Code.require_file("../project.exs", __DIR__)

defmodule Aerie.Vehicle.MixProject do
  use Mix.Project

  def project do
    Aerie.Project.of(:vehicle,
      deps:
        [
          {:mav_codec, in_umbrella: true},
          {:base, in_umbrella: true},
          {:protocols, in_umbrella: true},
          {:msp, in_umbrella: true},
          {:mav_router, in_umbrella: true},
          # Transfers are tested against what the simulated vehicles answer.
          {:sim_vehicle, in_umbrella: true, only: :test, runtime: false}
        ] ++
          Aerie.Packages.deps([:telemetry])
    )
  end

  def application, do: Aerie.Project.application([:logger, :crypto])
end
