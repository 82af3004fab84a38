Code.require_file("../project.exs", __DIR__)

defmodule Aerie.Fleet.MixProject do
  use Mix.Project

  def project do
    Aerie.Project.of(:fleet,
      deps:
        [
          {:mav_codec, in_umbrella: true},
          {:base, in_umbrella: true},
          {:protocols, in_umbrella: true},
          {:mav_router, in_umbrella: true},
          {:vehicle, in_umbrella: true},
          {:control, in_umbrella: true},
          # Tested against what the simulated vehicles answer.
          {:sim_vehicle, in_umbrella: true, only: :test, runtime: false}
        ] ++
          Aerie.Packages.deps([:telemetry, :gnat, :nkey])
    )
  end

  def application, do: Aerie.Project.application([:logger, :crypto, :ssl, :public_key])
end
