Code.require_file("../project.exs", __DIR__)

defmodule SimVehicle.MixProject do
  use Mix.Project

  def project do
    Aerie.Project.of(:sim_vehicle,
      deps: [{:mav_codec, in_umbrella: true}, {:protocols, in_umbrella: true}]
    )
  end

  def application, do: Aerie.Project.application([:logger])
end
