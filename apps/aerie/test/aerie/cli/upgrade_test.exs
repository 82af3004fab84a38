defmodule Aerie.CLI.UpgradeTest do
  @moduledoc "`aerie upgrade` where no gateway runs: what it calls, and what it refuses. Aerie.System.UpgradeTest has one that runs."

  use ExUnit.Case, async: true

  import ExUnit.CaptureIO

  alias Aerie.CLI.Subcommand.Running.Upgrade

  @moduletag :tmp_dir

  setup %{tmp_dir: dir} do
    folder = Path.join(dir, "aerie-versions")

    for name <- ~w(1 2) do
      File.mkdir_p!(Path.join([folder, name, "bin"]))
      program = Path.join([folder, name, "bin/aerie"])
      File.write!(program, "#!/bin/sh\necho #{name} $*\nexit 4\n")
      File.chmod!(program, 0o755)
    end

    File.ln_s!("aerie-versions/1", Path.join(dir, "aerie"))
    %{folder: folder}
  end

  defp upgrade(c, version, options, arguments \\ %{}) do
    options = Map.put(options, :dir, Path.join(c.tmp_dir, "shell"))
    request = %{name: "upgrade", arguments: arguments, options: options, folder: c.tmp_dir}
    test = self()
    text = capture_io(fn -> send(test, {:answer, Upgrade.run(request, Path.join(c.folder, version))}) end)
    assert_received {:answer, answer}
    {answer, text}
  end

  test "the program of the other version is called, and its status counts", c do
    assert {{:error, "no other version was installed" <> _}, ""} = upgrade(c, "1", %{})
    assert {{:error, "no earlier version is installed"}, ""} = upgrade(c, "1", %{back: true})
    File.ln_s!("2", Path.join(c.folder, "next"))
    assert {{4, ""}, "2 upgrade --take-over\n"} = upgrade(c, "1", %{})
    assert {{4, ""}, "2 upgrade --take-over --now\n"} = upgrade(c, "1", %{now: true})
    File.ln_s!("2", Path.join(c.folder, "former"))
    assert {{4, ""}, "2 upgrade --take-over\n"} = upgrade(c, "1", %{back: true})
  end

  test "where none runs, its version is put in force", c do
    assert {{0, text}, ""} = upgrade(c, "2", %{take_over: true})
    assert text == "no gateway runs; 2 is in force\n"
    assert File.read_link!(Path.join(c.tmp_dir, "aerie")) == "aerie-versions/2"
    assert File.read_link!(Path.join(c.folder, "former")) == "1"
  end

  test "a tarball is unpacked and installed; not with --back", c do
    assert {{:error, "a tarball, or --back"}, ""} = upgrade(c, "1", %{back: true}, %{"FILE" => "a.tar.gz"})
    assert {{:error, text}, ""} = upgrade(c, "1", %{}, %{"FILE" => "a.tar.gz"})
    assert text =~ "a.tar.gz: no such file"
  end
end
