Code.require_file("../project.exs", __DIR__)

defmodule Aerie.MixProject do
  use Mix.Project

  def project do
    Aerie.Project.of(:aerie,
      support: [Path.expand("../../test/support", __DIR__)],
      # What the tests are made of is not what they test; the census is taken by the soak.
      test_coverage: [
        summary: [threshold: 85],
        ignore_modules: [
          ~r/Case$/,
          Aerie.Census,
          Aerie.LogLines,
          DynamicTop,
          # They are about distribution, which this VM is not started for; tool_test.exs and release_test.exs run them in VMs of their own.
          Aerie.Node,
          Aerie.Node.Directory,
          Aerie.CLI.Subcommand.MissionFile,
          Aerie.CLI.Subcommand.ParamsFile,
          Aerie.CLI.Subcommand.Running.Remote,
          Aerie.CLI.Subcommand.Running.Stop
        ]
      ],
      # The system tests of the whole gateway stand at the top of the repository; this app depends on all they need.
      test_paths: ["test", "../../test"],
      test_ignore_filters: [~r"/support/", ~r"/browser/", ~r"/install/"],
      deps:
        [
          {:mav_codec, in_umbrella: true},
          {:base, in_umbrella: true},
          {:msp, in_umbrella: true},
          {:mav_router, in_umbrella: true},
          {:vehicle, in_umbrella: true},
          {:control, in_umbrella: true},
          {:fleet, in_umbrella: true},
          {:access, in_umbrella: true},
          {:api, in_umbrella: true},
          {:console, in_umbrella: true},
          # In the checkout only: a release has no simulated vehicles.
          {:sim_vehicle, in_umbrella: true, runtime: false}
        ] ++ Aerie.Packages.deps([:telemetry, :nkey])
    )
  end

  def application,
    do: Aerie.Project.application([:logger, :public_key, :fast_yaml], [:proper], mod: {Aerie.Application, []})
end
