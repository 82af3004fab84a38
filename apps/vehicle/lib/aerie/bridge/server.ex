defmodule Aerie.Bridge.Server do
  @moduledoc """
  Embedded mode: runs nats-server and keeps it running.

  The folder `nats.store_dir` has its configuration (`nats.conf`, written at each start), its JetStream data (`data/`),
  its log (`nats-server.log`, bounded), its process id, its login (`token`) and its address with that (`url`), all for
  their owner alone. When it ends, it is started again: at once the first time,
  then with growing pauses. What an earlier life left behind is ended before. A missing program, a folder that cannot
  be used or a taken port is one line in the log, and is tried again: the gateway runs without NATS meanwhile. One that runs
  but stores nothing, as after a full disk, is started again when the disk has room (`Aerie.Bridge.Server.Revival`).

  Where it listens and how it is, is in `Aerie.Bridge.info/1`; changes also go to subscribers of `:bridge` and to
  telemetry (`[:aerie, :bridge, :server, :up | :down]`).
  """
  use GenServer

  alias Aerie.Bridge.{Backoff, Connection, FolderLock, Tables, Token}
  alias Aerie.Bridge.Server.{LogFile, LogLine, OsProcess, Revival, Settings}
  alias Aerie.{Config, Disk, Names, PrivateFile}

  require Logger

  # Up for this long, a server is taken for healthy, and its end for a new misfortune.
  @healthy_ms 5_000
  @stop_ms 5_000
  @max_port_tries 100
  # How often the disk is looked at while the server stores nothing.
  @look_ms 2_000

  @spec start_link(gateway: Names.gateway(), config: Config.t()) :: GenServer.on_start()
  def start_link(options) do
    GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :bridge_server))
  end

  def child_spec(options),
    do: %{id: __MODULE__, start: {__MODULE__, :start_link, [options]}, shutdown: @stop_ms + 3_000}

  @doc "Events that were given to the server are not answered; `text` says since when, for the log."
  @spec stalled(Names.gateway(), String.t()) :: :ok
  def stalled(gateway, text) do
    # A configured server is nobody's to start again.
    if pid = Names.whereis(gateway, :bridge_server), do: send(pid, {:stalled, text})
    :ok
  end

  @impl GenServer
  def init(options) do
    Process.flag(:trap_exit, true)
    gateway = options[:gateway]
    config = options[:config]
    Process.set_label({:bridge_server, gateway})
    Logger.metadata(gateway: inspect(gateway))

    {:ok,
     %{
       gateway: gateway,
       tables: Tables.get(gateway),
       nats: %{config.nats | store_dir: Path.expand(config.nats.store_dir)},
       port_given: Config.given?(config, "nats.port"),
       wanted_port: config.nats.port,
       tcp_port: config.nats.port,
       port: nil,
       status: :starting,
       started_at: nil,
       log: %LogFile{},
       failures: 0,
       restarts: 0,
       revival: Revival.new(),
       last_problem: nil
     }, {:continue, :start}}
  end

  @impl GenServer
  def handle_continue(:start, state), do: {:noreply, start(state)}

  @impl GenServer
  def handle_info(:start, state), do: {:noreply, start(state)}

  def handle_info({port, {:data, {_eol, line}}}, %{port: port} = state), do: {:noreply, line(line, state)}

  def handle_info({port, {:exit_status, status}}, %{port: port} = state) do
    Logger.error("nats-server ended (status #{status}); starting it again")
    up_ms = System.monotonic_time(:millisecond) - state.started_at
    failures = if up_ms >= @healthy_ms, do: 0, else: state.failures

    :telemetry.execute([:aerie, :bridge, :server, :down], %{up_ms: up_ms}, %{
      gateway: state.gateway,
      status: status
    })

    Tables.count(state.tables, :server_restarts)
    _ = LogFile.close(state.log)
    state = %{state | port: nil, failures: failures, restarts: state.restarts + 1}
    {:noreply, state |> put_info(:down) |> again()}
  end

  def handle_info({:stalled, text}, state), do: {:noreply, fault(text, state)}

  def handle_info(:look, %{port: port, revival: %{fault: text}} = state) when port != nil and text != nil do
    case Revival.look(state.revival, System.monotonic_time(:millisecond), Disk.free(state.nats.store_dir)) do
      {:restart, revival} ->
        Logger.error("nats-server stores nothing (#{text}); starting it again")
        OsProcess.stop(port)
        {:noreply, %{state | revival: revival}}

      {:wait, revival} ->
        Process.send_after(self(), :look, @look_ms)
        {:noreply, %{state | revival: revival}}
    end
  end

  # A late line or end of a server that was given up.
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
         :ok <- write(conf, settings(state, tcp_port, token)) do
      port = OsProcess.start(program, ["-c", conf])
      log = LogFile.open(Path.join(state.nats.store_dir, "nats-server.log"))
      started_at = System.monotonic_time(:millisecond)
      state = %{state | port: port, tcp_port: tcp_port, log: log, started_at: started_at}
      put_info(%{state | revival: Revival.started(state.revival)}, :starting)
    else
      {:error, problem} -> problem(state, problem)
    end
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
    nats = Map.take(state.nats, [:address, :store_dir, :max_memory_mb, :max_store_mb])
    name = "aerie-#{:erlang.phash2(state.nats.store_dir)}"
    Map.merge(nats, %{name: name, port: tcp_port, token: token})
  end

  defp write(conf, settings) do
    case PrivateFile.write(conf, Settings.render(settings)) do
      :ok -> :ok
      {:error, reason} -> {:error, "cannot write #{conf}: #{:file.format_error(reason)}"}
    end
  end

  # The port of the last run is kept while it is free, so that clients find the server again.
  defp free_port(%{tcp_port: 0}), do: {:ok, 0}

  # Any port was asked for: it need not be the last one.
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
    # Said once, not at every attempt.
    if problem != state.last_problem, do: Logger.error("the embedded NATS server cannot start: #{problem}")
    %{state | last_problem: problem} |> put_info({:failed, problem}) |> again()
  end

  defp again(state) do
    failures = state.failures + 1

    Process.send_after(
      self(),
      :start,
      Backoff.delay(failures, state.nats.retry_min_ms, state.nats.retry_max_ms)
    )

    %{state | failures: failures}
  end

  defp line(line, state) do
    {level, text, fact} = LogLine.parse(line)
    Logger.log(level, "nats-server: #{text}")
    fact(fact, %{state | log: LogFile.write(state.log, line)})
  end

  defp fact({:listening, tcp_port}, state), do: %{state | tcp_port: tcp_port}

  defp fact(:ready, state) do
    if state.restarts == 0,
      do:
        Logger.info(
          "NATS server on #{url(state)}; its address with the login is in #{Token.url_file(state.nats)}"
        )

    state = put_info(%{state | last_problem: nil}, :up)
    leave_url(state)

    :telemetry.execute([:aerie, :bridge, :server, :up], %{restarts: state.restarts}, %{
      gateway: state.gateway,
      url: url(state)
    })

    Connection.server_up(state.gateway, url(state))
    state
  end

  defp fact({:write_error, text}, state), do: fault(text, state)

  # Somebody took the port between our looking and the server's opening; the next start looks again.
  defp fact(:port_taken, state), do: state
  defp fact(nil, state), do: state

  defp fault(_text, %{port: nil} = state), do: state
  defp fault(_text, %{revival: %{fault: known}} = state) when known != nil, do: state

  defp fault(text, state) do
    Logger.error("nats-server stores nothing: #{text}; it is started again when its disk has room")
    Process.send_after(self(), :look, @look_ms)
    put_info(%{state | revival: Revival.fault(state.revival, text)}, state.status)
  end

  defp leave_url(state) do
    with {:ok, token} <- Token.read(state.nats), :ok <- Token.put_url(state.nats, url(state), token) do
      :ok
    else
      {:error, text} -> Logger.error("the address of the NATS server is not told: #{text}")
    end
  end

  defp put_info(state, status) do
    info = %{
      status: status,
      url: if(status == :up, do: url(state)),
      port: if(status == :up, do: state.tcp_port),
      store_dir: state.nats.store_dir,
      restarts: state.restarts,
      fault: state.revival.fault
    }

    Tables.put_info(state.gateway, state.tables, :server, info)
    %{state | status: status}
  end

  defp url(state) do
    host =
      if String.contains?(state.nats.address, ":"), do: "[#{state.nats.address}]", else: state.nats.address

    "nats://#{host}:#{state.tcp_port}"
  end
end
