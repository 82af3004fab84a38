defmodule Aerie.System.ReleaseTest do
  @moduledoc "What `bin/release` makes, used as somebody does who has only the tarball."

  use Aerie.SystemCase, async: true
  use Aerie.RunCase

  @moduletag :tmp_dir
  @root Path.expand("../..", __DIR__)

  setup_all do
    folder =
      Path.join(System.tmp_dir!(), "aerie-release-#{System.unique_integer([:positive])}-#{System.pid()}")

    on_exit(fn -> File.rm_rf!(folder) end)

    {output, 0} =
      System.cmd(Path.join(@root, "bin/release"), ["--output", folder],
        env: environment(),
        stderr_to_stdout: true
      )

    [tarball] = Path.wildcard(Path.join(folder, "*.tar.gz"))
    {_output, 0} = System.cmd("tar", ["-xzf", tarball, "-C", folder])
    %{output: output, tarball: tarball, release: String.trim_trailing(tarball, ".tar.gz")}
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

  @tag :long
  test "a gateway of it starts, is found, evaluates and ends", context do
    config = Path.join(context.tmp_dir, "gateway.yaml")

    File.write!(config, """
    nats: {port: 0}
    http: {port: 0}
    websocket: {port: 0}
    clients: []
    mavlink: {local_addr: "127.0.0.1:#{free_udp_port()}"}
    sockets: {enabled: false}
    """)

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
                 with({_text, 3} <- aerie(context, ["rpc", "Aerie.Bridge.info(:default).connected"]), do: nil)
               end,
               "it is found"
             )

    assert {text, 0} = aerie(context, ["rpc", "FleetWeb.Console.Assets.missing(:default)"])
    assert text == "[]\n"
    assert {text, 0} = aerie(context, ["stop"])
    assert text =~ "has ended"
    assert await_exit(port) == 0
  end

  @tag :long
  test "without a gateway it evaluates, too", context do
    assert {":circuits_uart\n", 0} =
             aerie(context, [
               "eval",
               "true = File.exists?(Application.app_dir(:circuits_uart, \"priv/circuits_uart\")); :circuits_uart"
             ])

    assert {text, 2} = aerie(context, ["eval", "1 +"])
    assert text =~ "error"
  end
end
