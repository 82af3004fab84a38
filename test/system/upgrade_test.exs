defmodule Aerie.System.UpgradeTest do
  @moduledoc """
  `aerie upgrade` with a release as it is installed, three vehicles in the air, and in place of systemd a program that
  knows its rules for the main process of a service.
  """

  use Aerie.SystemCase, async: true
  use Aerie.RunCase

  alias Aerie.PythonPeer

  @moduletag :tmp_dir
  @moduletag :long
  @root Path.expand("../..", __DIR__)

  setup_all do
    made = Aerie.Release.made()
    %{release: Path.join(made.folder, "aerie"), tarball: made.tarball}
  end

  setup context do
    versions = Path.join(context.tmp_dir, "opt/aerie-versions")
    File.mkdir_p!(versions)

    for name <- ["1-old", "2-new"],
        do: {_, 0} = System.cmd("cp", ["-al", context.release, Path.join(versions, name)])

    File.ln_s!("aerie-versions/1-old", Path.join(context.tmp_dir, "opt/aerie"))
    home = Path.join(context.tmp_dir, "home")
    File.mkdir_p!(home)
    ports = %{link: free_udp_port(), nats: free_tcp_port()}
    config = Path.join(context.tmp_dir, "gateway.yaml")

    File.write!(config, """
    environment: test
    links: [{id: radio, url: "udpin:127.0.0.1:#{ports.link}"}]
    nats: {port: #{ports.nats}, token: a-token-for-a-test}
    http: {port: 0}
    websocket: {port: 0}
    clients: []
    sockets: {enabled: false}
    """)

    context = Map.merge(context, %{versions: versions, home: home, ports: ports, config: config})
    manager = manage(context)
    await_output(manager, "", ["manager: heard READY=1"])
    fleet = {SimVehicle.Fleet, count: 3, link: "udpout:127.0.0.1:#{ports.link}", ready_s: 1.0, speed: 2.0}
    start_supervised!(fleet)
    assert aerie(context, "1-old", ["rpc", flying()]) == {"3\n", 0}
    Map.put(context, :manager, manager)
  end

  # Waits in the gateway, so that one program asks and not dozens one after the other.
  defp flying do
    """
    count = fn -> Enum.count(Aerie.Base.Store.vehicles(:default), & &1.groups[:mode][:data][:in_air]) end

    wait = fn wait, left ->
      if count.() == 3 or left == 0, do: count.(), else: Process.sleep(100) && wait.(wait, left - 1)
    end

    wait.(wait, 3_000)
    """
  end

  defp manage(context) do
    words = [
      Path.join(@root, "test/peers/service_manager.py"),
      Path.join(context.tmp_dir, "opt/aerie/bin/aerie"),
      "start"
    ]

    port =
      Port.open({:spawn_executable, System.find_executable("env")}, [
        :binary,
        :exit_status,
        :stderr_to_stdout,
        args: ["-i" | variables(context)] ++ [PythonPeer.python() | words]
      ])

    {:os_pid, pid} = Port.info(port, :os_pid)
    on_exit(fn -> System.cmd("kill", ["#{pid}"], stderr_to_stdout: true) end)
    port
  end

  defp variables(context),
    do: ["HOME=/", "PATH=/usr/bin:/bin", "AERIE_HOME=#{context.home}", "AERIE_CONFIG=#{context.config}"]

  defp aerie(context, version, words) do
    program = Path.join([context.versions, version, "bin/aerie"])
    System.cmd("env", ["-i" | variables(context)] ++ [program | words], stderr_to_stdout: true)
  end

  defp in_force(context), do: Path.basename(File.read_link!(Path.join(context.tmp_dir, "opt/aerie")))

  defp process(context) do
    [file] = Path.wildcard(Path.join(context.home, "var/shell/*.gateway"))
    JSON.decode!(File.read!(file))["pid"]
  end

  defp events(context) do
    conn =
      start_supervised!({Gnat, %{host: "127.0.0.1", port: context.ports.nats, token: "a-token-for-a-test"}},
        id: make_ref()
      )

    stream_events(conn)
  end

  test "another version takes its place, and back: vehicles stay, and events are there once", context do
    former = process(context)
    assert {text, 0} = aerie(context, "2-new", ["upgrade", "--take-over"])
    assert text =~ "2-new starts beside the gateway\nthe gateway hands over\n2-new runs as process "
    now = process(context)
    assert now != former and in_force(context) == "2-new"
    # The service manager was told, and what the former one said of its end did not count.
    said =
      await_output(context.manager, "", [
        "manager: main process #{now}\n",
        "manager: a process ended #{former}"
      ])

    refute said =~ "the main process ended"
    assert aerie(context, "2-new", ["rpc", flying()]) == {"3\n", 0}

    assert {text, 0} = aerie(context, "2-new", ["upgrade", "--back"])
    assert text =~ "1-old runs as process "
    assert in_force(context) == "1-old"
    assert {text, 0} = aerie(context, "1-old", ["upgrade", "--take-over"])
    assert text =~ "runs already"
    assert aerie(context, "1-old", ["rpc", flying()]) == {"3\n", 0}

    # Of two at once, one does it; the other is refused, or finds it done.
    answers =
      for(_n <- 1..2, do: Task.async(fn -> aerie(context, "2-new", ["upgrade", "--take-over"]) end))
      |> Task.await_many(Aerie.Patience.ms())

    assert Enum.count(answers, fn
             {text, 0} -> text =~ "runs as process"
             _other -> false
           end) == 1,
           inspect(answers)

    assert in_force(context) == "2-new"
    assert {text, 0} = aerie(context, "2-new", ["rpc", "to_string(:code.root_dir())"])
    assert text =~ "2-new"

    events = events(context)
    assert events != [] and events |> Enum.map(& &1["id"]) |> Enum.uniq() |> length() == length(events)

    for {{_vehicle, _epoch}, events} <- Enum.group_by(events, &{&1["vehicle"], &1["epoch"]}),
        do: assert(Enum.sort(Enum.map(events, & &1["seq"])) == Enum.to_list(1..length(events)))

    # What happened once is told once, whichever gateway saw it.
    for {{vehicle, type}, times} <- events |> Enum.frequencies_by(&{&1["vehicle"], &1["type"]}),
        type in ["armed", "takeoff"],
        do: assert({vehicle, type, times} == {vehicle, type, 1})
  end

  test "nothing is changed while something would be lost, unless it is wanted", context do
    former = process(context)
    assert {_text, 0} = aerie(context, "1-old", ["cmd", "VID-002", "take_control", "--yes"])
    assert {text, 4} = aerie(context, "2-new", ["upgrade", "--take-over"])
    assert text =~ "  VID-002: " and text =~ "is in charge of it" and text =~ "--now"
    assert process(context) == former and in_force(context) == "1-old"
    assert {_text, 0} = aerie(context, "2-new", ["upgrade", "--take-over", "--now"])
    assert in_force(context) == "2-new"
  end

  test "a version that cannot start is not put in the place of one that runs", context do
    former = process(context)
    # Its data are of a version to come.
    File.write!(Path.join(context.home, "var/outbox/FORMAT"), "aerie-outbox 99\n")
    assert {text, 2} = aerie(context, "2-new", ["upgrade", "--take-over"])
    assert text =~ "outbox.dir" and text =~ "nothing was changed"
    assert process(context) == former and in_force(context) == "1-old"
    assert {"3\n", 0} = aerie(context, "1-old", ["rpc", flying()])
    assert Path.wildcard(Path.join(context.home, "var/shell/upgrade-*")) == []
  end

  test "refuses a corrupt tarball, a foreign architecture, and a wrong checksum", context do
    file = Path.join(context.tmp_dir, "aerie.tar.gz")
    upgrade = fn -> aerie(context, "1-old", ["upgrade", file]) end
    assert {text, 2} = upgrade.()
    assert text =~ "no such file"
    File.write!(file, "nothing")
    assert {text, 2} = upgrade.()
    assert text =~ "is not a release's tarball"
    File.cp!(context.tarball, file)
    File.write!(file <> ".sha256", String.duplicate("0", 64) <> "  aerie.tar.gz\n")
    assert {text, 2} = upgrade.()
    assert text =~ "copy it again"
    assert in_force(context) == "1-old"
  end

  test "only an installed gateway is replaced", context do
    words = ["-i" | variables(context)] ++ [Path.join(context.release, "bin/aerie"), "upgrade", "--take-over"]
    assert {text, 2} = System.cmd("env", words, stderr_to_stdout: true)
    assert text =~ "is not installed"
  end
end
