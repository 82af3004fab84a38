defmodule Protocols.MixProject do
  use Mix.Project

  def project do
    [
      app: :protocols,
      version: "0.1.0",
      build_path: "../../_build",
      config_path: "../../config/config.exs",
      deps_path: "../../deps",
      lockfile: "../../mix.lock",
      elixir: "~> 1.20",
      test_coverage: [summary: [threshold: 85]],
      deps: [{:mav_codec, in_umbrella: true}, {:base, in_umbrella: true}]
    ]
  end

  def application, do: [extra_applications: [:crypto]]
end
