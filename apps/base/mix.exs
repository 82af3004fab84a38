Code.require_file("../project.exs", __DIR__)

defmodule Aerie.Base.MixProject do
  use Mix.Project

  def project do
    Aerie.Project.of(:base,
      deps: Aerie.Packages.deps([:telemetry])
    )
  end

  def application,
    do: Aerie.Project.application([:logger, :crypto, :cowlib], [:proper], mod: {Aerie.Base.Application, []})
end
