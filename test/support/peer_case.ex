defmodule Aerie.PeerCase do
  @moduledoc """
  Independent ground stations and routers as peers of a whole gateway: the scripts of `test/peers`, run in the private Python
  environment (`AERIE_VENV`, by default the checkout's `.venv`), and programs on the PATH. Each runs in its own
  operating system process.
  """

  use ExUnit.CaseTemplate

  @root Path.expand("../..", __DIR__)
  @peers Path.join(@root, "test/peers")

  # A whole flight at five times real time takes half a minute; the rest is for busy machines.
  @patience 600_000

  using do
    quote do
      import Aerie.PeerCase
    end
  end

  @files [python: "bin/python", mavproxy: "bin/mavproxy.py", mavsdk: "lib/python*/site-packages/mavsdk"]
  @programs [
    mavlink_router: "mavlink-routerd",
    mavp2p: "mavp2p",
    promtool: "promtool",
    schemathesis: "schemathesis",
    betaflight: "betaflight_SITL",
    inav: "inav_SITL",
    curl: "curl"
  ]

  # In the checkout; bin/lib/go.sh makes it.
  @made [go: ".go/command"]

  @doc "Tags of tests whose peers are not installed."
  @spec missing() :: [atom()]
  def missing, do: Keyword.keys(absent())

  @doc "Prints at the end of the run which peers were missing, and where they were expected."
  @spec say_missing() :: :ok
  def say_missing do
    for {tag, place} <- absent(),
        do: ExUnit.after_suite(fn _result -> IO.puts("\nNot tested against #{tag}: found no #{place}.") end)

    :ok
  end

  @doc """
  The tag of a test of this peer that only `bin/test --full` runs. Without the peer it is not `:long`, because a tag
  that is included overrides the others of its test.
  """
  @spec long(atom()) :: atom()
  def long(peer), do: if(peer in missing(), do: peer, else: :long)

  defp absent do
    files =
      for {tag, file} <- @files,
          Path.wildcard(Path.join(venv(), file)) == [],
          do: {tag, Path.join(venv(), file)}

    made =
      for {tag, file} <- @made,
          not File.exists?(Path.join(@root, file)),
          do: {tag, "#{Path.join(@root, file)}, which bin/setup --tests makes if a go is on the PATH"}

    programs =
      for {tag, name} <- @programs, System.find_executable(name) == nil, do: {tag, "#{name} on the PATH"}

    files ++ made ++ programs
  end

  defp venv, do: System.get_env("AERIE_VENV", Path.join(@root, ".venv"))

  @doc """
  Starts a script, with further environment variables; it ends with the test. It makes pymavlink start with MAVLink 2:
  otherwise pymavlink starts with MAVLink 1 and resets its state with the first MAVLink 2 frame, at an arbitrary moment.
  """
  @spec start_peer(String.t(), [term()], %{String.t() => String.t()}) :: port()
  def start_peer(script, arguments, environment \\ %{}),
    do:
      start(
        Path.join(venv(), "bin/python"),
        ["-u", Path.join(@peers, script) | arguments],
        Map.put_new(environment, "MAVLINK20", "1")
      )

  @doc "Starts a program on the PATH; it ends with the test. The calling process gets its output."
  @spec start_program(String.t(), [term()]) :: port()
  def start_program(name, arguments), do: start(System.find_executable(name), arguments, %{})

  defp start(program, arguments, environment) do
    environment = for {name, value} <- environment, do: {String.to_charlist(name), String.to_charlist(value)}
    arguments = Enum.map(arguments, &to_string/1)
    options = [:binary, :exit_status, :stderr_to_stdout, args: arguments, env: environment]
    peer = Port.open({:spawn_executable, program}, options)
    {:os_pid, pid} = Port.info(peer, :os_pid)
    ExUnit.Callbacks.on_exit(fn -> System.cmd("kill", ["-9", "#{pid}"], stderr_to_stdout: true) end)
    peer
  end

  @doc "Gives a script that is told what to do a line of JSON, and returns its answer."
  @spec ask(port(), map()) :: map()
  def ask(peer, order) do
    Port.command(peer, [JSON.encode!(order), "\n"])
    answer(peer, "")
  end

  defp answer(peer, output) do
    case Regex.run(~r/^answer (.*)\n/m, output) do
      [_line, json] ->
        JSON.decode!(json)

      nil ->
        receive do
          {^peer, {:data, bytes}} -> answer(peer, output <> bytes)
          {^peer, {:exit_status, status}} -> gone(status, output)
        after
          @patience -> ExUnit.Assertions.flunk("the peer does not answer; its output:\n#{output}")
        end
    end
  end

  @doc "Waits for the end of a script and returns its findings by name. If the script failed, the test fails with its output."
  @spec findings(port()) :: %{String.t() => String.t()}
  def findings(peer), do: collect(peer, "")

  defp collect(peer, output) do
    receive do
      {^peer, {:data, bytes}} ->
        collect(peer, output <> bytes)

      {^peer, {:exit_status, 0}} ->
        for line <- String.split(output, "\n", trim: true),
            [name, value] <- [String.split(line, " ", parts: 2)],
            into: %{},
            do: {name, value}

      {^peer, {:exit_status, status}} ->
        gone(status, output)
    after
      @patience -> ExUnit.Assertions.flunk("the peer does not end; its output:\n#{output}")
    end
  end

  defp gone(status, output),
    do: ExUnit.Assertions.flunk("the peer ended with status #{status}:\n#{output}")
end
