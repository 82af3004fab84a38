Code.require_file("../project.exs", __DIR__)

defmodule Msp.MixProject do
  use Mix.Project

  def project do
    Aerie.Project.of(:msp,
      deps: [
        {:mav_codec, in_umbrella: true},
        {:protocols, in_umbrella: true},
        {:sim_vehicle, in_umbrella: true, only: :test}
      ]
    )
  end

  def application, do: Aerie.Project.application([:xmerl])
end
