defmodule Aerie.System.RunTest do
  @moduledoc "`bin/run` as a user starts it: its output, its end, and what it leaves behind."

  use Aerie.SystemCase, async: true
  use Aerie.RunCase

  @moduletag :tmp_dir

  setup %{tmp_dir: folder} do
    config = Path.join(folder, "gateway.yaml")

    File.write!(config, """
    nats: {port: 0, store_dir: "#{folder}/nats"}
    outbox: {dir: "#{folder}/outbox"}
    http: {port: 0}
    mavlink: {local_addr: "127.0.0.1:#{free_udp_port()}"}
    """)

    %{config: config}
  end

  test "help and errors", context do
    assert {0, text} = run(["--help"])
    assert text =~ "usage: bin/run"
    assert {2, text} = run(["--nonsense"])
    assert text =~ "unknown option --nonsense"

    File.write!(context.config, "mavlink: {system_id: -3}\n")
    assert {2, text} = run(["--config", context.config])
    assert text =~ "mavlink.system_id"
  end

  test "it runs until Ctrl-C, and then all its children are gone", %{config: config, tmp_dir: folder} do
    port = open(["--config", config, "--sim", "2", "--quiet"])

    await_output(port, "", [
      "connected to NATS at",
      "vehicle=sim-001 status=online",
      "vehicle=sim-002 status=online"
    ])

    nats = folder |> Path.join("nats/nats-server.pid") |> File.read!() |> String.trim()
    assert File.exists?("/proc/#{nats}")

    {:os_pid, os_pid} = Port.info(port, :os_pid)
    {_output, 0} = System.cmd("kill", ["-INT", Integer.to_string(os_pid)])
    assert {0, words} = collect(port, "")
    # The shell reports no killed child.
    refute words =~ "Terminated"

    # No process that names this run's folder is left: nats-server, its guard, the VM. On a busy machine one that was
    # killed needs a moment until it is gone.
    eventually(fn -> not File.exists?("/proc/#{nats}") end, "nats-server is gone")
    eventually(fn -> System.cmd("pgrep", ["-f", Regex.escape(folder)]) == {"", 1} end, "no process is left")
  end

  test "killed with -9, its nats-server ends too, and the next start works", context do
    %{config: config, tmp_dir: folder} = context

    for _life <- 1..2 do
      port = open(["--config", config, "--quiet"])
      await_output(port, "", ["connected to NATS at"])
      nats = folder |> Path.join("nats/nats-server.pid") |> File.read!() |> String.trim()
      kill_9(config)
      assert await_exit(port, "") != 0
      eventually(fn -> not File.exists?("/proc/#{nats}") end, "nats-server is gone")
    end
  end
end
