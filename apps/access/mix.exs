Code.require_file("../../packages/packages.exs", __DIR__)

defmodule Aerie.Access.MixProject do
  use Mix.Project

  def project do
    [
      app: :access,
      version: "0.1.0",
      build_path: "../../_build",
      config_path: "../../config/config.exs",
      deps_path: "../../deps",
      lockfile: "../../mix.lock",
      elixir: "~> 1.20",
      # Most of it is tested by whole pages and requests: apps/console/test/aerie/console/access, apps/api.
      test_coverage: [summary: [threshold: 15]],
      deps: deps()
    ]
  end

  def application, do: [extra_applications: [:logger, :cowboy]]

  defp deps,
    do:
      [
        {:base, in_umbrella: true},
        {:vehicle, in_umbrella: true},
        {:control, in_umbrella: true}
      ] ++ Aerie.Packages.deps([:phoenix_live_view])
end
