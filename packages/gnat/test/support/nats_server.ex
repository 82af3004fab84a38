defmodule Gnat.Test.NatsServer do
  @moduledoc """
  A real nats-server for a test, on a port of its own and with a directory of its own.

      server = start_supervised!({NatsServer, jetstream: true})
      {:ok, gnat} = Gnat.start_link(NatsServer.settings(server))

    * `jetstream: true`
    * `config: text` or `config: (dir -> text)` - a configuration file; `files: %{name => content}` are put beside it

  It runs under a small shell that waits for its own input to end and then kills the server and removes the
  directory: however this VM ends, nothing stays behind. `kill/1` is a `kill -9`; `start/1` starts it again on the same
  port with the same data.
  """

  use GenServer, restart: :temporary

  @wrapper """
  dir=$1; shift
  "$@" </dev/null 2>&1 &
  pid=$!
  while read -r word; do
    case $word in
      kill) kill -9 $pid 2>/dev/null; break;;
      freeze) kill -STOP $pid;;
      thaw) kill -CONT $pid;;
    esac
  done
  kill -9 $pid 2>/dev/null
  wait $pid 2>/dev/null
  if [ "$word" != kill ]; then rm -rf "$dir"; fi
  """

  def start_link(opts), do: GenServer.start_link(__MODULE__, opts)

  @doc "Connection settings for it, with patience for a busy machine."
  def settings(server, more \\ %{}) do
    Map.merge(%{host: "127.0.0.1", port: port(server), connection_timeout: 60_000}, more)
  end

  def port(server), do: call(server, :port)
  def dir(server), do: call(server, :dir)

  @doc "kill -9; returns when it is dead."
  def kill(server), do: call(server, :kill)

  @doc "Starts it again after `kill/1`; returns when it is ready."
  def start(server), do: call(server, :start)

  @doc "SIGSTOP: the connections stay and nothing answers."
  def freeze(server), do: call(server, {:word, "freeze"})
  def thaw(server), do: call(server, {:word, "thaw"})

  # The server itself gives up what takes a minute, and says what it was.
  defp call(server, message), do: GenServer.call(server, message, :infinity)

  @impl GenServer
  def init(opts) do
    Process.flag(:trap_exit, true)
    dir = Path.join(System.tmp_dir!(), "gnat-test-#{System.pid()}-#{System.unique_integer([:positive])}")
    File.mkdir_p!(dir)
    for {name, content} <- opts[:files] || %{}, do: File.write!(Path.join(dir, name), content)

    args =
      case opts[:config] do
        nil ->
          []

        config ->
          text = if is_function(config), do: config.(dir), else: config
          File.write!(Path.join(dir, "server.conf"), text)
          ["-c", Path.join(dir, "server.conf")]
      end

    jetstream = if opts[:jetstream], do: ["-js", "-sd", Path.join(dir, "store")], else: []
    {:ok, run(%{dir: dir, args: args ++ jetstream, port: nil, wrapper: nil, output: ""})}
  end

  @impl GenServer
  def handle_call(:port, _from, state), do: {:reply, state.port, state}
  def handle_call(:dir, _from, state), do: {:reply, state.dir, state}
  def handle_call(:start, _from, state), do: {:reply, :ok, run(state)}

  def handle_call(:kill, _from, %{wrapper: wrapper} = state) do
    Port.command(wrapper, "kill\n")

    receive do
      {^wrapper, {:exit_status, _status}} -> {:reply, :ok, %{state | wrapper: nil}}
    after
      60_000 -> raise "nats-server was not killed"
    end
  end

  def handle_call({:word, word}, _from, state) do
    Port.command(state.wrapper, word <> "\n")
    {:reply, :ok, state}
  end

  @impl GenServer
  def handle_info({port, {:data, _log}}, %{wrapper: port} = state), do: {:noreply, state}
  def handle_info(_other, state), do: {:noreply, state}

  @impl GenServer
  def terminate(_reason, %{wrapper: nil, dir: dir}), do: File.rm_rf!(dir)

  # The end of its input ends the wrapper; its exit status can then no longer be had, but its death can be awaited by
  # what it does last.
  def terminate(_reason, %{wrapper: wrapper, dir: dir}) do
    Port.close(wrapper)
    Gnat.Test.eventually(fn -> not File.exists?(dir) end)
  end

  defp run(%{dir: dir, args: args, port: port} = state) do
    server = System.find_executable("nats-server") || raise "nats-server is not on the PATH"
    command = ["-c", @wrapper, "sh", dir, server, "-a", "127.0.0.1", "-p", to_string(port || -1)] ++ args

    wrapper =
      Port.open({:spawn_executable, "/bin/sh"}, [:binary, :exit_status, :stderr_to_stdout, args: command])

    %{state | wrapper: wrapper, port: await_ready(wrapper, "", port)}
  end

  defp await_ready(wrapper, log, port) do
    receive do
      {^wrapper, {:data, data}} ->
        log = log <> data

        if log =~ "Server is ready" do
          [_, port] = Regex.run(~r/Listening for client connections on \S+:(\d+)/, log)
          String.to_integer(port)
        else
          if log =~ ~r/\[FTL\]|nats-server: /, do: raise("nats-server does not start:\n#{log}")
          await_ready(wrapper, log, port)
        end

      {^wrapper, {:exit_status, status}} ->
        raise "nats-server ended with #{status}:\n#{log}"
    after
      60_000 -> raise "nats-server is not ready:\n#{log}"
    end
  end
end
