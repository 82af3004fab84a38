defmodule Aerie.System.OutputTest do
  @moduledoc "`bin/run` whose output cannot be written: the gateway goes on, and the lost lines are counted."

  use Aerie.SystemCase, async: true
  use Aerie.RunCase

  @moduletag :tmp_dir

  setup %{tmp_dir: folder} do
    http = free_tcp_port()
    config = Path.join(folder, "gateway.yaml")

    # A warning at the start goes to standard error.
    File.write!(config, """
    nats: {mode: off}
    http: {port: #{http}}
    vehicles: [{id: OTHER, system_id: 9}]
    mavlink: {system_id: 9, local_addr: "127.0.0.1:#{free_udp_port()}"}
    """)

    %{config: config, http: http}
  end

  defp flies?(http, vehicle),
    do: match?(%{"status" => "online"}, api(http, "/api/vehicles/#{vehicle}"))

  defp lost_lines(http) do
    case Regex.run(~r/name="output.lines_lost"} (\d+)/, get(http, "/metrics") || "") do
      [_, n] -> String.to_integer(n)
      nil -> 0
    end
  end

  # Its output is lost, so that only its end says that it did not start.
  defp await_api(port, http) do
    eventually(
      fn ->
        refute_received {^port, {:exit_status, _}}
        get(http, "/healthz")
      end,
      "it answers",
      started_by()
    )
  end

  defp end_orderly(port) do
    {:os_pid, os_pid} = Port.info(port, :os_pid)
    {_output, 0} = System.cmd("kill", ["-TERM", "#{os_pid}"])
    assert await_exit(port) == 0
  end

  test "both outputs on a full disk from the start", %{config: config, http: http} do
    port =
      open(["--config", config, "--sim", "1", "--quiet"], ["sh", "-c", ~s(exec "$@" >/dev/full 2>&1), "sh"])

    await_api(port, http)
    eventually(fn -> flies?(http, "sim-001") end, "the vehicle is there")

    lost =
      eventually(fn -> with n when n > 0 <- lost_lines(http), do: n, else: (_ -> nil) end, "it is counted")

    # It still goes on: the log and the status lines did not end with the first failure.
    eventually(fn -> lost_lines(http) > lost end, "more is counted")
    eventually(fn -> flies?(http, "sim-001") end, "the vehicle is still there")
    end_orderly(port)
  end

  test "the reader of the pipe ends", %{config: config, http: http} do
    port =
      open(["--config", config, "--sim", "1", "--quiet"], [
        "bash",
        "-c",
        ~s(exec "$@" > >(head -n 1\)),
        "bash"
      ])

    await_api(port, http)
    eventually(fn -> lost_lines(http) > 0 end, "it is counted")
    eventually(fn -> flies?(http, "sim-001") end, "the vehicle is still there")
    end_orderly(port)
  end

  @tag skip:
         System.cmd("unshare", ["-rm", "true"], stderr_to_stdout: true) |> elem(1) != 0 &&
           "no namespaces here"
  test "a disk that is full for a while: the log goes on and says what is missing", context do
    %{config: config, http: http, tmp_dir: folder} = context
    disk = Path.join(folder, "disk")
    File.mkdir_p!(disk)

    before =
      ["unshare", "-rm", "sh", "-c"] ++
        [
          ~s(mount -t tmpfs -o size=64k tmpfs "$0" && head -c 65000 /dev/zero >"$0/other"; exec "$@" >>"$0/log" 2>&1),
          disk
        ]

    port = open(["--config", config, "--sim", "1", "--quiet"], before)
    await_api(port, http)
    eventually(fn -> lost_lines(http) > 0 end, "the disk is full")
    eventually(fn -> flies?(http, "sim-001") end, "the vehicle is still there")
    # As the gateway's own namespace sees it.
    disk = "/proc/#{vm_pid(config)}/root#{disk}"
    File.rm!(Path.join(disk, "other"))

    eventually(
      fn ->
        [_before, later] =
          disk
          |> Path.join("log")
          |> File.read!()
          |> split(~r/\d+ lines of output are missing here: no space left/)

        later =~ "vehicle=sim-001"
      end,
      "the log goes on"
    )

    end_orderly(port)
  end

  defp split(text, mark) do
    case String.split(text, mark, parts: 2) do
      [one] -> [one, ""]
      two -> two
    end
  end
end
