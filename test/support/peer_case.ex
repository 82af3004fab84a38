defmodule Aerie.PeerCase do
  @moduledoc """
  Ground stations and routers that are not ours, as peers of a whole gateway: the scripts of `test/peers`, run in the
  private Python environment (`AERIE_VENV`, else `.venv` of the checkout), and programs that are on the PATH of who has
  them, each in an operating-system process of its own.
  """

  use ExUnit.CaseTemplate

  @root Path.expand("../..", __DIR__)
  @peers Path.join(@root, "test/peers")

  # A whole flight at five times real time takes half a minute; the rest is for machines that are busy.
  @patience 600_000

  using do
    quote do
      import Aerie.PeerCase
    end
  end

  @files [python: "bin/python", mavproxy: "bin/mavproxy.py", mavsdk: "lib/python*/site-packages/mavsdk"]
  @programs [mavlink_router: "mavlink-routerd", mavp2p: "mavp2p"]

  @doc "Tags of tests whose peers are not installed."
  @spec missing() :: [atom()]
  def missing, do: Keyword.keys(absent())

  @doc "Lets the end of the run say which peers were not there, and where they were looked for."
  @spec say_missing() :: :ok
  def say_missing do
    for {tag, place} <- absent(),
        do:
          ExUnit.after_suite(fn _result -> IO.puts("\nNot tested against #{tag}: there is no #{place}.") end)

    :ok
  end

  defp absent do
    files =
      for {tag, file} <- @files,
          Path.wildcard(Path.join(venv(), file)) == [],
          do: {tag, Path.join(venv(), file)}

    programs =
      for {tag, name} <- @programs, System.find_executable(name) == nil, do: {tag, "#{name} on the PATH"}

    files ++ programs
  end

  defp venv, do: System.get_env("AERIE_VENV", Path.join(@root, ".venv"))

  @doc """
  Starts a script, with further variables of the environment; it ends with the test. pymavlink begins with MAVLink 2: by
  itself it begins with MAVLink 1 and makes everything anew with the first frame of the other, at whatever moment that comes.
  """
  @spec start_peer(String.t(), [term()], %{String.t() => String.t()}) :: port()
  def start_peer(script, arguments, environment \\ %{}),
    do:
      start(
        Path.join(venv(), "bin/python"),
        ["-u", Path.join(@peers, script) | arguments],
        Map.put_new(environment, "MAVLINK20", "1")
      )

  @doc "Starts a program of the PATH; it ends with the test. What it prints comes to the calling process."
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

  @doc "Waits for the end of a script: what it found, by name. A script that ended badly fails the test with its words."
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
        ExUnit.Assertions.flunk("the peer ended with status #{status}:\n#{output}")
    after
      @patience -> ExUnit.Assertions.flunk("the peer does not end; it said:\n#{output}")
    end
  end
end
