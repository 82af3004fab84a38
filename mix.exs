defmodule Aerie.Umbrella.MixProject do
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
    [
      aerie: [
        applications: [aerie: :permanent],
        include_executables_for: [:unix],
        # Another architecture's (bin/release --arch).
        include_erts: System.get_env("AERIE_ERTS") || true,
        # The shell's h/1 reads them.
        strip_beams: [keep: ["Docs"]],
        steps: [:assemble, &pack/1]
      ]
    ]
  end

  # What a release has beside its applications. bin/release adds the loader and libraries of the toolchain, nats-server and xz.
  defp pack(release) do
    case apply(Aerie.Console.Assets, :pack, [Path.join(release.path, "lib/console-#{release.version}")]) do
      [] ->
        :ok

      missing ->
        Mix.raise(
          "npm packages of the console are missing: #{Enum.join(missing, ", ")}. To fix it: bin/setup"
        )
    end

    apply(Aerie.CLI.Start.ModuleLoader, :pack, [
      Path.join(release.path, "lib/aerie-#{release.version}/priv/code.zip"),
      Path.join(release.version_path, "consolidated")
    ])

    for {source, target} <- [
          {"bin/aerie", "bin/aerie"},
          {"bin/lib/attend.sh", "bin/lib/attend.sh"},
          {"config/gateway.example.yaml", "gateway.example.yaml"},
          {"LICENSE", "LICENSE"}
        ] do
      File.mkdir_p!(Path.dirname(Path.join(release.path, target)))
      File.cp!(source, Path.join(release.path, target))
    end

    release
  end
end
