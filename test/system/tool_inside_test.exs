defmodule Aerie.System.ToolInsideTest do
  @moduledoc """
  What `bin/aerie` and the shell do, in this VM with a gateway of it: the modules that a gateway runs for them. tool_test.exs has the
  program itself.
  """

  use Aerie.SystemCase, async: true

  import ExUnit.CaptureIO

  alias Aerie.{CLI, Shell}
  alias Aerie.CLI.{Gateway, Parser}
  alias Aerie.CommandCase

  @moduletag :tmp_dir
  @moduletag :capture_log

  # What the table says runs in the gateway is run here, with the same words.
  defp aerie(words, input \\ "") do
    {:ok, row, arguments, options} = Parser.command_line(words)
    request = %{name: row.name, arguments: arguments, options: options, folder: "."}
    me = self()
    run = fn -> send(me, {:answer, Gateway.call(node(), row.module, :run, [request])}) end
    printed = capture_io([input: input, capture_prompt: true], run)
    assert_received {:answer, answer}

    case answer do
      {:error, text} -> {printed <> text, 2}
      {status, text} -> {printed <> IO.iodata_to_binary(text), status}
    end
  end

  test "it shows, commands and changes a vehicle, and the shell does", %{tmp_dir: folder} do
    # The one that the program and the shell mean; no other test has it.
    start_gateway(folder,
      gateway: :default,
      links: ["udpin:127.0.0.1:0"],
      overrides: %{"timeouts" => patient()}
    )

    assert {text, _not_ready} = aerie(["status"])
    assert text =~ "no vehicle was heard"
    link = "udpout:127.0.0.1:#{link_port(:default, "link-1")}"
    sim = start_supervised!({SimVehicle, [link: link] ++ fast_vehicle(:ardupilot)})
    SimVehicle.await(sim, & &1.ready)
    await_standing(:default)

    json =
      eventually(
        fn -> with({json, 0} <- aerie(["status", "--json"]), do: json, else: (_not_ready -> nil)) end,
        "it is ready"
      )

    assert %{"vehicles" => [%{"vehicle" => id}]} = JSON.decode!(json)

    # A gateway that waits for a link is ready, and its status says all the same that something is wrong.
    {:ok, "dead"} = MavRouter.Link.start(:default, "tcp:127.0.0.1:1?id=dead")

    eventually(
      fn -> with({text, 1} <- aerie(["status"]), do: text =~ "ready:" and text =~ "problem: link dead: ") end,
      "the status says so"
    )

    :ok = MavRouter.Link.stop(:default, "dead")
    assert {text, 0} = aerie(["tail", id, "--count", "1"])
    assert text =~ "\n"
    assert {json, 0} = aerie(["tail", id, "--count", "1", "--json"])
    # A group of the state, or an event that came first.
    assert %{"data" => %{}} = line = json |> String.split("\n") |> hd() |> JSON.decode!()
    assert line["group"] || line["type"]
    assert {text, 2} = aerie(["tail", "nobody"])
    assert text =~ "known are #{id}"

    # The example of docs/operating.md; on the ground it is refused, and the question comes first.
    goto = ["cmd", id, "goto", "lat=47.39", "lon=8.54", "altitude=30"]
    assert {text, 2} = aerie(goto, "n\n")
    assert text =~ "goto" and text =~ "altitude=30" and text =~ "are you sure?" and text =~ "not done"
    assert {_refused, 1} = aerie(goto ++ ["--yes"])
    assert {text, 2} = aerie(["cmd", id, "goto", "lat", "--yes"])
    assert text =~ "'lat': expected NAME=VALUE"
    assert {text, 2} = aerie(["cmd", id, "gotoo"])
    assert text =~ "did you mean goto?"

    assert {text, 0} = aerie(["params", "get", id, "RTL_ALT"])
    assert {_number, "\n"} = Float.parse(text)
    assert {text, 0} = aerie(["params", "list", id, "rtl_alt"])
    assert text =~ "RTL_ALT"
    assert {text, 2} = aerie(["params", "set", id, "RTL_ALT", "high"])
    assert text =~ "expected a number"
    assert {text, 0} = aerie(["params", "set", id, "RTL_ALT", "2000", "--yes"])
    assert text =~ "completed"
    assert {text, 0} = aerie(["mission", "show", id])
    assert text =~ "SEQ"
    assert {text, 2} = aerie(["mission", "show", id, "route"])
    assert text =~ "expected mission"
    assert {_completed, 0} = aerie(["mission", "clear", id], "y\n")
    assert {text, 0} = aerie(["record", "start", id])
    assert text =~ "recording"
    # A busy disk: it is asked again.
    eventually(fn -> match?({_no_longer, 0}, aerie(["record", "stop", id])) end, "the recording is stopped")
    assert {text, 0} = aerie(["record", "list"])
    assert text =~ "FILE"
    assert {text, 0} = aerie(["user", "add", "ann", "--role", "viewer"], "a long enough password\n")
    assert text =~ "added ann"
    assert {text, 0} = aerie(["user", "list"])
    assert text =~ ~r/ann +viewer/
    assert {"removed ann\n", 0} = aerie(["user", "remove", "ann"])
    assert {"3\n", 0} = aerie(["rpc", "1 + 2"])
    assert {text, 2} = aerie(["rpc", "raise \"no\""])
    assert text =~ "no"

    operations(id, folder)
    shell(id)
  end

  # What is made of operations does what REST does, and is recorded as well.
  defp operations(id, folder) do
    add = ["link", "add", "udpin:127.0.0.1:0", "--id", "spare", "--label", "the spare one"]
    assert {text, 2} = aerie(add, "n\n")
    assert text =~ "link add udpin:127.0.0.1:0: are you sure?" and text =~ "not done"
    assert {text, 0} = aerie(add, "y\n")
    assert text =~ ~s("id": "spare")
    assert %{label: "the spare one", high_latency: false} = MavRouter.Link.get(:default, "spare")
    assert {"there is already a link spare", 2} = aerie(add ++ ["--yes"])
    assert {text, 2} = aerie(["link", "add", "replay:flight.tlog", "--id", "a b", "--yes"])
    assert text =~ "url: expected another connection string" and text =~ "id: expected 1 to 64 letters"
    assert {json, 0} = aerie(["link", "list"])
    assert ["link-1", "spare"] = for(link <- JSON.decode!(json)["links"], do: link["id"])
    assert {"done\n", 0} = aerie(["link", "remove", "spare", "--yes"])
    assert {"no link has this id; see /api/links", 2} = aerie(["link", "remove", "spare", "--yes"])

    assert {_answer, 0} =
             aerie(["client", "add", "tcpin:127.0.0.1:0", "--id", "gcs", "--networks", ~s(["main"]), "--yes"])

    assert {json, 0} = aerie(["client", "list"])
    assert %{"endpoints" => endpoints, "clients" => _connected} = JSON.decode!(json)
    assert "gcs" in for(endpoint <- endpoints, do: endpoint["id"])
    change = ["rules", "change", "gcs", "role=read_only", ~s(rate_limits={"ATTITUDE": 4}), "--yes"]
    assert {json, 0} = aerie(change)
    assert %{"changed" => %{"gcs" => %{"role" => %{"now" => "read_only"}}}} = JSON.decode!(json)
    assert {^json, 0} = aerie(["rules", "list"])
    assert {"done\n", 0} = aerie(["rules", "reset", "gcs", "--yes"])

    assert {"{}", 0} =
             with({json, 0} <- aerie(["rules", "list"]), do: {JSON.encode!(JSON.decode!(json)["changed"]), 0})

    assert {"done\n", 0} = aerie(["client", "remove", "gcs", "--yes"])

    recorded =
      eventually(
        fn ->
          changes = for %{"type" => "change"} = record <- CommandCase.audit(folder), do: record
          if List.last(changes)["action"] == "remove_client", do: changes
        end,
        "the changes are recorded"
      )

    assert for(%{"source" => "aerie"} = record <- recorded, do: {record["action"], record["target"]}) == [
             {"add_link", "spare"},
             {"remove_link", "spare"},
             {"add_client", "gcs"},
             {"change_rules", "gcs"},
             {"reset_rules", "gcs"},
             {"remove_client", "gcs"}
           ]

    # The log is everybody's: nothing is changed of it.
    assert {json, 0} = aerie(["log", "get"])
    assert %{"level" => _now, "known_areas" => [_ | _]} = JSON.decode!(json)
    assert {text, 2} = aerie(["log", "change", "--level", "loud", "--yes"])
    assert text =~ "level: expected one of debug, info"
    assert {json, 0} = aerie(["signing", "list"])
    assert %{"keys" => []} = JSON.decode!(json)
    assert {_no_key, 2} = aerie(["signing", "change", id, "revoke", "--yes"])
    assert {text, 2} = aerie(["signing", "change", id, "revoke", "--component", "256", "--yes"])
    assert text =~ "component: expected an integer from 1 to 255"
    {:ok, %{id: given}} = Aerie.Control.Commands.submit(:default, vehicle: id, type: "hold")
    assert {json, 0} = aerie(["command", "get", id, given])
    assert %{"id" => ^given, "state" => "done"} = JSON.decode!(json)
    assert {"no command of this vehicle has this id", 2} = aerie(["command", "get", id, "none"])
    assert {text, 2} = aerie(["command", "cancel", id, given], "n\n")
    assert text =~ "command cancel #{id} #{given}: are you sure?"
    assert {_not_under_way, 2} = aerie(["command", "cancel", id, given, "--yes"])
    assert {json, 0} = aerie(["command", "list", id])
    assert %{"lacks" => nil} = Enum.find(JSON.decode!(json)["commands"], &(&1["type"] == "arm"))
    assert {json, 0} = aerie(["command", "types"])
    assert "takeoff" in for(type <- JSON.decode!(json)["types"], do: type["name"])
    assert {json, 0} = aerie(["event", "list", id, "--limit", "1"])
    assert %{"events" => [%{"vehicle" => ^id}], "more" => true} = JSON.decode!(json)
    assert {json, 0} = aerie(["event", "list", "--since", "2026-01-01T00:00:00Z"])
    assert "gateway.started" in for(event <- JSON.decode!(json)["events"], do: event["type"])

    assert {"limit: expected an integer from 1 to 1000, got \"0\"", 2} =
             aerie(["event", "list", "--limit", "0"])

    assert {"no vehicle has this name; see /api/vehicles", 2} = aerie(["event", "list", "nobody"])
    assert {"rejected: there is no vehicle nobody\n", 1} = aerie(["files", "list", "nobody", "/"])
    assert {json, 0} = aerie(["files", "list", id, "/", "--timeout", "60"])
    assert JSON.decode!(json) == %{"path" => "/", "entries" => []}
    remove = ["files", "remove", id, "/nowhere"]
    assert {text, 2} = aerie(remove, "no\n")
    assert text =~ "files remove #{id} /nowhere: are you sure?"
    assert {"rejected: the vehicle has no such file\n", 1} = aerie(remove ++ ["--yes"])
    assert {json, 0} = aerie(["operation", "list"])
    assert JSON.decode!(json) == %{"operations" => []}
    assert {text, 2} = aerie(["operation", "begin", "tag=survey", ~s(command={"type": "fly_away"}), "--yes"])
    assert text =~ "command.type"
    assert {json, 0} = aerie(["shadow", "get", id])
    assert %{"vehicle" => ^id} = JSON.decode!(json)
  end

  # The examples of the shell in docs/operating.md.
  defp shell(id) do
    # Its vehicles are beside the gateway, and stay when it ends.
    on_exit(fn ->
      Supervisor.terminate_child(Aerie.CLI.Supervisor, {:sim_shell, 1})
      Supervisor.delete_child(Aerie.CLI.Supervisor, {:sim_shell, 1})
    end)

    for {call, expected} <- [
          {&Shell.greet/0, "h Aerie.Shell"},
          {&Shell.fleet/0, id},
          {fn -> Shell.v(id) end, "position.lat"},
          {&Shell.links/0, "link-1"},
          {fn -> Shell.trace("none") end, "there is no link none"},
          {fn -> Shell.watch(id, :ATTITUDE, 1) end, "ATTITUDE"},
          {fn -> Shell.cmd(id, :goto, lat: 47.39, lon: 8.54, altitude: 30) end, "not done"},
          {fn -> IO.inspect(Shell.shadow(id)) end, "reported"},
          {&Shell.top/0, "REDUCTIONS"},
          {&Shell.sup/0, "RESTARTS"},
          {fn -> Shell.sim(1) end, "added 1, from "},
          {fn -> Shell.v("nobody") end, "there is no vehicle nobody"},
          {fn -> Shell.drop("none") end, "there is no link none"},
          {fn -> Shell.drop("link-1") end, "not done"}
        ],
        do: assert(capture_io([input: "n\n"], call) =~ expected)

    # The vehicle may be late within the one second that is looked at.
    eventually(
      fn -> capture_io(fn -> Shell.trace("link-1", 1) end) =~ "HEARTBEAT" end,
      "its messages are seen"
    )
  end

  # What needs no gateway.
  defp here(words, folder) do
    case CLI.call(words, folder) do
      {:error, text} -> {text, 2}
      {status, text} -> {IO.iodata_to_binary(text), status}
    end
  end

  test "without a gateway it explains, examines and probes", %{tmp_dir: folder} do
    assert {text, 3} = here(["status", "--dir", folder], "/")
    assert text =~ "no gateway is running"
    assert {".TH AERIE 1" <> _, 0} = here(["man"], "/")
    assert {"aerie" <> _, 0} = here(["version"], "/")
    assert {"# Completion of aerie" <> _, 0} = here(["completion"], "/")
    assert {text, 2} = here(["stauts"], "/")
    assert text =~ "did you mean status?"
    assert {text, 2} = here(["replay", "none.tlog"], folder)
    assert text =~ "none.tlog: no such file"

    File.write!(Path.join(folder, "g.yaml"), "nats: {mode: off}\nhttp: {port: 0}\n")
    assert {text, _status} = here(["doctor", "--config", "g.yaml"], folder)
    for part <- ["configuration: ", "clock: ", "ModemManager: "], do: assert(text =~ part)

    # NATS that does not answer, and one that does; a configuration that is none.
    {:ok, nats} = :gen_tcp.listen(0, ip: {127, 0, 0, 1})
    {:ok, port} = :inet.port(nats)
    File.write!(Path.join(folder, "u.yaml"), "nats: {url: \"nats://127.0.0.1:#{port}\"}\nhttp: {port: 0}\n")
    assert {text, _status} = here(["doctor", "--config", "u.yaml"], folder)
    assert text =~ "ok       NATS: nats://127.0.0.1:#{port} answers"
    :gen_tcp.close(nats)
    assert {text, _status} = here(["doctor", "--config", "u.yaml"], folder)
    assert text =~ "events wait on the disk"
    File.write!(Path.join(folder, "w.yaml"), "http: {port: many}\n")
    assert {text, 1} = here(["doctor", "--config", "w.yaml"], folder)
    assert text =~ "error    configuration: " and text =~ "http.port"

    port = free_udp_port()
    start_supervised!({SimVehicle, [link: "udpout:127.0.0.1:#{port}"] ++ fast_vehicle(:ardupilot)})
    probe = ["probe", "udpin:127.0.0.1:#{port}", "--seconds", "4"]

    # On a busy machine four seconds may pass before anything is heard.
    text =
      eventually(
        fn -> with({text, 0} <- here(probe, folder), do: text, else: (_unheard -> nil)) end,
        "it is heard"
      )

    assert text =~ "MAVLink: " and text =~ "HEARTBEAT"
    assert {text, 2} = here(["probe", "nonsense:1"], folder)
    assert text =~ "nonsense"
  end

  test "of several gateways one is chosen by its name" do
    [one, _other] =
      entries =
      for n <- 1..2, do: %{name: "aerie-#{n}", port: n, pid: n, started: "now", http: nil, config: nil}

    assert {:ok, ^one} = Gateway.choose([one], nil, "/dir")
    assert {:ok, ^one} = Gateway.choose(entries, "aerie-1", "/dir")
    assert {:error, text} = Gateway.choose(entries, nil, "/dir")
    assert text =~ "several gateways are running" and text =~ "--gateway aerie-2"
    assert {:error, "no gateway aerie-3 is running" <> _} = Gateway.choose(entries, "aerie-3", "/dir")
  end
end
