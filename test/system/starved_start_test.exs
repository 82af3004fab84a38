defmodule Aerie.System.StarvedStartTest do
  @moduledoc """
  A gateway that has one core, and shares it with two programs that take all they get, from its start: it starts, and
  once they have ended it passes on everything again.
  """

  use Aerie.SystemCase, async: true
  use Aerie.RunCase

  alias MavCodec.Messages, as: M

  @moduletag :tmp_dir
  @moduletag timeout: 1_200_000

  @vehicles 40
  @every_ms 50

  @tag :long
  test "vehicles that send before it is there are online, and nothing of theirs is lost afterwards", %{
    tmp_dir: folder
  } do
    udp = free_udp_port()
    http = free_tcp_port()
    config = Path.join(folder, "gateway.yaml")

    File.write!(config, """
    mavlink: {local_addr: "off"}
    links: [{id: radio, url: "udpin:127.0.0.1:#{udp}"}]
    nats: {mode: "off"}
    http: {port: #{http}}
    websocket: {port: 0}
    console: {dir: "#{folder}/console"}
    sockets: {enabled: false}
    clients: []
    """)

    # What has to be compiled is compiled before.
    assert {0, _version} = run(["--version"])

    start_supervised!({Task, fn -> send_for_ever(udp) end})
    hogs = for _ <- 1..2, do: hog()
    gateway = open(["--config", config, "--quiet"], ["taskset", "-c", "0"])
    eventually(fn -> api(http, "/readyz") end, "it answers beside them", started_by())
    eventually(fn -> link(http)["counters"]["frames_in"] > 0 end, "frames are heard beside them")
    Enum.each(hogs, &stop/1)

    eventually(
      fn ->
        match?(%{"status" => "ready", "vehicles" => @vehicles}, api(http, "/readyz")) and all_online?(http)
      end,
      "all vehicles are online"
    )

    # A link that had discarded everything for want of time went on to do so.
    eventually(fn -> undisturbed?(http) end, "a second's frames are all passed on")
    send_signal(gateway, "TERM")
  end

  # Whether nothing was discarded while each vehicle sent twenty frames.
  defp undisturbed?(http) do
    before = link(http)["counters"]
    wanted = before["frames_in"] + 20 * @vehicles

    now =
      eventually(
        fn ->
          with(
            %{"frames_in" => n} = now when n >= wanted <- link(http)["counters"],
            do: now,
            else: (_ -> nil)
          )
        end,
        "frames are heard"
      )

    Enum.all?(~w(shed shed_new kernel_dropped), &(now[&1] == before[&1]))
  end

  defp all_online?(http) do
    statuses = for %{"status" => status} <- vehicles(http), do: status
    length(statuses) == @vehicles and Enum.all?(statuses, &(&1 == "online"))
  end

  defp vehicles(http), do: api(http, "/api/vehicles")["vehicles"]
  defp link(http), do: hd(api(http, "/api/links")["links"])

  defp hog do
    port =
      Port.open({:spawn_executable, System.find_executable("taskset")},
        args: ["-c", "0", "sh", "-c", "while :; do :; done"]
      )

    {:os_pid, pid} = Port.info(port, :os_pid)
    on_exit(fn -> System.cmd("kill", ["-KILL", "#{pid}"], stderr_to_stdout: true) end)
    pid
  end

  defp stop(pid), do: {_text, 0} = System.cmd("kill", ["-KILL", "#{pid}"])

  defp send_signal(port, signal) do
    {:os_pid, pid} = Port.info(port, :os_pid)
    {_text, 0} = System.cmd("kill", ["-#{signal}", "#{pid}"])
    await_exit(port)
  end

  defp send_for_ever(udp) do
    {:ok, _timer} = :timer.send_interval(@every_ms, :next)
    sockets = for system <- 1..@vehicles, do: {system, elem(:gen_udp.open(0, [:binary, active: false]), 1)}

    for n <- Stream.iterate(0, &(&1 + 1)) do
      for {system, socket} <- sockets, message <- messages(n) do
        bytes = MavCodec.encode(message, system: system, component: 1, seq: rem(n, 256))
        # Nobody listens at first.
        _ = :gen_udp.send(socket, {127, 0, 0, 1}, udp, bytes)
        _ = :gen_udp.recv(socket, 0, 0)
      end

      receive do: (:next -> :ok)
    end
  end

  defp messages(n) when rem(n, 20) == 0,
    do: [
      %M.Heartbeat{type: 2, autopilot: 3, base_mode: 81, system_status: 3, mavlink_version: 3}
      | messages(n + 1)
    ]

  defp messages(n), do: [%M.Attitude{time_boot_ms: n * @every_ms}]
end
