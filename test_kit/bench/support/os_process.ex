defmodule Bench.OSProcess do
  @moduledoc "Other OS processes: loads in C, gateways that answer lines with lines, and what a process uses."

  @vm_args Path.expand("../../../rel/vm.args.eex", __DIR__)

  @doc "Compiles a C program of this folder into `folder`."
  @spec compile(String.t(), Path.t()) :: Path.t()
  def compile(name, folder) do
    cc =
      System.find_executable("cc") || System.find_executable("gcc") ||
        raise "the load needs a C compiler (cc)"

    out = Path.join(folder, name)
    source = Path.join(__DIR__, name <> ".c")
    {_, 0} = System.cmd(cc, ["-O2", "-pthread", "-o", out, source], into: IO.stream())
    out
  end

  @doc "Runs a load and gives what it prints."
  @spec load(Path.t(), [term()]) :: map()
  def load(program, args) do
    {text, 0} = System.cmd(program, Enum.map(args, &to_string/1))
    JSON.decode!(text)
  end

  @doc "The command of a script of this folder in a VM with the emulator's flags of `bin/run`, and its arguments."
  @spec mix([term()]) :: {Path.t(), [String.t()]}
  def mix(args) do
    words = ["--vm-args", @vm_args, "-S", "mix", "run", "--no-compile" | Enum.map(args, &to_string/1)]
    {System.find_executable("elixir"), words}
  end

  @doc "Starts a gateway of `node.exs`, calls `fun` with it and what it says when it is ready, and ends it."
  @spec with_node(map(), (port(), String.t() -> result)) :: result when result: term()
  def with_node(options, fun) do
    {command, args} = node_command(options)
    node = Port.open({:spawn_executable, command}, [:binary, :exit_status, args: args])

    try do
      fun.(node, line(node, "ready"))
    after
      if Port.info(node), do: Port.close(node)
    end
  end

  @doc "The command of a gateway of `node.exs`."
  @spec node_command(map()) :: {Path.t(), [String.t()]}
  def node_command(options), do: mix([Path.join(__DIR__, "node.exs"), JSON.encode!(options)])

  @doc "What a node has counted since the last report."
  @spec report(port()) :: map()
  def report(node), do: node |> ask("report", "{") |> JSON.decode!()

  @doc "Writes a line and gives the next one that begins with `start`."
  @spec ask(port(), String.t(), String.t()) :: String.t()
  def ask(port, question, start) do
    Port.command(port, question <> "\n")
    line(port, start)
  end

  @doc "The next line that begins with `start`."
  @spec line(port(), String.t(), String.t()) :: String.t()
  def line(port, start, text \\ "") do
    receive do
      {^port, {:data, more}} ->
        text = text <> more
        found = text |> String.split("\n") |> Enum.drop(-1) |> Enum.find(&String.starts_with?(&1, start))
        found || line(port, start, text)

      {^port, {:exit_status, status}} ->
        raise "it ended with #{status}: #{text}"
    after
      120_000 -> raise "it does not answer: #{text}"
    end
  end

  @doc """
  CPU of a node and of its nats-server while `fun` runs, in per cent of one core of so many seconds, and its result.
  """
  @spec shares(port(), number(), (-> result)) :: {%{gateway: integer(), nats: integer()}, result}
        when result: term()
  def shares(node, seconds, fun) do
    before = cpus(node)
    result = fun.()
    {Map.new(cpus(node), fn {name, cpu} -> {name, round((cpu - before[name]) / seconds * 100)} end), result}
  end

  @doc "Seconds of user and system time of a node and of its nats-server."
  @spec cpus(port()) :: %{gateway: float(), nats: float()}
  def cpus(node) do
    {:os_pid, pid} = Port.info(node, :os_pid)
    {nats, others} = pid |> tree() |> Enum.split_with(&(read(&1, "cmdline") =~ "nats-server"))
    %{gateway: Enum.sum_by(others, &cpu/1), nats: Enum.sum_by(nats, &cpu/1)}
  end

  @doc "A process and all below it."
  @spec tree(pos_integer()) :: [pos_integer()]
  def tree(pid) do
    {children, _status} = System.cmd("pgrep", ["-P", "#{pid}"], stderr_to_stdout: true)
    [pid | children |> String.split() |> Enum.flat_map(&tree(String.to_integer(&1)))]
  end

  @doc "Seconds of user and system time of a process; 0 if it is gone."
  @spec cpu(pos_integer() | String.t()) :: float()
  def cpu(pid) do
    case String.split(read(pid, "stat"), ") ", parts: 2) do
      [_name, rest] ->
        rest |> String.split() |> Enum.slice(11, 2) |> Enum.sum_by(&String.to_integer/1) |> Kernel./(100)

      _gone ->
        0.0
    end
  end

  @doc "The number after a word in a file of `/proc`; 0 if the process is gone."
  @spec number(pos_integer() | String.t(), String.t(), String.t()) :: non_neg_integer()
  def number(pid, file, word) do
    case Regex.run(~r/^#{word}: +(\d+)/m, read(pid, file)) do
      [_all, number] -> String.to_integer(number)
      nil -> 0
    end
  end

  defp read(pid, file),
    do: with({:error, _gone} <- File.read("/proc/#{pid}/#{file}"), do: {:ok, ""}) |> elem(1)

  @doc "The machine's load."
  @spec load() :: String.t()
  def load, do: "/proc/loadavg" |> File.read!() |> String.split() |> hd()

  @doc "A port from which on those at all offsets are free, below the ports that systems give to whoever asks for any."
  @spec base_port(Enumerable.t(non_neg_integer())) :: pos_integer()
  def base_port(offsets) do
    base = 10_000 + 2_000 * :rand.uniform(10)
    if Enum.all?(offsets, &free?(base + &1)), do: base, else: base_port(offsets)
  end

  defp free?(port) do
    with {:ok, socket} <- :gen_udp.open(port, ip: {127, 0, 0, 1}),
         do: :gen_udp.close(socket) == :ok,
         else: (_ -> false)
  end

  @doc "A free port of UDP or TCP."
  @spec free_port(:gen_udp | :gen_tcp) :: :inet.port_number()
  def free_port(kind) do
    open = if kind == :gen_udp, do: :open, else: :listen
    {:ok, socket} = apply(kind, open, [0, [ip: {127, 0, 0, 1}]])
    {:ok, port} = :inet.port(socket)
    :ok = kind.close(socket)
    port
  end

  @doc "A VM of its own with a file of this folder compiled in it, for load that must not count as the gateway's."
  @spec vm(String.t()) :: pid()
  def vm(file) do
    args = Enum.flat_map(:code.get_path(), &[~c"-pa", &1])
    {:ok, vm, _node} = :peer.start_link(%{connection: :standard_io, args: args})
    {:ok, _apps} = :peer.call(vm, :application, :ensure_all_started, [:elixir], 60_000)
    [_module | _] = :peer.call(vm, Code, :compile_file, [Path.join(__DIR__, file)], 60_000)
    vm
  end
end
