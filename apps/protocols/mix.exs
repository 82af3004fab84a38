Code.require_file("../project.exs", __DIR__)

defmodule Protocols.MixProject do
  use Mix.Project

  def project do
    Aerie.Project.of(:protocols,
      deps: [{:mav_codec, in_umbrella: true}, {:base, in_umbrella: true}]
    )
  end

  def application, do: Aerie.Project.application([:crypto])
end
