defmodule Aerie.System.ToolTest do
  @moduledoc "`bin/aerie` with a gateway that `bin/run` has started: every example of docs/operating.md."

  use Aerie.SystemCase, async: true
  use Aerie.RunCase

  @moduletag :tmp_dir
  @root Path.expand("../..", __DIR__)

  setup %{tmp_dir: folder} do
    config = Path.join(folder, "gateway.yaml")

    dirs =
      for name <- ~w(console signing recorder params shadow), do: "#{name}: {dir: \"#{folder}/#{name}\"}\n"

    File.write!(config, """
    nats: {port: 0, store_dir: "#{folder}/nats"}
    outbox: {dir: "#{folder}/outbox"}
    http: {port: 0}
    websocket: {port: 0}
    clients: []
    sockets: {enabled: false}
    commands: {ledger: {dir: "#{folder}/ledger"}}
    policy: {audit: {dir: "#{folder}/audit"}}
    mavlink: {local_addr: "127.0.0.1:#{free_udp_port()}"}
    shell: {dir: "#{folder}/shell"}
    #{Enum.reject(dirs, &(&1 =~ "http"))}
    """)

    %{config: config, folder: folder}
  end

  defp aerie(context, words, input \\ "") do
    File.write!(Path.join(context.folder, "input"), input)
    script = ~s(exec "$0" "$@" <"#{context.folder}/input" 2>&1)
    environment = [{"AERIE_SHELL_DIR", Path.join(context.folder, "shell")} | environment()]
    System.cmd("sh", ["-c", script, Path.join(@root, "bin/aerie") | words], env: environment)
  end

  test "it finds the gateway, shows, commands, evaluates and ends it", context do
    assert {text, 3} = aerie(context, ["status"])
    assert text =~ "no gateway is running"

    port = open(["--config", context.config, "--sim", "1", "--quiet"])
    await_output(port, "", ["connected to NATS at", "vehicle=sim-001 status=online"])

    # Only the gateway's user gets in.
    assert {"700\n", 0} = System.cmd("stat", ["-c", "%a", Path.join(context.folder, "shell")])

    for file <- Path.wildcard(Path.join(context.folder, "shell/*")),
        do: assert({"600\n", 0} = System.cmd("stat", ["-c", "%a", file]))

    assert {json, 0} = aerie(context, ["status", "--json"])

    assert %{"health" => %{"status" => "ready"}, "vehicles" => [%{"vehicle" => "sim-001"}]} =
             JSON.decode!(json)

    assert {text, 0} = aerie(context, ["status"])
    assert text =~ "ready: 1 vehicles" and text =~ "sim-001"

    assert {text, 0} = aerie(context, ["tail", "sim-001", "--count", "2"])
    assert length(String.split(text, "\n", trim: true)) == 2
    assert {text, 2} = aerie(context, ["tail", "sim-9"])
    assert text =~ "there is no vehicle sim-9; known are sim-001"

    # What moves a vehicle asks, and nobody's answer is no.
    assert {text, 2} = aerie(context, ["cmd", "sim-001", "rtl"])
    assert text =~ "there is nobody to confirm it"
    assert {text, 2} = aerie(context, ["cmd", "sim-001", "rtl"], "n\n")
    assert text =~ "not done"
    assert {text, 2} = aerie(context, ["cmd", "sim-001", "rtll"])
    assert text =~ "did you mean rtl?"
    assert {text, status} = aerie(context, ["cmd", "sim-001", "hold"], "y\n")
    assert status in [0, 1] and text =~ ~r/(completed|accepted|rejected|failed|timeout)/
    assert {text, 0} = aerie(context, ["rpc", "Aerie.Commands.recent(:default, \"sim-001\") |> length()"])
    assert text == "1\n"

    assert {text, 0} = aerie(context, ["params", "list", "sim-001", "BAT", "--json"])
    assert [%{"name" => _} | _] = JSON.decode!(text)
    assert {text, 0} = aerie(context, ["record", "list"])
    assert text =~ "FILE"

    assert {text, 0} = aerie(context, ["user", "add", "ann", "--role", "viewer"], "a long enough password\n")
    assert text =~ "added ann"
    assert {text, 0} = aerie(context, ["user", "list"])
    assert text =~ ~r/ann +viewer/
    refute text =~ "pbkdf2"

    # The shell's helpers.
    for {expression, expected} <- [
          {~s|fleet()|, "sim-001"},
          {~s(v "sim-001"), "position.lat"},
          {~s(v "nobody"), "there is no vehicle nobody"},
          {~s|links()|, "sim"},
          {~s(watch "sim-001", :ATTITUDE, 1), "ATTITUDE"},
          {~s(trace "sim", 1), "HEARTBEAT"},
          {~s(trace "none", 1), "there is no link none"},
          {~s(shadow "sim-001"), "reported"},
          {~s|top()|, "REDUCTIONS"},
          {~s|sup()|, "RESTARTS"},
          {~s(cmd "sim-001", :rtl), "there is nobody to confirm it"},
          {~s(drop "udp"), "not done"},
          {~s(sim 1), "1 vehicles fly"},
          {~s|health()|, "NATS connected"},
          {~s|greet()|, "h Aerie.Shell"}
        ] do
      assert {text, 0} = aerie(context, ["rpc", expression]), expression
      assert text =~ expected, "#{expression}: #{text}"
    end

    assert {text, 2} = aerie(context, ["rpc", "raise \"no\""])
    assert text =~ "no"

    # Nobody without the cookie.
    wrong = Path.join(context.folder, "wrong")
    File.cp_r!(Path.join(context.folder, "shell"), wrong)
    File.write!(Path.join(wrong, "cookie"), String.duplicate("x", 32))
    assert {text, 2} = aerie(context, ["rpc", "1", "--dir", wrong])
    assert text =~ "does not let us in"

    assert {text, 0} = aerie(context, ["stop"])
    assert text =~ "has ended"
    assert await_exit(port) == 0
    assert {_text, 3} = aerie(context, ["status"])
  end

  test "without a gateway it probes, examines and explains", context do
    port = free_udp_port()
    start_supervised!({SimVehicle, [link: "udpout:127.0.0.1:#{port}"] ++ fast_vehicle(:ardupilot)})
    assert {text, 0} = aerie(context, ["probe", "udpin:127.0.0.1:#{port}", "--seconds", "4"])
    assert text =~ "MAVLink: " and text =~ "HEARTBEAT" and text =~ "ardupilot"

    assert {text, status} =
             aerie(context, ["probe", "udpin:127.0.0.1:#{free_udp_port()}", "--seconds", "0.2"])

    assert status == 1 and text =~ "no MAVLink was heard"
    assert {text, 2} = aerie(context, ["probe", "nonsense:1"])
    assert text =~ "nonsense"

    assert {text, 0} = aerie(context, ["doctor", "--config", context.config])
    assert text =~ "configuration: " and text =~ "clock: " and text =~ "ModemManager: "
    assert {text, 0} = aerie(context, ["config", "check", context.config])
    assert text =~ "a gateway can start with it"
    assert {"3\n", 0} = aerie(context, ["eval", "1 + 2"])
    assert {text, 0} = aerie(context, ["man"])
    assert text =~ ".TH AERIE 1"
    assert {text, 2} = aerie(context, ["stauts"])
    assert text =~ "did you mean status?"
  end
end
