defmodule Aerie.System.ServiceTest do
  @moduledoc "What installs a release as a service: the script, the unit, the rules for udev."

  use ExUnit.Case, async: true

  @moduletag :tmp_dir
  @overlays Path.expand("../../rel/overlays", __DIR__)

  # A release as far as the script looks.
  defp release(dir, version) do
    release = Path.join(dir, "release-#{version}")
    File.mkdir_p!(Path.join(release, "releases"))
    File.mkdir_p!(Path.join(release, "bin"))
    File.cp_r!(@overlays, release)
    File.write!(Path.join(release, "releases/start_erl.data"), "17.1 #{version}")
    File.write!(Path.join(release, "gateway.example.yaml"), "#http: {}\n")
    File.write!(Path.join(release, "bin/aerie"), "#!/bin/sh\necho #{version}\n")
    File.chmod!(Path.join(release, "bin/aerie"), 0o755)
    release
  end

  defp install(release, words),
    do: System.cmd(Path.join(release, "install.sh"), words, stderr_to_stdout: true)

  test "the files of a package go to their places, and a new version replaces them", %{tmp_dir: dir} do
    root = Path.join(dir, "root")
    old = release(dir, "1.0")
    # What a gateway left that was once started from there.
    File.mkdir_p!(Path.join(old, "var/ledger"))
    File.write!(Path.join(old, "bin/gone"), "")
    assert {"", 0} = install(old, ["--stage", root])

    for file <- ~w(usr/lib/aerie/bin/aerie lib/systemd/system/aerie.service lib/udev/rules.d/60-aerie.rules),
        do: assert(File.regular?(Path.join(root, file)))

    assert File.read_link!(Path.join(root, "usr/bin/aerie")) == "/opt/aerie/bin/aerie"

    for link <- ~w(usr/share/man/man1/aerie.1 usr/share/bash-completion/completions/aerie),
        do: assert(File.read_link!(Path.join(root, link)) =~ ~r"^/opt/aerie/share/(man|bash-completion)/")

    refute File.exists?(Path.join(root, "usr/lib/aerie/var"))

    assert {"", 0} = install(release(dir, "2.0"), ["--stage", root])
    assert {"2.0\n", 0} = System.cmd(Path.join(root, "usr/lib/aerie/bin/aerie"), [])
    refute File.exists?(Path.join(root, "usr/lib/aerie/bin/gone"))
  end

  test "wrong calls change nothing and say what to do", %{tmp_dir: dir} do
    assert {"usage: ./install.sh" <> _, 2} = install(release(dir, "1"), ["--remove"])
    assert {"usage: ./install.sh" <> _, 0} = install(release(dir, "1"), ["--help"])
    empty = Path.join(dir, "empty")
    File.mkdir_p!(empty)
    File.cp!(Path.join(@overlays, "install.sh"), Path.join(empty, "install.sh"))
    assert {"error: " <> text, 1} = install(empty, ["--stage", Path.join(dir, "nothing")])
    assert text =~ "is not a release"
    refute File.exists?(Path.join(dir, "nothing"))
  end

  @tag skip: System.find_executable("systemd-analyze") == nil && "no systemd-analyze here"
  test "systemd understands the unit, and finds it hardened", %{tmp_dir: dir} do
    unit = Path.join(dir, "aerie.service")
    text = File.read!(Path.join(@overlays, "systemd/aerie.service"))
    # The program is not installed here.
    File.write!(unit, String.replace(text, "/opt/aerie/bin/aerie", "/bin/true"))
    assert {"", 0} = System.cmd("systemd-analyze", ["verify", unit], stderr_to_stdout: true)
  end

  test "each rule for udev is a line of matches and assignments, and names its end" do
    lines = @overlays |> Path.join("udev/60-aerie.rules") |> File.read!() |> String.split("\n", trim: true)
    rules = Enum.reject(lines, &String.starts_with?(&1, "#"))
    pair = ~S/[A-Z]+(\{[A-Za-z_]+\})?(==|!=|=|\+=)"[^"]*"/
    for rule <- rules, do: assert(rule =~ ~r/\A#{pair}(, #{pair})*\z/, rule)
    gotos = for [_all, label] <- Regex.scan(~r/GOTO="(\w+)"/, Enum.join(rules)), uniq: true, do: label
    assert gotos == ["aerie_end"] and List.last(rules) == ~s(LABEL="aerie_end")
  end
end
