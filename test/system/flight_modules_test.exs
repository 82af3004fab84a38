defmodule Aerie.System.FlightModulesTest do
  @moduledoc """
  What is loaded before a gateway is ready is what the flights of an ArduPilot, a PX4, a Betaflight and an iNav vehicle
  use, with a ground station and a command of an operator: `apps/aerie/priv/flight_modules.txt`. To make it again:
  `FLIGHT=write mix test` with this file.
  """

  use Aerie.SystemCase, async: true
  use Aerie.RunCase

  alias MavCodec.Messages, as: M

  @moduletag :tmp_dir
  @root Path.expand("../..", __DIR__)
  @list Path.join(@root, "apps/aerie/priv/flight_modules.txt")
  # Two flights are not alike, and each such module is late once. More of them are a part of a flight that the list
  # lacks.
  @unlisted 25
  # With all that OTP and Elixir have loaded. A module takes 25 kB.
  @most 1_600

  @tag :long
  test "a flight uses what is loaded before it, and the rest is found without a file descriptor", context do
    %{tmp_dir: folder} = context
    http = free_tcp_port()
    ground = free_tcp_port()

    config =
      config_file(folder,
        http: %{port: http},
        clients: [%{id: "ground", url: "tcpin:127.0.0.1:#{ground}"}],
        timeouts: patient(),
        mavlink: %{local_addr: "127.0.0.1:#{free_udp_port()}"}
      )

    few = ["sh", "-c", ~s(ulimit -n 512 && exec "$0" "$@")]
    open(["--config", config, "--sim", "3", "--sim-msp", "2", "--quiet"], few)
    eventually(fn -> api(http, "/readyz")["status"] == "ready" end, "it is ready", started_by())
    eventually(fn -> online(http) == 5 end, "all are online")
    ground_station(ground)
    for id <- 1..3, do: aerie(folder, ["cmd", "sim-00#{id}", "hold"], "y\n")

    used = rpc(folder, ~s|IO.puts(Enum.join(for({module, _file} <- :code.all_loaded(), do: module), " "))|)
    used = used |> String.split() |> Enum.uniq()
    assert length(used) <= @most
    ours = for module <- used, ours?(module), do: module
    if System.get_env("FLIGHT") == "write", do: File.write!(@list, Enum.map(Enum.sort(ours), &(&1 <> "\n")))
    unlisted = ours -- String.split(File.read!(@list))
    assert length(unlisted) <= @unlisted, "not in #{@list}: #{Enum.join(unlisted, " ")}"

    # A page that nobody has opened.
    assert rpc(folder, """
           page = Aerie.Console.Pages.Audit.Page
           was = :code.is_loaded(page)

           open = fn open, held ->
             case :file.open("/dev/null", [:read, :raw]) do
               {:ok, file} -> open.(open, [file | held])
               {:error, why} -> {why, was, Code.ensure_loaded?(page), held != []}
             end
           end

           open.(open, [])
           """) =~ "{:emfile, false, true, true}"
  end

  defp online(http) do
    with(
      %{"vehicles" => vehicles} <- api(http, "/api/vehicles"),
      do: Enum.count(vehicles, &(&1["status"] == "online"))
    )
  end

  # What a ground station asks of each vehicle.
  defp ground_station(port) do
    {:ok, socket} = :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false])

    for target <- 1..3,
        message <- [
          %M.Heartbeat{type: 6, autopilot: 8, mavlink_version: 3},
          %M.ParamRequestList{target_system: target, target_component: 1},
          %M.MissionRequestList{target_system: target, target_component: 1},
          %M.CommandLong{target_system: target, target_component: 1, command: 512, param1: 148.0}
        ],
        do: :ok = :gen_tcp.send(socket, MavCodec.encode(message, system: 255, component: 190))

    assert {:ok, _frames} = :gen_tcp.recv(socket, 0, Aerie.Patience.ms())
  end

  # Code of this repository that a gateway runs: no tool, no simulation.
  defp ours?(module) do
    with true <- module =~ ~r/^Elixir\.(Aerie|Mav|Msp|Protocols|Gnat|Circuits|Phoenix|Nkey|Telemetry)/ do
      not (module =~ ~r/^Elixir\.Aerie\.(CLI\.Subcommand|Shell)/)
    end
  end

  defp rpc(folder, expression) do
    {text, 0} = aerie(folder, ["rpc", expression], "")
    text
  end

  defp aerie(folder, words, input) do
    File.write!(Path.join(folder, "input"), input)
    environment = [{"AERIE_SHELL_DIR", Path.join(folder, "shell")} | environment()]
    script = ~s(exec "$0" "$@" <"${AERIE_SHELL_DIR%/*}/input" 2>&1)
    System.cmd("sh", ["-c", script, Path.join(@root, "bin/aerie") | words], env: environment)
  end
end
