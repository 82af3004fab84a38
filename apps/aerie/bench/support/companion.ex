defmodule Aerie.Bench.Companion do
  @moduledoc "A gateway aboard a vehicle, started by `bin/run` in a folder of its own, and what its OS processes use."

  @root Path.expand("../../../..", __DIR__)
  @poll_ms 5
  @quiet_part 0.05

  @type t :: %{port: port(), config: Path.t(), dir: Path.t(), http: :inet.port_number(), started: integer()}

  @doc "Calls `fun` with the device of a vehicle that sends so many frames a second."
  @spec with_vehicle(Path.t(), non_neg_integer(), (String.t() -> result)) :: result when result: term()
  def with_vehicle(program, rate, fun) do
    vehicle = Port.open({:spawn_executable, program}, [:binary, line: 1_000, args: ["#{rate}"]])

    try do
      receive do: ({^vehicle, {:data, {:eol, device}}} -> fun.(device))
    after
      Port.close(vehicle)
    end
  end

  @doc "Starts `bin/run`; the folder keeps what an earlier one wrote."
  @spec start(Path.t(), String.t()) :: t()
  def start(dir, device) do
    File.mkdir_p!(dir)
    [http, websocket, frames] = Enum.map([&:gen_tcp.listen/2, &:gen_tcp.listen/2, &:gen_udp.open/2], &free/1)
    config = Path.join(dir, "gateway.yaml")

    File.write!(config, """
    mavlink: {local_addr: "127.0.0.1:#{frames}"}
    links: [{id: autopilot, url: "#{device},115200"}]
    http: {port: #{http}}
    websocket: {port: #{websocket}}
    sockets: {dir: "#{dir}"}
    nats: {port: 0, store_dir: "#{dir}/nats"}
    outbox: {dir: "#{dir}/outbox"}
    recorder: {dir: "#{dir}/recordings"}
    signing: {dir: "#{dir}/signing"}
    """)

    started = System.monotonic_time(:millisecond)
    command = ~s(exec "$0" --config "$1" >>"$2" 2>&1)
    arguments = ["-c", command, Path.join(@root, "bin/run"), config, output(dir)]
    # As from a plain shell.
    env = for name <- [~c"MIX_ENV", ~c"MIX_BUILD_PATH", ~c"AERIE_CODE"], do: {name, false}
    port = Port.open({:spawn_executable, "/bin/sh"}, [:binary, :exit_status, args: arguments, env: env])
    %{port: port, config: config, dir: dir, http: http, started: started}
  end

  defp free(open) do
    {:ok, socket} = open.(0, ip: {127, 0, 0, 1})
    {:ok, port} = :inet.port(socket)
    :inet.close(socket)
    port
  end

  defp output(dir), do: Path.join(dir, "output")

  @doc "Seconds from the start until `/readyz` says ready."
  @spec ready(t()) :: float()
  def ready(gateway), do: until(gateway, fn -> get(gateway, "/readyz") =~ ~r"^HTTP/1.1 200" end)

  @doc "Seconds from the start until the vehicle is online."
  @spec online(t()) :: float()
  def online(gateway), do: until(gateway, fn -> get(gateway, "/api/status") =~ ~r/"status":\s*"online"/ end)

  defp until(%{started: started} = gateway, fun) do
    cond do
      fun.() -> Float.round((System.monotonic_time(:millisecond) - started) / 1000, 2)
      System.monotonic_time(:millisecond) - started > 60_000 -> raise File.read!(output(gateway.dir))
      true -> Process.sleep(@poll_ms) && until(gateway, fun)
    end
  end

  defp get(gateway, path) do
    with {:ok, socket} <- :gen_tcp.connect({127, 0, 0, 1}, gateway.http, [:binary, active: false]),
         request = "GET #{path} HTTP/1.1\r\nhost: 127.0.0.1:#{gateway.http}\r\nconnection: close\r\n\r\n",
         :ok <- :gen_tcp.send(socket, request) do
      all(socket, "")
    else
      {:error, _not_yet} -> ""
    end
  end

  defp all(socket, got) do
    case :gen_tcp.recv(socket, 0, 5_000) do
      {:ok, bytes} -> all(socket, got <> bytes)
      {:error, _closed} -> :gen_tcp.close(socket) && got
    end
  end

  @doc "CPU seconds that the gateway's VM has used when it is quiet for a second."
  @spec quiet(t()) :: float()
  def quiet(gateway, last \\ nil) do
    cpu = usage(gateway).vm.cpu

    if last != nil and cpu - last < @quiet_part do
      Float.round(last, 2)
    else
      Process.sleep(1_000)
      quiet(gateway, cpu)
    end
  end

  @doc "CPU seconds, memory and bytes written to the disk of the VM and of nats-server; bytes of output."
  @spec usage(t()) :: %{vm: map(), nats: map(), output: non_neg_integer()}
  def usage(gateway) do
    nats = gateway.dir |> Path.join("nats/nats-server.pid") |> File.read!() |> String.trim()
    %{vm: process(vm(gateway)), nats: process(nats), output: File.stat!(output(gateway.dir)).size}
  end

  defp process(pid) do
    [_name, rest] = "/proc/#{pid}/stat" |> File.read!() |> String.split(") ", parts: 2)
    [user, system] = rest |> String.split() |> Enum.slice(11, 2) |> Enum.map(&String.to_integer/1)

    %{
      cpu: (user + system) / 100,
      memory: 1024 * number("/proc/#{pid}/smaps_rollup", ~r/^Pss: +(\d+)/m),
      written: number("/proc/#{pid}/io", ~r/^write_bytes: (\d+)/m)
    }
  end

  defp number(file, pattern) do
    [_all, number] = Regex.run(pattern, File.read!(file))
    String.to_integer(number)
  end

  # The VM, not the scripts around it.
  defp vm(gateway) do
    {pids, _status} = System.cmd("pgrep", ["-f", "Application.*:aerie.*#{gateway.config}"])
    pids |> String.split() |> Enum.max_by(&size/1, fn -> nil end)
  end

  defp size(pid),
    do: with({:ok, text} <- File.read("/proc/#{pid}/statm"), do: pages(text), else: (_gone -> 0))

  defp pages(text), do: text |> String.split() |> Enum.at(1) |> String.to_integer()

  @doc "`kill -9`, and waits until its script has ended."
  @spec kill(t()) :: :ok
  def kill(%{port: port} = gateway) do
    with pid when is_binary(pid) <- vm(gateway), do: System.cmd("kill", ["-KILL", pid])
    receive do: ({^port, {:exit_status, _status}} -> :ok)
  end
end
