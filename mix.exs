defmodule Aerie.MixProject do
  use Mix.Project

  def project do
    [
      apps_path: "apps",
      version: "0.1.0",
      start_permanent: Mix.env() == :prod,
      deps: [],
      aliases: aliases(),
      releases: releases()
    ]
  end

  def cli, do: [preferred_envs: [check: :test]]

  defp aliases do
    [
      # What bin/test runs before the tests themselves; the order puts the cheapest first.
      check: [
        "format --check-formatted",
        "compile --warnings-as-errors",
        "xref graph --format cycles --label compile-connected --fail-above 0"
      ]
    ]
  end

  defp releases do
    [aerie: [applications: [vehicle: :permanent, fleet_web: :permanent, sim_vehicle: :load]]]
  end
end
