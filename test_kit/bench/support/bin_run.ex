defmodule Bench.BinRun do
  @moduledoc "A gateway that `bin/run` starts in a folder of its own, as a user does, and what its OS processes use."

  alias Bench.{OSProcess, Sample}

  @root Path.expand("../../..", __DIR__)
  # Less than this of a core is quiet.
  @quiet_part 0.05
  # The environment of a plain shell.
  @plain for name <- ~w(MIX_ENV MIX_BUILD_PATH AERIE_CODE), do: {name, nil}

  @type t :: %{port: port(), config: Path.t(), dir: Path.t(), http: :inet.port_number(), started: integer()}

  @doc "A vehicle that sends so many frames a second (`load`: the compiled `serial_load`), for the time of `fun`."
  @spec with_vehicle(Path.t(), non_neg_integer(), (String.t() -> result)) :: result when result: term()
  def with_vehicle(load, rate, fun) do
    vehicle = Port.open({:spawn_executable, load}, [:binary, :exit_status, args: ["#{rate}"]])
    result = fun.(OSProcess.line(vehicle, "/dev/") <> ",115200")
    Port.close(vehicle)
    result
  end

  @doc """
  Starts it with one link; the folder keeps what an earlier one wrote. Options: `:program`, the `bin/aerie` of a
  release; `:sim`, how many simulated vehicles it has besides.
  """
  @spec start(Path.t(), String.t(), keyword()) :: t()
  def start(dir, url, options \\ []) do
    File.mkdir_p!(dir)
    config = Path.join(dir, "gateway.yaml")
    http = OSProcess.free_port(:gen_tcp)
    File.rm(Path.join(dir, "nats/url"))

    File.write!(config, """
    mavlink: {local_addr: "127.0.0.1:#{OSProcess.free_port(:gen_udp)}"}
    links: [{id: autopilot, url: "#{url}"}]
    http: {port: #{http}}
    shell: {dir: "#{dir}/shell"}
    #{files(dir)}
    """)

    started = System.monotonic_time(:microsecond)
    {program, subcommand} = program(options)
    command = ~s(exec "$0" #{subcommand} --config "$1" --sim #{options[:sim] || 0} >>"$2" 2>&1)
    arguments = ["-c", command, program, config, output(dir)]
    env = for {name, nil} <- @plain, do: {String.to_charlist(name), false}
    port = Port.open({:spawn_executable, "/bin/sh"}, [:binary, :exit_status, args: arguments, env: env])
    %{port: port, config: config, dir: dir, http: http, started: started}
  end

  defp program(options) do
    case options[:program] do
      release when release in [nil, ""] -> {Path.join(@root, "bin/run"), ""}
      release -> {release, "start"}
    end
  end

  @doc "The part of a configuration file that keeps all files below a folder."
  @spec files(Path.t()) :: String.t()
  def files(dir) do
    """
    websocket: {port: #{OSProcess.free_port(:gen_tcp)}}
    sockets: {dir: "#{dir}"}
    nats: {port: 0, store_dir: "#{dir}/nats"}
    outbox: {dir: "#{dir}/outbox"}
    recorder: {dir: "#{dir}/recordings"}
    signing: {dir: "#{dir}/signing"}
    """
  end

  defp output(dir), do: Path.join(dir, "output")

  @doc "Milliseconds from the start until it answers; until `/readyz` says ready; until a vehicle is online."
  @spec until(t(), :answers | :ready | :online) :: float()
  def until(gateway, :answers), do: until_seen(gateway, "/healthz", "HTTP/1.1")
  def until(gateway, :ready), do: until_seen(gateway, "/readyz", "HTTP/1.1 200")
  def until(gateway, :online), do: until_seen(gateway, "/api/status", ~r/"status":\s*"online"/)

  defp until_seen(gateway, path, wanted) do
    Sample.until(fn ->
      if since(gateway) > 60_000, do: raise(File.read!(output(gateway.dir)))
      get(gateway.http, path) =~ wanted
    end)

    since(gateway)
  end

  @doc "Milliseconds since the start."
  @spec since(t()) :: float()
  def since(gateway), do: (System.monotonic_time(:microsecond) - gateway.started) / 1000

  defp get(port, path) do
    with {:ok, socket} <- :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false]),
         :ok <- :gen_tcp.send(socket, "GET #{path} HTTP/1.1\r\nhost: 127.0.0.1\r\nconnection: close\r\n\r\n") do
      Bench.Socket.all(socket)
    else
      {:error, _not_yet} -> ""
    end
  end

  @doc "CPU seconds that the gateway's VM has used when it is quiet for a second."
  @spec quiet(t()) :: float()
  def quiet(gateway, last \\ nil) do
    cpu = OSProcess.cpu(vm(gateway))

    if last != nil and cpu - last < @quiet_part do
      last
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
    %{
      cpu: OSProcess.cpu(pid),
      memory: 1024 * OSProcess.number(pid, "smaps_rollup", "Pss"),
      written: OSProcess.number(pid, "io", "write_bytes")
    }
  end

  @doc "The value of an expression in it, as text."
  @spec rpc(t(), String.t()) :: String.t()
  def rpc(gateway, expression) do
    words = ["rpc", expression, "--dir", Path.join(gateway.dir, "shell")]
    {text, 0} = System.cmd(Path.join(@root, "bin/aerie"), words, env: @plain)
    String.trim(text)
  end

  # The VM, not the scripts around it.
  defp vm(gateway) do
    {pids, _status} = System.cmd("pgrep", ["-f", "(Application.*:aerie|-aerie start).*#{gateway.config}"])
    pids |> String.split() |> Enum.max_by(&OSProcess.number(&1, "status", "VmRSS"), fn -> nil end)
  end

  @doc "`kill -9`, and waits until its script has ended."
  @spec kill(t()) :: :ok
  def kill(%{port: port} = gateway) do
    with pid when is_binary(pid) <- vm(gateway), do: System.cmd("kill", ["-KILL", pid])
    receive do: ({^port, {:exit_status, _status}} -> :ok)
  end
end
