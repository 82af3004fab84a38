defmodule Aerie.CLI.CallTest do
  @moduledoc "`bin/run` from its command line to a running gateway, without the shell script."

  use Aerie.SystemCase, async: true

  @moduletag :tmp_dir

  setup do
    {:ok, device} = StringIO.open("")
    supervisor = start_supervised!({DynamicTop, []})
    gateway = make_ref()
    %{device: device, options: [supervisor: supervisor, gateway: gateway, device: device], gateway: gateway}
  end

  defp config(folder, text) do
    path = Path.join(folder, "gateway.yaml")
    audit = "policy: {audit: {dir: #{inspect(Path.join(folder, "audit"))}}}\n"

    ledger =
      "\ncommands: {ledger: {dir: #{inspect(Path.join(folder, "ledger"))}}}\n" <>
        "shadow: {dir: #{inspect(Path.join(folder, "shadow"))}}\n"

    File.write!(path, if(text =~ "policy:", do: text, else: text <> ledger <> audit))
    path
  end

  @quiet_config """
  nats: {mode: off}
  http: {port: 0}
  mavlink: {local_addr: off}
  """

  test "help, version and errors end the program with a text" do
    assert {:finish, "usage: bin/run" <> _} = Aerie.CLI.Start.call(["--help"], %{})
    assert {:finish, "aerie 0." <> _} = Aerie.CLI.Start.call(["--version"], %{})
    assert {:fail, text} = Aerie.CLI.Start.call(["--htpp", "1"], %{})
    assert text =~ "did you mean --http?"
  end

  test "a wrong configuration starts nothing and says file, key and what was expected", context do
    path = config(context.tmp_dir, "nats: {mode: off}\nmavlink:\n  sytem_id: 3\nhttp: {port: high}\n")
    assert {:fail, text} = Aerie.CLI.Start.call(["--config", path], %{}, context.options)
    assert text =~ "gateway.yaml"
    assert text =~ "mavlink.sytem_id"
    assert text =~ "system_id"
    assert text =~ "http.port"
    assert Supervisor.which_children(context.options[:supervisor]) == []
    assert Aerie.Base.Names.whereis(context.gateway, :gateway) == nil
  end

  test "a configured port that is taken starts nothing", context do
    {:ok, socket} = :gen_tcp.listen(0, ip: {127, 0, 0, 1})
    {:ok, port} = :inet.port(socket)
    path = config(context.tmp_dir, "nats: {mode: off}\nmavlink: {local_addr: off}\nhttp: {port: #{port}}\n")
    assert {:fail, text} = Aerie.CLI.Start.call(["--config", path], %{}, context.options)
    assert text =~ "http.port"
    assert Supervisor.which_children(context.options[:supervisor]) == []
  end

  test "all modules of a running gateway are loaded, so that none is read when descriptors have run out",
       context do
    path = config(context.tmp_dir, @quiet_config)
    assert :ok = Aerie.CLI.Start.call(["--config", path], %{}, context.options)
    all = Aerie.CLI.Start.ModuleLoader.all()

    for known <- [
          Aerie.Fleet.Bridge,
          MavCodec.Messages.Attitude,
          Aerie.Api.Endpoint,
          SimVehicle,
          :cowboy_req,
          :inet,
          JSON,
          Gnat
        ],
        do: assert(known in all)

    # The loader has low priority, so a busy machine delays it.
    patient = System.monotonic_time(:millisecond) + 600_000
    eventually(fn -> Enum.all?(all, &:erlang.module_loaded/1) end, "all code is loaded", patient)
  end

  test "log lines: simulated vehicles on a network of their own, state and events", context do
    config(context.tmp_dir, @quiet_config)

    assert :ok =
             Aerie.CLI.Start.call(
               ["--config", "gateway.yaml", "--sim", "1"],
               %{"AERIE_CWD" => context.tmp_dir},
               context.options
             )

    await_text(context.device, [
      "msg=event vehicle=sim-001 type=statustext",
      "vehicle=sim-001 status=online",
      "link=sim status=up"
    ])
  end

  test "a terminal gets the table, sized as bin/run says; it clears the screen, so it repeats warnings",
       context do
    path =
      config(
        context.tmp_dir,
        String.replace(@quiet_config, "local_addr: off", "local_addr: off, component_id: 1")
      )

    environment = %{"AERIE_TERMINAL" => "yes", "AERIE_COLUMNS" => "90", "AERIE_LINES" => "many"}
    assert :ok = Aerie.CLI.Start.call(["--config", path, "--sim", "1"], environment, context.options)

    text =
      await_text(context.device, [
        "VEHICLE",
        "sim-001",
        "NATS not started",
        "WARNING: mavlink.component_id is 1",
        "LATEST EVENTS",
        "sim-001 statustext"
      ])

    assert text =~ "\e[H"
  end

  test "a replay shows the recording's vehicle, and no other vehicle can connect", context do
    # A second of a simulated heartbeat, written as any recorder writes it.
    path = Path.join(context.tmp_dir, "short.tlog")

    heartbeat = %MavCodec.Messages.Heartbeat{
      type: 2,
      autopilot: 3,
      base_mode: 81,
      custom_mode: 4,
      system_status: 3
    }

    at = 1_795_213_318_000_000

    File.write!(
      path,
      for(n <- 0..3, do: [<<at + n * 250_000::64>>, MavCodec.encode(heartbeat, system: 9, seq: n)])
    )

    config =
      "nats: {mode: off}\nhttp: {port: 0}\npolicy: {audit: {dir: #{inspect(Path.join(context.tmp_dir, "audit"))}}}\n" <>
        "commands: {ledger: {dir: #{inspect(Path.join(context.tmp_dir, "ledger"))}}}\n" <>
        "shadow: {dir: #{inspect(Path.join(context.tmp_dir, "shadow"))}}\n"

    File.write!(Path.join(context.tmp_dir, "c.yaml"), config)

    assert :ok =
             Aerie.CLI.Start.call(
               ["--replay", "short.tlog", "--speed", "max", "--config", "c.yaml"],
               %{"AERIE_CWD" => context.tmp_dir},
               context.options
             )

    vehicle = eventually(fn -> Store.vehicle(context.gateway, "VID-009") end, "the recorded vehicle is known")
    assert vehicle.groups.mode.data.mode == "GUIDED"
    assert [%{id: "replay"}] = Store.links(context.gateway)
  end

  defp await_text(device, parts) do
    eventually(
      fn ->
        {_input, text} = StringIO.contents(device)
        if Enum.all?(parts, &(text =~ &1)), do: text
      end,
      fn -> "output with #{inspect(parts)}; it is:\n#{elem(StringIO.contents(device), 1)}" end
    )
  end

  @tag :tmp_dir
  test "a release whose folder for data is missing says so in its own words", %{tmp_dir: root} do
    bin = Path.expand("../../../../../bin", __DIR__)
    for dir <- ["bin/lib", "releases"], do: File.mkdir_p!(Path.join(root, dir))
    for file <- ["aerie", "lib/attend.sh"], do: File.cp!(Path.join(bin, file), Path.join([root, "bin", file]))
    File.write!(Path.join(root, "releases/start_erl.data"), "16.0 0.1.0")
    gone = Path.join(root, "gone")
    tool = Path.join(root, "bin/aerie")
    {text, 1} = System.cmd(tool, ["status"], env: [{"AERIE_HOME", gone}], stderr_to_stdout: true)

    assert text =~
             "aerie: the folder #{gone}, where the gateway keeps its data (AERIE_HOME), is missing or closed"

    refute text =~ "cd:"
  end
end
