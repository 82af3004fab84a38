defmodule Aerie.System.CrossReleaseTest do
  @moduledoc "What `bin/release --arch` makes for another architecture than this machine's."

  use ExUnit.Case, async: true
  use Aerie.RunCase

  @moduletag :long
  @moduletag :tmp_dir

  @arm64 %{name: "arm64", kernel: "aarch64", elf: 183}
  @amd64 %{name: "amd64", kernel: "x86_64", elf: 62}
  {own, other} =
    if(to_string(:erlang.system_info(:system_architecture)) =~ "aarch64",
      do: {@arm64, @amd64},
      else: {@amd64, @arm64}
    )

  @own own
  @other other
  @emulator System.find_executable("qemu-#{other.kernel}-static") ||
              System.find_executable("qemu-#{other.kernel}")

  toolchain = System.get_env("AERIE_TOOLCHAIN") || Path.expand("../../.toolchain", __DIR__)

  @missing not File.exists?("#{toolchain}-#{other.name}/.complete") &&
             "Debian's packages for #{other.name} are not here: bin/test --full or bin/release --arch #{other.name} downloads them"

  @moduletag skip: @missing

  setup_all do
    made = Aerie.Release.make(["--arch", @other.name, "--deb"])
    {_output, 0} = System.cmd("tar", ["-xzf", made.tarball, "-C", made.folder])
    Map.put(made, :release, String.trim_trailing(made.tarball, ".tar.gz"))
  end

  defp files(release),
    do: for(path <- Path.wildcard(Path.join(release, "**/*")), File.regular?(path), do: path)

  # The machine of a program or library; nil for another file.
  defp machine(path) do
    case File.open!(path, [:read, :raw], &IO.binread(&1, 20)) do
      <<0x7F, "ELF", _::binary-14, machine::little-16>> -> machine
      _other -> nil
    end
  end

  test "all its programs and libraries are for that architecture, and nothing names this one's", context do
    assert Path.basename(context.tarball) =~ ~r/\Aaerie-0\..*-linux-#{@other.kernel}\.tar\.gz\z/

    assert {_text, 0} =
             System.cmd("sha256sum", ["-c", context.tarball <> ".sha256"], cd: Path.dirname(context.tarball))

    {native, texts} = Enum.split_with(files(context.release), &machine/1)
    names = Enum.map(native, &Path.basename/1)

    for name <-
          ~w(beam.smp.elf erlexec.elf nats-server.elf xz.elf circuits_uart crypto.so fast_yaml.so libc.so.6 libcrypto.so.3),
        do: assert(name in names)

    for path <- native, do: assert(machine(path) == @other.elf, path)

    assert [libraries] = Path.wildcard(Path.join(context.release, "usr/lib/*"))
    assert Path.basename(libraries) == "#{@other.kernel}-linux-gnu"

    for path <- texts, Path.basename(Path.dirname(path)) == "bin" do
      refute File.read!(path) =~ "#{@own.kernel}-linux-gnu", path
    end
  end

  test "it lists the packages of that architecture, and has its man page and completion", context do
    bom = context.release |> Path.join("sbom.cdx.json") |> File.read!() |> JSON.decode!()
    purls = for %{"purl" => "pkg:deb/" <> _ = purl} <- bom["components"], do: purl
    assert length(purls) > 20
    for purl <- purls, do: assert(purl =~ ~r/arch=(#{@other.name}|all)\z/)
    assert Enum.all?(bom["components"], &Map.has_key?(&1, "properties"))

    assert File.read!(Path.join(context.release, "share/man/man1/aerie.1")) =~ ".TH AERIE 1"
    assert File.read!(Path.join(context.release, "share/bash-completion/completions/aerie")) =~ "complete"
  end

  test "the Debian package is for that architecture", context do
    assert [deb] = Path.wildcard(Path.join(context.folder, "*.deb"))
    assert Path.basename(deb) =~ ~r/\Aaerie_0\..*_#{@other.name}\.deb\z/
    assert {@other.name <> "\n", 0} == System.cmd("dpkg-deb", ["-f", deb, "Architecture"])
    {files, 0} = System.cmd("dpkg-deb", ["-c", deb])
    assert files =~ "./usr/lib/aerie/bin/aerie"
  end

  @tag skip: @missing || (@emulator == nil && "no qemu-#{other.kernel} here (Debian's package qemu-user)")
  test "it runs, as far as an emulator can tell", context do
    # The kernel starts no program of the other architecture, so the scripts that start them say by what.
    for path <- files(context.release),
        machine(path) == nil,
        Path.basename(Path.dirname(path)) == "bin",
        text = File.read!(path),
        text =~ "/ld-linux",
        do: File.write!(path, String.replace(text, ~S(exec "$l/), ~s(exec #{@emulator} "$l/)))

    environment = ["-i", "HOME=/", "PATH=/usr/bin:/bin", "AERIE_HOME=#{context.tmp_dir}"]

    run = fn program, words ->
      System.cmd("env", environment ++ [Path.join(context.release, program) | words], stderr_to_stdout: true)
    end

    assert {"aerie 0." <> _, 0} = run.("bin/aerie", ["version"])
    assert {"nats-server: v" <> _, 0} = run.("bin/nats-server", ["--version"])
    assert {"xz " <> _, 0} = run.("bin/xz", ["--version"])

    code = """
    {:ok, _} = Application.ensure_all_started([:crypto, :ssl, :fast_yaml])
    _ = :crypto.hash(:sha256, "x")
    {:ok, [[{"a", 1}]]} = :fast_yaml.decode("a: 1")
    to_string(:erlang.system_info(:system_architecture))
    """

    assert {text, 0} = run.("bin/aerie", ["eval", code])
    assert text =~ @other.kernel
  end
end
