defmodule Aerie.System.ToolTest do
  @moduledoc "`bin/aerie` with a gateway that `bin/run` has started: every example of docs/operating.md."

  use Aerie.SystemCase, async: true
  use Aerie.RunCase

  alias Aerie.{PythonPeer, SerialPeer}

  @moduletag :tmp_dir
  @root Path.expand("../..", __DIR__)

  setup %{tmp_dir: folder} do
    radio = free_udp_port()

    config =
      config_file(folder,
        remote: %{enabled: true},
        links: [%{id: "radio", url: "udpin:127.0.0.1:#{radio}"}],
        clients: [],
        sockets: %{enabled: false},
        timeouts: patient(),
        mavlink: %{local_addr: "127.0.0.1:#{free_udp_port()}"}
      )

    %{config: config, folder: folder, radio: radio}
  end

  defp aerie(context, words, input \\ "") do
    File.write!(Path.join(context.folder, "input"), input)
    script = ~s(exec "$0" "$@" <"${AERIE_SHELL_DIR%/*}/input" 2>&1)
    environment = [{"AERIE_SHELL_DIR", Path.join(context.folder, "shell")} | environment()]
    {text, status} = System.cmd("sh", ["-c", script, Path.join(@root, "bin/aerie") | words], env: environment)
    # What bin/ says while another start compiles.
    {String.replace(text, ~r/^==> .*\n/m, ""), status}
  end

  # A gateway is not ready for a moment when the machine stood still.
  defp ready(context, words) do
    eventually(
      fn -> with({text, 0} <- aerie(context, words), do: text, else: (_not_ready -> nil)) end,
      fn -> "it is ready: #{inspect(aerie(context, words))}" end
    )
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

    json = ready(context, ["status", "--json"])

    assert %{"health" => %{"status" => "ready"}, "vehicles" => [%{"vehicle" => "sim-001"}]} =
             JSON.decode!(json)

    text = ready(context, ["status"])
    assert text =~ "ready: 1 vehicle," and text =~ "sim-001"

    assert {text, 0} = aerie(context, ["tail", "sim-001", "--count", "2"])
    assert [_first, _second] = String.split(text, "\n", trim: true)
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
    assert status in [0, 1] and text =~ ~r/(completed|accepted|rejected|failed|timeout|unknown|expired)/

    assert {text, 0} =
             aerie(context, ["rpc", "Aerie.Control.Commands.recent(:default, \"sim-001\") |> length()"])

    assert text == "1\n"

    assert {text, 0} = aerie(context, ["params", "list", "sim-001", "BAT", "--json"])
    assert [%{"name" => name} | _] = JSON.decode!(text)
    saved = Path.join(context.folder, "all.param")
    assert {"wrote " <> _, 0} = aerie(context, ["params", "save", "sim-001", saved])
    assert File.read!(saved) =~ name
    assert {text, 0} = aerie(context, ["record", "list"])
    assert text =~ "FILE"
    records(context)
    missions(context)
    assert {json, 0} = aerie(context, ["link", "list"])
    assert "radio" in for(link <- JSON.decode!(json)["links"], do: link["id"])
    assert {text, 2} = aerie(context, ["client", "add", "tcpin:127.0.0.1:0"])
    assert text =~ "there is nobody to confirm it"
    assert {text, 0} = aerie(context, ["shadow", "get", "sim-001"])
    assert %{"vehicle" => "sim-001"} = JSON.decode!(text)
    assert {text, 0} = aerie(context, ["log", "change", "--level", "info"], "y\n")
    assert text =~ ~s("level": "info")

    assert {text, 0} = aerie(context, ["user", "add", "ann", "--role", "viewer"], "a long enough password\n")
    assert text =~ "added ann"
    assert {text, 0} = aerie(context, ["user", "list"])
    assert text =~ ~r/ann +viewer/
    refute text =~ "pbkdf2"

    elsewhere(context)

    # The shell's helpers.
    for {expression, expected} <- [
          {~s|fleet()|, "sim-001"},
          {~s(v "sim-001"), "position.lat"},
          {~s(v "nobody"), "there is no vehicle nobody"},
          {~s|links()|, "sim"},
          {~s(watch "sim-001", :ATTITUDE, 1), "ATTITUDE"},
          {~s(trace "none", 1), "there is no link none"},
          {~s(shadow "sim-001"), "reported"},
          {~s|top()|, "REDUCTIONS"},
          {~s|sup()|, "RESTARTS"},
          {~s(cmd "sim-001", :rtl), "there is nobody to confirm it"},
          {~s(drop "udp"), "not done"},
          {~s(sim 1), "added 1, from "},
          {~s|health()|, "NATS connected"},
          {~s|greet()|, "h Aerie.Shell"}
        ] do
      assert {text, 0} = aerie(context, ["rpc", expression]), expression
      assert text =~ expected, "#{expression}: #{text}"
    end

    # The vehicle may be late within the one second that is looked at.
    eventually(
      fn ->
        {text, 0} = aerie(context, ["rpc", ~s(trace "sim", 1)])
        text =~ "HEARTBEAT"
      end,
      "its messages are seen"
    )

    # Its own ports count as free: edit, check, reload.
    assert {text, 0} = aerie(context, ["config", "check", context.config])
    assert text =~ "a gateway can start with it"

    # The end of a pipe ends nothing; the gateway answers the next one.
    assert {text, 2} = aerie(context, ["remote"], "fleet()\n")
    assert text =~ "aerie rpc"
    assert {text, 2} = aerie(context, ["rpc", "raise \"no\""])
    assert text =~ "no"
    terminals(context)

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

  # The gateway lives on, however a shell's terminal ends.
  defp terminals(context) do
    words = [Path.join(@root, "test/peers/terminal.py"), Path.join(@root, "bin/aerie"), "remote"]
    environment = [{"AERIE_SHELL_DIR", Path.join(context.folder, "shell")} | environment()]
    {text, status} = System.cmd(PythonPeer.python(), words, env: environment, stderr_to_stdout: true)
    ways = ["exit()", "Ctrl-C twice", "closed terminal", "SIGHUP", "SIGTERM", "SIGKILL"]
    assert {String.split(text, "\n", trim: true), status} == {ways, 0}
    assert ready(context, ["status"]) =~ "ready: "
  end

  defp recordings(context, n) do
    assert {json, 0} = aerie(context, ["record", "list", "--json"])
    recordings = JSON.decode!(json)
    if length(recordings) == n, do: recordings
  end

  # A vehicle that only another gateway hears.
  defp elsewhere(context) do
    now = "System.os_time(:microsecond)"

    assert {_ok, 0} =
             aerie(context, [
               "rpc",
               ~s|Aerie.Fleet.Remote.Table.put_gateway(:default, "far-1", "gateway-far-1", nil, #{now})|
             ])

    assert {text, 0} = aerie(context, ["status"])
    assert text =~ ~r/far-1 .*gateway-far-1/
    assert {text, 2} = aerie(context, ["tail", "far-1"])
    assert text =~ "far-1 is heard by the gateway gateway-far-1"
    assert {text, 1} = aerie(context, ["cmd", "far-1", "hold", "--yes"])
    assert text =~ "gateway-far-1"

    for {expression, expected} <- [
          {~s|fleet()|, ~r/far-1 .*gateway-far-1/},
          {~s(v "far-1"), ~r/heard by the gateway gateway-far-1/},
          {~s(watch "far-1", :ATTITUDE), ~r/far-1 is heard by the gateway gateway-far-1/}
        ] do
      assert {text, 0} = aerie(context, ["rpc", expression]), expression
      assert text =~ expected
    end
  end

  defp records(context) do
    assert {"recording sim-001\n", 0} = aerie(context, ["record", "start", "sim-001"])
    # Its file is there with the next frames.
    [%{"file" => file, "open" => true}] =
      eventually(fn -> recordings(context, 1) end, "the recording has a file")

    assert {"no longer recording sim-001\n", 0} = aerie(context, ["record", "stop", "sim-001"])
    assert [%{"file" => ^file, "open" => false}] = recordings(context, 1)

    # The last minutes, as a file that `aerie replay` reads.
    assert {saved, 0} = aerie(context, ["record", "save", "sim-001"])
    [path] = Path.wildcard(Path.join(context.folder, "recordings/**/#{Path.basename(String.trim(saved))}"))
    assert {text, 0} = aerie(context, ["replay", path])
    # A recording does not know the names that a gateway gave.
    assert text =~ ~s("vehicle":"VID-001")

    # The summary goes to stderr.
    events = for "{" <> _ = line <- String.split(text, "\n"), do: JSON.decode!(line)
    assert Enum.all?(events, &match?(%{"time" => _, "type" => _}, &1))
    tried(context, path)

    # The same minutes with what was commanded, under the name that the gateway gave.
    archive = Path.join(context.folder, "incident.tar.gz")
    assert {text, 0} = aerie(context, ["incident", "sim-001", "--from", "-10m", "--output", archive])
    assert text =~ "#{archive}: "
    {:ok, files} = :erl_tar.extract(archive, [:memory, :compressed])
    files = Map.new(files, fn {name, bytes} -> {Path.basename(name), bytes} end)
    assert files["flight.tlog"] != "" and files["commands.jsonl"] =~ ~s("type":"hold")
    assert files["index.html"] =~ "sim-001"
    assert {text, 2} = aerie(context, ["incident", "sim-001", "--from", "soon"])
    assert text =~ "--from: 'soon': expected RFC 3339"

    assert {text, 2} = aerie(context, ["record", "start", "sim-9"])
    assert text =~ "sim-9"
    assert {text, 2} = aerie(context, ["record", "start"])
    assert text =~ "need a VEHICLE"
    assert {text, 2} = aerie(context, ["record", "begin", "sim-001"])
    assert text =~ "expected start, stop, save or list"
  end

  # What was commanded in it, against a policy that limits it.
  defp tried(context, path) do
    policy = Path.join(context.folder, "a policy.yaml")
    names = ~s(vehicles: [{id: sim-001, system_id: 1}]\n)
    # Never: nobody knows whether it was armed by the time that it was told to hold.
    File.write!(policy, names <> "policy: {conditions: [{types: [hold], armed: false, in_air: true}]}\n")

    words = [
      "policy",
      "try",
      policy,
      "--recordings",
      path,
      "--ledger",
      Path.join(context.folder, "ledger"),
      "--json"
    ]

    assert {text, 1} = aerie(context, words)
    lines = for "{" <> _ = line <- String.split(text, "\n"), do: JSON.decode!(line)
    assert %{"refused" => refused, "recordings" => 1} = List.last(lines)
    assert refused >= 1

    assert %{
             "who" => "bin/aerie",
             "role" => "admin",
             "decision" => "deny",
             "rule" => "condition",
             "vehicle" => "sim-001"
           } =
             Enum.find(lines, &(&1["command"] == "hold"))

    assert {text, 2} =
             aerie(context, ["policy", "try", policy, "--recordings", Path.join(context.folder, "none")])

    assert text =~ "none: no such file or directory"
    assert {text, 0} = aerie(context, ["policy", "try", "--help"])
    assert text =~ "--recordings DIR"
  end

  defp missions(context) do
    file = Path.join(context.folder, "flight.waypoints")

    File.write!(file, """
    QGC WPL 110
    0\t1\t0\t16\t0\t0\t0\t0\t47.397742\t8.545594\t488\t1
    1\t0\t3\t22\t0\t0\t0\t0\t47.397742\t8.545594\t20\t1
    2\t0\t3\t16\t0\t0\t0\t0\t47.398200\t8.546100\t30\t1
    """)

    assert {text, 2} = aerie(context, ["mission", "load", "sim-001", file])
    assert text =~ "there is nobody to confirm it"
    assert {text, 0} = aerie(context, ["mission", "load", "sim-001", file, "--yes"])
    assert text =~ "completed"
    assert {text, 0} = aerie(context, ["mission", "show", "sim-001"])
    assert text =~ "47.3982" and text =~ "8.5461"
    assert {text, 0} = aerie(context, ["mission", "clear", "sim-001", "--yes"])
    assert text =~ "completed"
    assert {text, 0} = aerie(context, ["mission", "show", "sim-001"])
    refute text =~ "47.3982"

    assert {text, 2} = aerie(context, ["mission", "load", "sim-001", file <> "x", "--yes"])
    assert text =~ "no such file"
    File.write!(file, "QGC WPL 110\nnonsense\n")
    assert {_text, 2} = aerie(context, ["mission", "load", "sim-001", file, "--yes"])
    assert {text, 2} = aerie(context, ["mission", "show", "sim-001", "route"])
    assert text =~ "expected mission"
  end

  test "parameters of a camera", context do
    port = open(["--config", context.config, "--quiet"])
    link = "udpout:127.0.0.1:#{context.radio}"
    start_supervised!({SimVehicle, firmware: :px4, system: 7, camera: 100, ready_s: 1.0, link: link})
    await_output(port, "", ["vehicle=VID-007 status=online"])
    camera = ["--component", "100"]
    assert {text, 0} = aerie(context, ["params", "list", "VID-007", "cam_"] ++ camera)
    assert text =~ ~r/CAM_NAME +Nadir/ and text =~ ~r/CAM_FREE +18446744073709551615/
    assert {text, 0} = aerie(context, ["params", "set", "VID-007", "CAM_NAME", "Rear", "--yes"] ++ camera)
    assert text =~ "completed"
    assert {"Rear\n", 0} = aerie(context, ["params", "get", "VID-007", "CAM_NAME"] ++ camera)
    assert {text, 1} = aerie(context, ["params", "set", "VID-007", "CAM_ISO", "fast", "--yes"] ++ camera)
    assert text =~ "rejected"
    assert {text, 2} = aerie(context, ["params", "set", "VID-007", "MIS_TAKEOFF_ALT", "high", "--yes"])
    assert text =~ "expected a number"
    assert {text, _status} = aerie(context, ["params", "list", "VID-007", "--component", "0"])
    assert text =~ "component: expected an integer from 1 to 255"
    assert {_text, 0} = aerie(context, ["stop"])
    assert await_exit(port) == 0
  end

  test "an answer that the disk has no room for is an error; a reader that has seen enough is not",
       %{folder: folder} do
    tool = Path.join(@root, "bin/aerie")
    flight = Path.join(folder, "flight.tlog")
    words = [tool, Path.join(@root, "bin/run"), flight]
    sh = fn script -> System.cmd("bash", ["-c", script | words], env: environment()) end
    # The first start of a checkout compiles, and any test may be the first.
    assert {"", 0} = sh.(~s|"$0" eval ':ok' >/dev/null 2>&1|)
    assert {text, 2} = sh.(~s("$0" --help 2>&1 >/dev/full))
    assert text =~ "error: standard output takes nothing: no space left on device"
    # What is printed on the way, and by bin/run.
    recording = File.read!(Path.join(@root, "apps/vehicle/test/fixtures/px4_flight.tlog.gz"))
    File.write!(flight, :zlib.gunzip(recording))

    for call <- [
          ~s|"$0" eval 'IO.puts(1)'|,
          ~s("$0" replay "$2"),
          ~s("$1" --help)
        ] do
      {text, status} = sh.(call <> " 2>&1 >/dev/full")

      assert {status, text =~ "error: standard output takes nothing: no space left on device"} == {2, true},
             call <> ": " <> text

      # Another test's start may hold the lock for a moment, which is said.
      refute text =~ "==> compiling"
    end

    # Nobody can be told, so that only the status says it.
    assert {"", 2} = sh.(~s("$0" stauts 2>/dev/full))
    assert {"", 0} = sh.(~s("$0" replay "$2" 2>/dev/null | true; exit "${PIPESTATUS[0]}"))
    # The pipe closes before anything is written.
    assert {"0\n", 0} = sh.(~s("$0" --help 2>/dev/null | true; echo "${PIPESTATUS[0]}"))
  end

  test "without a gateway it probes, examines and explains", context do
    port = free_udp_port()
    start_supervised!({SimVehicle, [link: "udpout:127.0.0.1:#{port}"] ++ fast_vehicle(:ardupilot)})
    probe = ["probe", "udpin:127.0.0.1:#{port}", "--seconds", "4"]

    # On a busy machine four seconds may pass before anything is heard.
    text =
      eventually(
        fn -> with({text, 0} <- aerie(context, probe), do: text, else: (_unheard -> nil)) end,
        "it is heard"
      )

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
    assert {text, 0} = aerie(context, ["config", "show", context.config])
    assert text =~ ~r/^shell.dir +#{Regex.escape(context.folder)}\/shell +/m
    wrong = Path.join(context.folder, "wrong.yaml")
    File.write!(wrong, "http: {port: many}\nnats: {prot: 4222}\n")
    assert {text, 1} = aerie(context, ["config", "check", wrong])
    assert text =~ "http.port" and text =~ "nats.prot"
    assert {"3\n", 0} = aerie(context, ["eval", "1 + 2"])
    assert {":embedded\n", 0} = aerie(context, ["eval", "Aerie.Config.default().nats.mode"])
    assert {text, 0} = aerie(context, ["man"])
    assert text =~ ".TH AERIE 1"
    assert {text, 2} = aerie(context, ["stauts"])
    assert text =~ "did you mean status?"
  end

  # It looks for the rate, so it takes seconds.
  @tag :long
  test "it probes a serial port", context do
    if SerialPeer.build(), do: port(context), else: IO.puts(:stderr, "no C compiler: no serial port to probe")
  end

  defp port(context) do
    says = fn _turn -> Aerie.LinkCase.heartbeat(1) end
    peer = SerialPeer.start(baud: 115_200, every: 50, says: says)
    assert {text, 0} = aerie(context, ["probe", SerialPeer.path(peer), "--seconds", "8"])
    assert text =~ "baud rate 115200" and text =~ "MAVLink: " and text =~ "HEARTBEAT"
  end
end
