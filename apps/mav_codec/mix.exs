Code.require_file("../project.exs", __DIR__)

defmodule MavCodec.MixProject do
  use Mix.Project

  def project do
    Aerie.Project.of(:mav_codec,
      deps: []
    )
  end

  def application, do: Aerie.Project.application([:crypto, :xmerl])
end
