defmodule Aerie.PackagesTest do
  @moduledoc "What `packages/packages.exs` says when what `AERIE_PACKAGES` asks for is not there."

  use ExUnit.Case, async: true

  @root Path.expand("../../../..", __DIR__)

  @tag :tmp_dir
  test "hex without Hex says how to get it, and what to take instead", %{tmp_dir: folder} do
    # Archives, Hex among them, are in MIX_HOME or MIX_ARCHIVES.
    assert {text, 1} = mix("hex", [{"MIX_HOME", folder}, {"MIX_ARCHIVES", nil}])
    assert text =~ "AERIE_PACKAGES=hex: Hex is not installed"
    assert text =~ "mix local.hex" and text =~ "unset AERIE_PACKAGES"
  end

  test "a folder that is not there is named" do
    assert {text, 1} = mix("/nowhere/checkouts", [])
    assert text =~ "AERIE_PACKAGES: there is no folder /nowhere/checkouts"
  end

  # It ends while mix.exs is read, so nothing is compiled.
  defp mix(packages, environment) do
    System.cmd("mix", ["deps"],
      cd: Path.join(@root, "apps/vehicle"),
      env: [{"AERIE_PACKAGES", packages} | environment],
      stderr_to_stdout: true
    )
  end
end
