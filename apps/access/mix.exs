Code.require_file("../project.exs", __DIR__)

defmodule Aerie.Access.MixProject do
  use Mix.Project

  def project do
    Aerie.Project.of(:access,
      deps:
        [
          {:base, in_umbrella: true},
          {:vehicle, in_umbrella: true},
          {:control, in_umbrella: true}
        ] ++ Aerie.Packages.deps([:phoenix_live_view])
    )
  end

  def application, do: Aerie.Project.application([:logger, :cowboy])
end
