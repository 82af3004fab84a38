defmodule Aerie.Bench.OSProcess do
  @moduledoc "A gateway in an OS process of its own, for benchmarks: `mix run` of a script that answers lines with lines."

  @vm_args Path.expand("../../../../rel/vm.args.eex", __DIR__)

  @doc "Compiles a C program."
  @spec compile(Path.t(), Path.t()) :: Path.t()
  def compile(source, out) do
    cc =
      System.find_executable("cc") || System.find_executable("gcc") ||
        raise "the load needs a C compiler (cc)"

    {_, 0} = System.cmd(cc, ["-O2", "-pthread", "-o", out, source], into: IO.stream())
    out
  end

  @doc "Starts `mix` with arguments, on the emulator's flags of `bin/run`."
  @spec start([String.t()]) :: port()
  def start(args) do
    {command, args} = command(args)
    Port.open({:spawn_executable, command}, [:binary, :exit_status, args: args])
  end

  @doc "The command that `start/1` runs, and its arguments."
  @spec command([String.t()]) :: {Path.t(), [String.t()]}
  def command(args), do: {System.find_executable("elixir"), ["--vm-args", @vm_args, "-S", "mix" | args]}

  @doc "Ends it: it ends with its standard input."
  @spec stop(port()) :: :ok
  def stop(node) do
    if Port.info(node), do: Port.close(node)
    :ok
  end

  @doc "Writes a line and gives the next one that begins with `start`."
  @spec ask(port(), String.t(), String.t()) :: String.t()
  def ask(node, question, start) do
    Port.command(node, question <> "\n")
    line(node, start)
  end

  @doc "The next line that begins with `start`."
  @spec line(port(), String.t()) :: String.t()
  def line(node, start), do: line(node, start, "")

  defp line(node, start, text) do
    receive do
      {^node, {:data, more}} ->
        text = text <> more
        found = text |> String.split("\n") |> Enum.drop(-1) |> Enum.find(&String.starts_with?(&1, start))
        found || line(node, start, text)

      {^node, {:exit_status, status}} ->
        raise "the gateway ended with #{status}: #{text}"
    after
      120_000 -> raise "the gateway does not answer: #{text}"
    end
  end

  @doc "Seconds of user and system time of the gateway and of its nats-server."
  @spec cpus(port()) :: %{gateway: float(), nats: float()}
  def cpus(node) do
    {:os_pid, pid} = Port.info(node, :os_pid)
    {nats, others} = pid |> tree() |> Enum.split_with(&(name(&1) =~ "nats-server"))
    %{gateway: sum(others), nats: sum(nats)}
  end

  defp sum(pids), do: pids |> Enum.map(&cpu/1) |> Enum.sum()

  defp tree(pid) do
    case System.cmd("pgrep", ["-P", "#{pid}"], stderr_to_stdout: true) do
      {children, 0} -> [pid | children |> String.split() |> Enum.flat_map(&tree(String.to_integer(&1)))]
      _none -> [pid]
    end
  end

  defp name(pid), do: with({:ok, text} <- File.read("/proc/#{pid}/cmdline"), do: text, else: (_gone -> ""))

  defp cpu(pid) do
    with {:ok, text} <- File.read("/proc/#{pid}/stat"),
         [_name, rest] <- String.split(text, ") ", parts: 2) do
      fields = String.split(rest)
      (String.to_integer(Enum.at(fields, 11)) + String.to_integer(Enum.at(fields, 12))) / 100
    else
      _gone -> 0.0
    end
  end

  @doc "The machine's load."
  @spec load() :: String.t()
  def load, do: "/proc/loadavg" |> File.read!() |> String.split() |> hd()

  @doc "A port from which on those of ten links are free, and from 1000 on those of the vehicles."
  @spec base_port(pos_integer()) :: pos_integer()
  def base_port(vehicles) do
    base = 10_000 + 2_000 * :rand.uniform(10)
    ports = Enum.concat(base..(base + 10), (base + 1_000)..(base + 1_000 + vehicles))
    if Enum.all?(ports, &free?/1), do: base, else: base_port(vehicles)
  end

  defp free?(port) do
    with {:ok, socket} <- :gen_udp.open(port, ip: {127, 0, 0, 1}),
         do: :gen_udp.close(socket) == :ok,
         else: (_ -> false)
  end
end
