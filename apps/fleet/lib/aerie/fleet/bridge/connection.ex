defmodule Aerie.Fleet.Bridge.Connection do
  @moduledoc """
  Keeps one connection to NATS: connects, creates the streams, notifies the publishers, and reconnects after a loss.

  `Aerie.Fleet.Bridge.Connection.Machine` decides, this process acts. The publishers get `{:bridge, :up, conn}` when a connection is up
  and its streams were checked, and `{:bridge, :down}` when it is lost; `current/1` has the present state. An attempt blocks
  only this process.
  """
  use GenServer

  alias Aerie.Fleet.Bridge.Connection.{Machine, Settings}
  alias Aerie.Fleet.Bridge.{NatsServer, Streams}
  alias Aerie.Fleet.Bridge.Status.Tables
  alias Aerie.Base.Names
  alias Aerie.Fleet.{Bridge, Nats}
  alias Aerie.Base.PubSub

  require Logger

  @streams_retry_ms 5_000
  # An embedded server that accepts no connection for so long hangs.
  @hangs_ms 10_000
  # Somebody may delete a stream of which this gateway uses little.
  @streams_look_ms 15_000
  @publishers [:bridge_state, :bridge_events, :bridge_commands]

  @spec start_link(gateway: Names.gateway(), settings: Bridge.Settings.t()) :: GenServer.on_start()
  def start_link(options) do
    GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :bridge_connection))
  end

  @doc "The connection that publishers may use, or nil. `streams: :ok` if JetStream is usable too."
  @spec current(Tables.t()) :: %{conn: pid(), streams: :ok | :error} | nil
  def current(tables) do
    case Tables.info(tables, :connection) do
      %{status: :up, conn: conn, streams: streams} -> %{conn: conn, streams: streams}
      _ -> nil
    end
  end

  @impl GenServer
  def init(options) do
    Process.flag(:trap_exit, true)
    gateway = options[:gateway]
    %Bridge.Settings{} = settings = Keyword.fetch!(options, :settings)
    Process.set_label({:bridge_connection, gateway})
    Logger.metadata(gateway: inspect(gateway))
    # The embedded server's address comes and changes.
    :ok = PubSub.subscribe(gateway, :bridge)

    state = %{
      gateway: gateway,
      settings: settings,
      tables: Tables.get(gateway),
      machine: Machine.new(settings.nats.retry_min_ms, settings.nats.retry_max_ms),
      conn: nil,
      up_at: nil,
      down_at: now(),
      timer: nil,
      streams_timer: nil
    }

    {:ok, put_info(state, :down, :error), {:continue, :start}}
  end

  @impl GenServer
  def handle_continue(:start, state) do
    {:noreply, event({:urls, urls(state)}, state)}
  end

  defp urls(%{settings: %{nats: %{mode: :url, url: urls}}}), do: urls
  defp urls(%{tables: tables}), do: tables |> Tables.info(:server) |> Map.get(:url) |> List.wrap()

  @impl GenServer
  def handle_info({:fleet, :bridge, {:server, %{status: :up, fault: nil, url: url}}}, state),
    do: {:noreply, event({:urls, [url]}, %{state | down_at: now()})}

  def handle_info(:retry, state), do: {:noreply, event(:retry, %{state | timer: nil})}

  def handle_info({:EXIT, conn, reason}, %{conn: conn} = state) when conn != nil do
    up_ms = now() - state.up_at
    notify(state, {:bridge, :down})

    :telemetry.execute([:aerie, :bridge, :disconnected], %{up_ms: up_ms}, %{
      gateway: state.gateway,
      reason: Nats.text(reason)
    })

    Tables.count(state.tables, :disconnects)
    state = event({:closed, Nats.text(reason), up_ms}, %{state | conn: nil, down_at: now()})
    {:noreply, put_info(state, :down, :error)}
  end

  def handle_info(:check_streams, %{conn: conn} = state) when conn != nil do
    # Every refused event asks for a check; one is enough for all.
    flush_checks()
    {:noreply, ensure_streams(state)}
  end

  def handle_info(_message, state), do: {:noreply, state}

  defp event(event, state) do
    {machine, actions} = Machine.handle(state.machine, event)
    Enum.reduce(actions, %{state | machine: machine}, &action/2)
  end

  defp action({:log, level, text}, state) do
    Logger.log(level, text)
    state
  end

  defp action({:timer, ms}, state), do: %{state | timer: Process.send_after(self(), :retry, ms)}
  defp action(:cancel_timer, %{timer: nil} = state), do: state

  defp action(:cancel_timer, state) do
    _ = Process.cancel_timer(state.timer)
    %{state | timer: nil}
  end

  defp action({:connect, url}, state) do
    with {:ok, settings} <- Settings.gnat(state.settings, url),
         {:ok, conn} <- Nats.connect(settings) do
      state = %{state | conn: conn, up_at: now()}
      :telemetry.execute([:aerie, :bridge, :connected], %{count: 1}, %{gateway: state.gateway, url: url})
      Tables.count(state.tables, :connects)
      ensure_streams(event(:connected, state))
    else
      {:error, reason} ->
        if now() - state.down_at >= @hangs_ms,
          do: NatsServer.stalled(state.gateway, "it accepts no connection")

        put_info(event({:failed, Nats.text(reason)}, state), :down, :error)
    end
  end

  defp ensure_streams(state) do
    {result, report} = Streams.ensure(state.conn, state.settings)
    made_at = Streams.state_made_at(state.conn)

    # If the connection was lost meanwhile, the report says nothing about the streams; the exit message is on its way.
    if Process.alive?(state.conn), do: streams_known(state, result, report, made_at), else: state
  end

  defp streams_known(state, result, report, made_at) do
    before = Tables.info(state.tables, :streams)

    if report != before[:report],
      do: Enum.each(report, &log_stream/1)

    _ = if state.streams_timer, do: Process.cancel_timer(state.streams_timer)
    pause = if result == :error, do: @streams_retry_ms, else: @streams_look_ms
    timer = Process.send_after(self(), :check_streams, pause)

    Tables.put_info(state.gateway, state.tables, :streams, %{
      result: result,
      report: report,
      state_made_at: made_at || before[:state_made_at]
    })

    state = put_info(%{state | streams_timer: timer}, :up, result)
    notify(state, {:bridge, :up, state.conn})
    state
  end

  defp flush_checks do
    receive do
      :check_streams -> flush_checks()
    after
      0 -> :ok
    end
  end

  defp log_stream({name, {:error, reason}}),
    do: Logger.error("stream #{name} cannot be used, events wait in the outbox: #{reason}")

  defp log_stream({name, {:differs, list}}),
    do: Logger.warning("stream #{name} is not as configured: #{Enum.join(list, "; ")}")

  defp log_stream({_name, _usable}), do: :ok

  defp notify(state, message) do
    for role <- @publishers, pid = Names.whereis(state.gateway, role), do: send(pid, message)
    :ok
  end

  defp put_info(state, status, streams) do
    info = %{
      status: status,
      conn: state.conn,
      streams: streams,
      url: if(state.conn, do: url(state.machine)),
      problem: Machine.problem(state.machine)
    }

    Tables.put_info(state.gateway, state.tables, :connection, info)
    state
  end

  defp now, do: System.monotonic_time(:millisecond)

  defp url(machine),
    do: Enum.at(machine.urls, rem(max(machine.attempts - 1, 0), max(length(machine.urls), 1)))
end
