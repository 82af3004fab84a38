defmodule Aerie.Fleet.Bridge.NatsServer do
  @moduledoc """
  Embedded mode: runs nats-server and keeps it running.

  The folder `nats.store_dir` has its configuration (`nats.conf`, written at each start), its JetStream data (`data/`),
  its log (`nats-server.log`, bounded, repetitions left out), its process id, its login (`token`) and its address with the login (`url`). Only their
  owner can read them. A server that ends is restarted, at first immediately, then with growing pauses. A process that an
  earlier gateway left behind is ended first. A missing program, an unusable folder or a taken port is logged once and retried;
  meanwhile the gateway runs without NATS. A server that runs but stores nothing, as after a full disk, is restarted
  when the disk has room (`Aerie.Fleet.Bridge.NatsServer.RestartPolicy`); one that is still reading its store is left alone for five minutes.

  `Aerie.Fleet.Bridge.info/1` has its address and status; changes also go to subscribers of `:bridge` and to
  telemetry (`[:aerie, :bridge, :server, :up | :down]`).
  """
  use GenServer

  alias Aerie.Base.Timing.Backoff
  alias Aerie.Fleet.Bridge.Leaf
  alias Aerie.Fleet.Bridge.NatsServer.Token
  alias Aerie.Fleet.Bridge.Status.Tables
  alias Aerie.Fleet.Bridge.NatsServer.{LogFile, LogLine, OsProcess, RestartPolicy, Settings}
  alias Aerie.Base.Files.FolderLock
  alias Aerie.Base.Files.{Disk, Private}
  alias Aerie.Base.Names
  alias Aerie.Fleet.Bridge

  require Logger

  # Fifths of a second until it is killed.
  @stop_tries 15
  # On so few processors the server gets one. With more, Go's scheduler wakes further threads for each message, which
  # is half of the system calls of an idle server.
  @few 4
  # A server that was up for this long was healthy: its end is a new fault, so the pauses start over.
  @healthy_ms 5_000
  # It gets TERM, is killed after three seconds, and on a busy machine gone some seconds later. The VM must not leave
  # it behind.
  @stop_ms 15_000
  @max_port_tries 100
  # How often the disk is checked while the server stores nothing.
  @look_ms 2_000
  # A server that starts reads its store before it accepts connections, which takes long on a slow disk.
  @starting_ms 300_000
  # A server that has just come up is not blamed for earlier waits of its clients.
  @settled_ms 10_000

  @spec start_link(gateway: Names.gateway(), settings: Bridge.Settings.t()) :: GenServer.on_start()
  def start_link(options) do
    GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :bridge_server))
  end

  def child_spec(options),
    do: %{id: __MODULE__, start: {__MODULE__, :start_link, [options]}, shutdown: @stop_ms + 3_000}

  @doc "The server hangs: it answers no events, or accepts no connection. `text` is for the log."
  @spec stalled(Names.gateway(), String.t()) :: :ok
  def stalled(gateway, text) do
    # Only the embedded server can be restarted.
    if pid = Names.whereis(gateway, :bridge_server), do: send(pid, {:stalled, text})
    :ok
  end

  @impl GenServer
  def init(options) do
    Process.flag(:trap_exit, true)
    gateway = options[:gateway]
    %Bridge.Settings{} = settings = Keyword.fetch!(options, :settings)
    Process.set_label({:bridge_server, gateway})
    Logger.metadata(gateway: inspect(gateway))

    {:ok,
     %{
       gateway: gateway,
       tables: Tables.get(gateway),
       nats: %{settings.nats | store_dir: Path.expand(settings.nats.store_dir)},
       port_given: settings.port_given,
       wanted_port: settings.nats.port,
       tcp_port: settings.nats.port,
       port: nil,
       status: :starting,
       started_at: nil,
       up_at: nil,
       log: %LogFile{},
       repeats: %{},
       backoff: Backoff.new(settings.nats.retry_min_ms, settings.nats.retry_max_ms),
       restarts: 0,
       restart_policy: RestartPolicy.new(),
       last_problem: nil
     }, {:continue, :start}}
  end

  @impl GenServer
  def handle_continue(:start, state), do: {:noreply, start(state)}

  @impl GenServer
  def handle_info(:start, state), do: {:noreply, start(state)}

  def handle_info({port, {:data, {_eol, line}}}, %{port: port} = state), do: {:noreply, line(line, state)}

  def handle_info({port, {:exit_status, status}}, %{port: port} = state) do
    Logger.error("nats-server ended (status #{status}); restarting it")
    up_ms = now() - state.started_at
    backoff = if up_ms >= @healthy_ms, do: Backoff.reset(state.backoff), else: state.backoff

    :telemetry.execute([:aerie, :bridge, :server, :down], %{up_ms: up_ms}, %{
      gateway: state.gateway,
      status: status
    })

    Tables.count(state.tables, :server_restarts)
    _ = LogFile.close(state.log)
    state = %{state | port: nil, backoff: backoff, restarts: state.restarts + 1}
    {:noreply, state |> put_info(:down) |> start_later()}
  end

  def handle_info({:stalled, text}, state),
    do: {:noreply, if(settled?(state), do: fault(text, state), else: state)}

  def handle_info(:look, %{port: port, restart_policy: %{fault: text}} = state)
      when port != nil and text != nil do
    case RestartPolicy.check(
           state.restart_policy,
           now(),
           Disk.free(state.nats.store_dir)
         ) do
      {:restart, restart_policy} ->
        Logger.error("nats-server does not work (#{text}); restarting it")
        OsProcess.stop(port)
        {:noreply, %{state | restart_policy: restart_policy}}

      {:wait, restart_policy} ->
        Process.send_after(self(), :look, @look_ms)
        {:noreply, %{state | restart_policy: restart_policy}}
    end
  end

  # A late line or exit of a former server.
  def handle_info(_message, state), do: {:noreply, state}

  @impl GenServer
  def terminate(_reason, %{port: nil}), do: :ok

  def terminate(_reason, %{port: port} = state) do
    OsProcess.stop(port)

    receive do
      {^port, {:exit_status, _status}} -> :ok
    after
      @stop_ms -> Logger.error("nats-server did not end within #{@stop_ms} ms")
    end

    LogFile.close(state.log)
  end

  defp start(state) do
    with :ok <- FolderLock.acquire(state.nats.store_dir),
         {:ok, program} <- program(state.nats.binary),
         conf = Path.join(state.nats.store_dir, "nats.conf"),
         _ = end_leftover(state, conf),
         {:ok, tcp_port} <- free_port(state),
         {:ok, token} <- Token.fetch(state.nats),
         {:ok, seed} <- Leaf.Config.seed(state.nats.leaf),
         :ok <- write(conf, state |> settings(tcp_port, token) |> Map.put(:seed, seed)) do
      port = OsProcess.start(program, ["-c", conf], @stop_tries, scheduling())
      log = LogFile.open(Path.join(state.nats.store_dir, "nats-server.log"))
      started_at = now()
      state = %{state | port: port, tcp_port: tcp_port, log: log, started_at: started_at}
      put_info(%{state | restart_policy: RestartPolicy.started(state.restart_policy)}, :starting)
    else
      {:error, problem} -> problem(state, problem)
    end
  end

  defp scheduling do
    if System.schedulers_online() <= @few and System.get_env("GOMAXPROCS") == nil,
      do: [{~c"GOMAXPROCS", ~c"1"}],
      else: []
  end

  defp program(binary) do
    case System.find_executable(binary) do
      nil -> {:error, "cannot find the program #{binary}: run bin/setup, or set nats.binary or nats.url"}
      program -> {:ok, program}
    end
  end

  defp end_leftover(state, conf) do
    if OsProcess.end_leftover(Path.join(state.nats.store_dir, "nats-server.pid"), conf) do
      Logger.warning("ended a nats-server that an earlier gateway had left behind")
    end
  end

  defp settings(state, tcp_port, token) do
    nats = Map.take(state.nats, [:address, :store_dir, :max_memory_mb, :max_store_mb, :domain, :leaf])
    name = "aerie-#{:erlang.phash2(state.nats.store_dir)}"
    Map.merge(nats, %{name: name, port: tcp_port, token: token})
  end

  defp write(conf, settings) do
    case Private.write(conf, Settings.render(settings)) do
      :ok -> :ok
      {:error, reason} -> {:error, "cannot write #{conf}: #{:file.format_error(reason)}"}
    end
  end

  # The port of the last run is kept if it is free, so that clients find the server again.
  defp free_port(%{tcp_port: 0}), do: {:ok, 0}

  # `nats.port: 0`: any port will do.
  defp free_port(%{wanted_port: 0} = state) do
    if try_port(state, state.tcp_port) == :ok, do: {:ok, state.tcp_port}, else: {:ok, 0}
  end

  defp free_port(%{port_given: true} = state) do
    case try_port(state, state.tcp_port) do
      :ok ->
        {:ok, state.tcp_port}

      {:error, reason} ->
        {:error, "nats.port #{state.tcp_port} cannot be opened: #{:inet.format_error(reason)}"}
    end
  end

  defp free_port(state) do
    candidates = Enum.filter(state.tcp_port..(state.tcp_port + @max_port_tries), &(&1 <= 65_535))

    case Enum.find(candidates, &(try_port(state, &1) == :ok)) do
      nil -> {:error, "no free port for NATS from #{state.tcp_port} on"}
      port -> {:ok, port}
    end
  end

  defp try_port(state, port) do
    {:ok, ip} = :inet.parse_strict_address(String.to_charlist(state.nats.address))
    family = if tuple_size(ip) == 8, do: [:inet6], else: []

    with {:ok, socket} <- :gen_tcp.listen(port, [{:ip, ip}, {:reuseaddr, true} | family]) do
      :gen_tcp.close(socket)
    end
  end

  defp problem(state, problem) do
    # Logged once, not at every attempt.
    if problem != state.last_problem, do: Logger.error("the embedded NATS server cannot start: #{problem}")
    %{state | last_problem: problem} |> put_info({:failed, problem}) |> start_later()
  end

  defp start_later(state) do
    {delay, backoff} = Backoff.next(state.backoff)
    Process.send_after(self(), :start, delay)
    %{state | backoff: backoff}
  end

  defp line(line, state) do
    {level, text, fact} = LogLine.parse(line)
    {left_out, repeats} = LogLine.observe(state.repeats, text, now())
    fact(fact, log(%{state | repeats: repeats}, level, line, text, left_out))
  end

  defp log(state, _level, _line, _text, nil), do: state

  defp log(state, level, line, text, left_out) do
    more = if left_out > 0, do: " (#{left_out} more like it in the meantime)"
    Logger.log(level, "nats-server: #{text}#{more}")
    %{state | log: LogFile.write(state.log, "#{line}#{more}")}
  end

  defp fact({:listening, tcp_port}, state), do: %{state | tcp_port: tcp_port}

  defp fact(:ready, state) do
    if state.restarts == 0,
      do:
        Logger.info(
          "NATS server on #{url(state)}; its address with the login is in #{Token.url_file(state.nats)}"
        )

    # The file exists before the notice that the server is up.
    write_url(state)
    state = put_info(%{state | last_problem: nil, up_at: now()}, :up)

    :telemetry.execute([:aerie, :bridge, :server, :up], %{restarts: state.restarts}, %{
      gateway: state.gateway,
      url: url(state)
    })

    state
  end

  defp fact({:write_error, text}, state), do: fault(text, state)

  # A connection is there before the hub refuses its login, so the last problem stays known.
  defp fact({:leaf, problem}, state) do
    leaf =
      if problem,
        do: %{problem: problem, connected_at: nil},
        else: %{problem: Tables.info(state.tables, :leaf)[:problem], connected_at: now()}

    Tables.put_info(state.gateway, state.tables, :leaf, leaf)
    state
  end

  # Another program took the port between our check and the server's start. The next start checks again.
  defp fact(:port_taken, state), do: state
  defp fact(nil, state), do: state

  defp settled?(%{port: nil}), do: false
  defp settled?(%{status: :starting} = state), do: now() - state.started_at >= @starting_ms
  defp settled?(state), do: now() - state.up_at >= @settled_ms

  defp fault(_text, %{restart_policy: %{fault: known}} = state) when known != nil, do: state

  defp fault(text, state) do
    Logger.error("nats-server does not work: #{text}; it is restarted when its disk has room")
    Process.send_after(self(), :look, @look_ms)
    put_info(%{state | restart_policy: RestartPolicy.fault(state.restart_policy, text)}, state.status)
  end

  defp write_url(state) do
    with {:ok, token} <- Token.read(state.nats), :ok <- Token.put_url(state.nats, url(state), token) do
      :ok
    else
      {:error, text} -> Logger.error("cannot write the address of the NATS server: #{text}")
    end
  end

  defp put_info(state, status) do
    info = %{
      status: status,
      url: if(status == :up, do: url(state)),
      port: if(status == :up, do: state.tcp_port),
      store_dir: state.nats.store_dir,
      restarts: state.restarts,
      fault: state.restart_policy.fault
    }

    Tables.put_info(state.gateway, state.tables, :server, info)
    %{state | status: status}
  end

  defp now, do: System.monotonic_time(:millisecond)

  defp url(state) do
    host =
      if String.contains?(state.nats.address, ":"), do: "[#{state.nats.address}]", else: state.nats.address

    "nats://#{host}:#{state.tcp_port}"
  end
end
