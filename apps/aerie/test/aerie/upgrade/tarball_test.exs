defmodule Aerie.Upgrade.TarballTest do
  use ExUnit.Case, async: true

  import ExUnit.CaptureIO

  alias Aerie.Upgrade.{Tarball, Versions}

  @moduletag :tmp_dir
  @machine :system_architecture |> :erlang.system_info() |> to_string() |> String.split("-") |> hd()

  setup %{tmp_dir: dir} do
    folder = Path.join(dir, "aerie-versions")
    File.mkdir_p!(Path.join(folder, "1"))
    {:ok, versions} = Versions.find(Path.join(folder, "1"))
    %{versions: versions, tarball: Path.join(dir, "aerie.tar.gz")}
  end

  defp pack(%{tmp_dir: dir, tarball: file}, top, script) do
    File.mkdir_p!(Path.join(dir, top))
    File.write!(Path.join([dir, top, "install.sh"]), "#!/bin/sh\n" <> script)
    File.chmod!(Path.join([dir, top, "install.sh"]), 0o755)
    {"", 0} = System.cmd("tar", ["-czf", file, "-C", dir, top])
  end

  defp install(context, words \\ []) do
    test = self()

    text =
      capture_io(fn -> send(test, {:answer, Tarball.install(context.tarball, context.versions, words)}) end)

    assert_received {:answer, answer}
    {answer, text}
  end

  defp unpacked(context), do: context.versions.folder |> File.ls!() |> Enum.sort()

  test "its own install.sh is called, and its status counts", context do
    pack(context, "aerie-9-linux-#{@machine}", "echo \"called with $*\"; exit 4\n")
    assert {{4, ""}, text} = install(context, ["--now"])
    assert text =~ "sha256 is not there" and text =~ "called with --upgrade --now"
    assert unpacked(context) == ["1"]
  end

  test "the checksum beside it counts", context do
    pack(context, "aerie-9-linux-#{@machine}", "echo called\n")
    {sum, 0} = System.cmd("sha256sum", [context.tarball])
    File.write!(context.tarball <> ".sha256", sum)
    assert {{0, ""}, "called\n"} = install(context)
    File.write!(context.tarball <> ".sha256", String.replace(sum, ~r/^../, "zz"))
    assert {{:error, text}, ""} = install(context)
    assert text =~ "copy it again"
  end

  test "refuses other files by name, and leaves nothing", context do
    assert {{:error, text}, ""} = install(context)
    assert text =~ "no such file"
    assert {{:error, text}, ""} = install(%{context | tarball: context.tmp_dir})
    assert text =~ "expected a release's tarball"
    File.write!(context.tarball, "nothing")
    assert {{:error, text}, _} = install(context)
    assert text =~ "is not a release's tarball"
    pack(context, "aerie-9-linux-other", "echo called\n")
    assert {{:error, text}, _} = install(context)
    assert text =~ "this machine is #{@machine}"
    # It would write beside the versions.
    File.mkdir_p!(Path.join(context.tmp_dir, "deep/er"))
    File.write!(Path.join(context.tmp_dir, "install.sh"), "")

    {_text, 0} =
      System.cmd("tar", ["-czPf", context.tarball, "../../install.sh"],
        cd: Path.join(context.tmp_dir, "deep/er")
      )

    assert {{:error, text}, _} = install(context)
    assert text =~ "is not a release's tarball"
    assert unpacked(context) == ["1"]
  end
end
