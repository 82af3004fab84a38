defmodule Aerie.System.ReleaseTest do
  @moduledoc "What `bin/release` makes, used as somebody does who has only the tarball."

  use Aerie.SystemCase, async: true
  use Aerie.RunCase

  @moduletag :tmp_dir

  setup_all do
    made = Aerie.Release.made()

    folder =
      Path.join(System.tmp_dir!(), "Aerie's $tarball #{System.unique_integer([:positive])}-#{System.pid()}")

    File.mkdir_p!(folder)
    on_exit(fn -> File.rm_rf!(folder) end)
    {_output, 0} = System.cmd("tar", ["-xzf", made.tarball, "-C", folder])
    name = Path.basename(made.tarball, ".tar.gz")
    Map.put(made, :release, Path.join(folder, name))
  end

  defp aerie(context, words, more \\ []) do
    environment = ["HOME=/", "PATH=/usr/bin:/bin", "AERIE_HOME=#{context.tmp_dir}"] ++ more

    System.cmd("env", ["-i" | environment] ++ [Path.join(context.release, "bin/aerie") | words],
      stderr_to_stdout: true
    )
  end

  @tag :long
  test "it is small, has no simulated vehicles and no secret, and needs no libc of the machine", context do
    assert File.stat!(context.tarball).size < 60_000_000
    assert Path.wildcard(Path.join(context.release, "lib/sim_vehicle*")) == []
    refute File.exists?(Path.join(context.release, "releases/COOKIE"))

    assert {_text, 0} =
             System.cmd("sha256sum", ["-c", context.tarball <> ".sha256"], cd: Path.dirname(context.tarball))

    # A program that names the system's loader would use the system's libc.
    if context.output =~ "Erlang is this machine's own" do
      :ok
    else
      for file <- Path.wildcard(Path.join(context.release, "**/*")),
          File.regular?(file),
          not String.ends_with?(file, ".elf"),
          not (Path.basename(file) =~ ~r/\.so(\.|$)/),
          match?(<<0x7F, "ELF", _rest::binary>>, File.read!(file)) do
        refute File.read!(file) =~ "/ld-linux", file
      end
    end
  end

  # One that disturbs no other.
  defp config(context, name) do
    file = Path.join(context.tmp_dir, name)

    File.write!(file, """
    nats: {port: 0}
    http: {port: 0}
    websocket: {port: 0}
    clients: []
    mavlink: {local_addr: "127.0.0.1:#{free_udp_port()}"}
    sockets: {enabled: false}
    """)

    file
  end

  @tag :long
  test "a gateway of it starts, is found, evaluates and ends", context do
    config = config(context, "gateway.yaml")

    assert {"aerie 0." <> _, 0} = aerie(context, ["version"])
    assert {text, 2} = aerie(context, ["start", "--sim", "1"])
    assert text =~ "a release has no simulated vehicles"
    assert {text, 3} = aerie(context, ["rpc", "1"])
    assert text =~ "no gateway is running"

    environment = [
      "-i",
      "HOME=/",
      "PATH=/usr/bin:/bin",
      "AERIE_HOME=#{context.tmp_dir}",
      "AERIE_CONFIG=#{config}"
    ]

    words = environment ++ [Path.join(context.release, "bin/aerie"), "start"]

    port =
      Port.open({:spawn_executable, System.find_executable("env")}, [
        :binary,
        :exit_status,
        :stderr_to_stdout,
        args: words
      ])

    await_output(port, "", ["connected to NATS at"])

    assert {"true\n", 0} =
             eventually(
               fn ->
                 with(
                   {_text, 3} <- aerie(context, ["rpc", "Aerie.Fleet.Bridge.info(:default).connected"]),
                   do: nil
                 )
               end,
               "it is found"
             )

    assert {text, 0} = aerie(context, ["rpc", "Aerie.Console.Assets.missing(:default)"])
    assert text == "[]\n"
    assert {text, 0} = aerie(context, ["stop"])
    assert text =~ "has ended"
    assert await_exit(port) == 0
  end

  @tag :long
  test "as a daemon it leaves the terminal, writes its output to var/log, and ends when told to", context do
    # What is to be quoted for a shell.
    config = config(context, "the gateway's.yaml")

    on_exit(fn -> aerie(context, ["stop"]) end)
    assert {_text, 0} = aerie(context, ["daemon", "--config", config])

    eventually(
      fn ->
        if(match?({"true\n", 0}, aerie(context, ["rpc", "Aerie.Fleet.Bridge.info(:default).connected"])),
          do: true
        )
      end,
      "it runs"
    )

    log = Path.join(context.tmp_dir, "var/log")
    assert {"700\n", 0} = System.cmd("stat", ["-c", "%a", log])
    assert Enum.any?(Path.wildcard(log <> "/erlang.log.*"), &(File.read!(&1) =~ "connected to NATS at"))
    assert {text, 0} = aerie(context, ["stop"])
    assert text =~ "has ended"
    assert {_text, 3} = aerie(context, ["status"])
  end

  @tag :long
  test "it lists all that it consists of, with versions, licences and their texts", context do
    bom = context.release |> Path.join("sbom.cdx.json") |> File.read!() |> JSON.decode!()
    assert %{"bomFormat" => "CycloneDX", "specVersion" => "1.6", "version" => 1, "metadata" => metadata} = bom
    assert %{"component" => %{"type" => "application", "name" => "aerie", "version" => "0." <> _}} = metadata
    # Of a machine's own Erlang and its libraries only names are known.
    {known, unknown} = Enum.split_with(bom["components"], &Map.has_key?(&1, "properties"))
    assert unknown == [] or context.output =~ "Erlang is this machine's own"
    all = Enum.flat_map(known, &[&1 | Map.get(&1, "components", [])])
    refs = Enum.map(all, & &1["bom-ref"])
    assert refs == Enum.uniq(refs)

    for component <- all do
      assert %{"name" => <<_, _::binary>>, "version" => <<_, _::binary>>, "purl" => "pkg:" <> _} = component
      assert component["type"] in ~w(application library)
      assert [%{"expression" => licence}] = component["licenses"], component["name"]
      assert licence =~ ~r/\A[A-Za-z0-9.-]+( (OR|AND|WITH) [A-Za-z0-9.-]+)*\z/, component["name"]
    end

    for component <- known do
      [%{"name" => "aerie:licence", "value" => text}] = component["properties"]
      assert File.stat!(Path.join(context.release, text)).size > 300, text

      case component["purl"] do
        "pkg:deb/" <> _ ->
          assert [%{"alg" => "SHA-256", "content" => <<_::binary-64>>}] = component["hashes"]

        "pkg:npm/" <> _ ->
          assert [%{"alg" => "SHA-512", "content" => <<_::binary-128>>}] = component["hashes"]

        "pkg:generic/aerie/" <> _ ->
          assert component["properties"] == metadata["component"]["properties"]
      end
    end

    listed =
      for %{"evidence" => %{"occurrences" => found}} <- bom["components"],
          place <- found,
          do: place["location"]

    there =
      for pattern <-
            ~w(lib/* usr/lib/*/* erts-*/bin/* lib/console-*/priv/console/node_modules/*) ++
              ["lib/console-*/priv/console/node_modules/@*/*"],
          path <- Path.wildcard(Path.join(context.release, pattern)),
          not String.ends_with?(path, ".elf"),
          # The folder of a scope is not a package.
          not String.starts_with?(Path.basename(path), "@"),
          do: Path.relative_to(path, context.release)

    assert Enum.sort(Enum.uniq(listed)) == Enum.sort(["bin/nats-server", "bin/xz" | there])

    for %{"name" => "nats-server"} = nats <- known do
      assert Enum.any?(nats["components"], &String.starts_with?(&1["name"], "golang-"))

      for %{"name" => name} = linked <- nats["components"], not (context.output =~ "lacks the licences") do
        assert [%{"name" => "aerie:licence", "value" => text}] = linked["properties"], name
        assert File.stat!(Path.join(context.release, text)).size > 300, text
      end
    end
  end

  @tag :long
  test "it unpacks what a vehicle has compressed, with an xz of its own", context do
    {packed, 0} = System.cmd("sh", ["-c", "printf text | xz --stdout"])

    code = """
    {:ok, "text"} = Aerie.Control.Params.Metadata.Unpack.file("a.xz", Base.decode64!("#{Base.encode64(packed)}"))
    System.find_executable("xz")
    """

    assert {text, 0} = aerie(context, ["eval", code])
    assert text == inspect(Path.join(context.release, "bin/xz")) <> "\n"
  end

  @tag :long
  test "also evaluates without a gateway", context do
    assert {":circuits_uart\n", 0} =
             aerie(context, [
               "eval",
               "true = File.exists?(Application.app_dir(:circuits_uart, \"priv/circuits_uart\")); :circuits_uart"
             ])

    assert {text, 2} = aerie(context, ["eval", "1 +"])
    assert text =~ "error"
  end
end
