defmodule Gnat.ConnectionSupervisor do
  @moduledoc """
  Keeps a connection under a name, and reconnects when it is lost.

      {Gnat.ConnectionSupervisor,
       %{
         name: MyApp.Nats,
         connection_settings: [%{host: "10.0.0.100"}, %{host: "10.0.0.101"}],
         backoff_period: 2_000
       }}

  It starts at once, with or without a server. The name belongs to the connection process and exists while there is a
  connection: `Gnat.pub(MyApp.Nats, ...)` works then and returns `{:error, %Gnat.Error{reason: :not_connected}}` at
  other times. Any name of a GenServer will do, `{:via, Registry, {registry, key}}` too.

    * `name` - required
    * `connection_settings` - required, a list of settings for `Gnat.start_link/1`; they are tried in turn, starting at a
      random one
    * `backoff_period` - ms, default 2000. The first try has no wait; after all servers have failed, the next round waits so
      long, or up to a half less, so that clients do not come all at once. A connection that lasted less than a second counts
      as a failed try, so that a server that accepts and drops clients causes no busy loop

  Subscriptions belong to a connection and end with it. `Gnat.ConsumerSupervisor` renews them; other
  processes must monitor the connection.

  Telemetry: `[:gnat, :connection, :up]` (metadata `name`, `host`, `port`), `[:gnat, :connection, :down]` (`name`,
  `reason`), `[:gnat, :connection, :failed]` (`name`, `host`, `port`, `reason`; measurement `retry_in` in ms).
  """

  use GenServer

  alias Gnat.{Backoff, Connection, Error, Handshake, Transport}

  require Logger

  @stable_after 1_000

  @type settings :: %{
          required(:name) => GenServer.name(),
          required(:connection_settings) => [Gnat.connection_settings(), ...],
          optional(:backoff_period) => pos_integer()
        }

  @spec start_link(settings(), GenServer.options()) :: GenServer.on_start()
  def start_link(settings, options \\ []), do: GenServer.start_link(__MODULE__, settings, options)

  @impl GenServer
  def init(settings) do
    Process.flag(:trap_exit, true)
    Process.set_label({:gnat_connection_supervisor, settings.name})
    period = settings[:backoff_period] || 2_000
    servers = Map.fetch!(settings, :connection_settings)

    state = %{
      name: Map.fetch!(settings, :name),
      servers: rotate(servers, :rand.uniform(length(servers)) - 1),
      untried: length(servers),
      backoff: Backoff.new(period, period),
      attempt: nil,
      gnat: nil,
      up_since: nil,
      quiet: false
    }

    {:ok, schedule(state)}
  end

  @impl GenServer
  def handle_info(:attempt, %{servers: [server | _]} = state) do
    # Connecting takes time, and this process must be able to shut down meanwhile.
    owner = self()

    attempt =
      Task.async(fn ->
        with {:ok, handshake} <- Handshake.connect(server),
             :ok <- Transport.give(handshake.transport, owner),
             do: {:ok, handshake}
      end)

    {:noreply, %{state | attempt: attempt}}
  end

  def handle_info({ref, result}, %{attempt: %Task{ref: ref}} = state) do
    Process.demonitor(ref, [:flush])
    {:noreply, attempted(result, %{state | attempt: nil})}
  end

  def handle_info({:DOWN, ref, :process, _pid, reason}, %{attempt: %Task{ref: ref}} = state) do
    {:noreply, attempted({:error, reason}, %{state | attempt: nil})}
  end

  def handle_info({:EXIT, pid, reason}, %{gnat: pid} = state) do
    {:noreply, lost(reason, %{state | gnat: nil})}
  end

  # The task's end, or a message nobody waits for any more.
  def handle_info(_other, state), do: {:noreply, state}

  # A crash report or :sys.get_status/1 shows no secrets.
  @impl GenServer
  def format_status(status) do
    Map.replace_lazy(status, :state, fn state -> %{state | servers: Enum.map(state.servers, &place/1)} end)
  end

  @impl GenServer
  def terminate(_reason, %{attempt: %Task{} = attempt}), do: Task.shutdown(attempt, :brutal_kill)
  def terminate(_reason, %{gnat: gnat}) when is_pid(gnat), do: Gnat.stop(gnat)
  def terminate(_reason, _state), do: :ok

  defp attempted({:ok, handshake}, state) do
    case Connection.start_link(handshake, name: state.name) do
      {:ok, gnat} -> up(gnat, state)
      {:error, reason} -> failed(reason, state)
    end
  end

  defp attempted({:error, reason}, state), do: failed(reason, state)

  defp up(gnat, %{servers: [server | _]} = state) do
    :telemetry.execute([:gnat, :connection, :up], %{count: 1}, Map.merge(place(server), %{name: state.name}))
    Logger.info("NATS: connected to #{show(server)}")
    now = System.monotonic_time(:millisecond)
    %{state | gnat: gnat, up_since: now, untried: length(state.servers), quiet: false}
  end

  defp lost(reason, state) do
    reason = error(reason)
    :telemetry.execute([:gnat, :connection, :down], %{count: 1}, %{name: state.name, reason: reason})
    Logger.warning("NATS: connection lost, reconnecting: #{describe(reason)}")
    lived = System.monotonic_time(:millisecond) - state.up_since
    backoff = if lived >= @stable_after, do: Backoff.reset(state.backoff), else: state.backoff
    schedule(%{state | backoff: backoff})
  end

  defp failed(reason, %{servers: [server | rest]} = state) do
    reason = error(reason)
    {state, wait} = next(%{state | servers: rest ++ [server], untried: state.untried - 1})
    metadata = Map.merge(place(server), %{name: state.name, reason: reason})
    :telemetry.execute([:gnat, :connection, :failed], %{count: 1, retry_in: wait}, metadata)

    # Logged once for each outage; telemetry has every try.
    unless state.quiet, do: Logger.warning("NATS: #{show(server)}: #{describe(reason)}; retrying")
    %{state | quiet: true}
  end

  # The other servers are tried without a wait, but each only once.
  defp next(%{untried: untried} = state) when untried > 0 do
    send(self(), :attempt)
    {state, 0}
  end

  defp next(state) do
    {wait, backoff} = Backoff.next(state.backoff, :rand.uniform())
    Process.send_after(self(), :attempt, wait)
    {%{state | backoff: backoff, untried: length(state.servers)}, wait}
  end

  defp schedule(state) do
    {state, _wait} = next(%{state | untried: 0})
    state
  end

  defp rotate(list, count) do
    {front, back} = Enum.split(list, count)
    back ++ front
  end

  defp error({:shutdown, %Error{} = error}), do: error
  defp error(other), do: other

  defp describe(%Error{} = error), do: Exception.message(error)
  defp describe(other), do: inspect(other)

  defp place(server), do: %{host: Map.get(server, :host, "localhost"), port: Map.get(server, :port, 4222)}

  defp show(server) do
    %{host: host, port: port} = place(server)
    if is_tuple(host), do: "#{:inet.ntoa(host)}:#{port}", else: "#{host}:#{port}"
  end
end
