defmodule Aerie.Base.Net.UnixSocket.Listener do
  @moduledoc """
  Serves one unix socket: lets clients in, up to a limit, each with a process of its own.

  A socket that cannot be opened (no permission, another program's) is reported once, and tried again every few seconds; the
  rest of the gateway is not affected. A file that somebody removed is made again.

  Telemetry: `[:aerie, :client, :listening]` and `[:aerie, :client, :unavailable]` (metadata `gateway`, `socket`, `path`,
  `reason`), `[:aerie, :client, :refused]` (too many clients).
  """
  use GenServer

  alias Aerie.Base.Net.UnixSocket
  alias Aerie.Base.Store
  alias Aerie.Base.Names

  require Logger

  @retry_ms 5_000

  @doc """
  Options: `:gateway`, `:socket` (`:state` or `:mavlink`), `:path`, `:chosen` (whether
  somebody asked for that place; true), and `:start`, a function that starts the process of
  one client below the right supervisor (`{:error, :max_children}` when there are enough). That process gets the
  connection as the message `{:socket, socket}` when it owns it.
  """
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options) do
    gateway = Keyword.fetch!(options, :gateway)
    name = Names.via(gateway, :unix_listener, Keyword.fetch!(options, :socket))
    GenServer.start_link(__MODULE__, Map.new(options), name: name)
  end

  @doc """
  Child specifications that serve `SOCKET.sock` in a folder: the supervisor of its clients, and the listener. They find each
  other by name, so either may die alone. `client` is the child specification of one client.
  """
  @spec children(Names.gateway(), :state | :mavlink, {module(), keyword()}, map()) ::
          [Supervisor.child_spec() | {module(), keyword()}]
  def children(gateway, socket, client, settings) do
    clients = Names.via(gateway, :socket_clients, socket)

    supervisor =
      {DynamicSupervisor, name: clients, strategy: :one_for_one, max_children: settings.max_clients}

    [
      Supervisor.child_spec(supervisor, id: {:clients, socket}),
      {__MODULE__,
       gateway: gateway,
       socket: socket,
       path: Path.join(UnixSocket.dir(settings.dir), "#{socket}.sock"),
       chosen: settings.dir != nil,
       start: fn -> DynamicSupervisor.start_child(clients, client) end}
    ]
  end

  @doc false
  def child_spec(options),
    do: %{id: {__MODULE__, options[:socket]}, start: {__MODULE__, :start_link, [options]}}

  @doc "Path and state of a socket: `%{path:, status: :up | :down, reason:}`, nil when it is not served at all."
  @spec info(Names.gateway(), :state | :mavlink) :: map() | nil
  def info(gateway, socket), do: Names.value(gateway, :unix_listener, socket)

  @impl GenServer
  def init(options) do
    # So that the file goes when the gateway does.
    Process.flag(:trap_exit, true)
    Process.set_label({:unix_listener, options.socket})
    state = Map.merge(options, %{listener: nil, identity: nil, acceptor: nil, reason: nil})
    {:ok, open(state)}
  end

  @impl GenServer
  def handle_info({:accepted, socket}, state) do
    case admit(socket, state) do
      :ok ->
        :ok

      {:error, :max_children} ->
        Store.count(state.gateway, {:clients, state.socket, :refused})
        emit(state, :refused)
        :gen_tcp.close(socket)

      {:error, _gone} ->
        :gen_tcp.close(socket)
    end

    {:noreply, state}
  end

  def handle_info(:check, %{listener: nil} = state), do: {:noreply, open(state)}

  def handle_info(:check, state) do
    if UnixSocket.present?(state.path, state.identity) do
      {:noreply, again(state)}
    else
      {:noreply, state |> close() |> open()}
    end
  end

  def handle_info({:EXIT, acceptor, reason}, %{acceptor: acceptor} = state),
    do: {:noreply, state |> close() |> failed("#{state.path}: #{inspect(reason)}")}

  def handle_info({:EXIT, _other, _reason}, state), do: {:noreply, state}
  def handle_info(_stray, state), do: {:noreply, state}

  @impl GenServer
  def terminate(_reason, state) do
    _ = close(state)
    :ok
  end

  defp admit(socket, state) do
    with {:ok, client} <- state.start.(),
         :ok <- :gen_tcp.controlling_process(socket, client) do
      send(client, {:socket, socket})
      :ok
    end
  catch
    # The clients' supervisor is being started again.
    :exit, reason -> {:error, reason}
  end

  defp open(state) do
    case UnixSocket.listen(state.path) do
      {:ok, listener, identity} ->
        listening(%{state | listener: listener, identity: identity, reason: nil})

      {:error, reason} ->
        failed(state, reason)
    end
  end

  defp listening(state) do
    owner = self()
    listener = state.listener

    acceptor =
      spawn_link(fn ->
        Process.set_label({:acceptor, state.path})
        accept(listener, owner)
      end)

    emit(state, :listening)
    put_info(state, :up)
    again(%{state | acceptor: acceptor})
  end

  defp accept(listener, owner) do
    case :gen_tcp.accept(listener) do
      {:ok, socket} ->
        if :gen_tcp.controlling_process(socket, owner) == :ok, do: send(owner, {:accepted, socket})
        accept(listener, owner)

      # The machine's limits: waiting programs are served when there is room again.
      {:error, reason} when reason in [:emfile, :enfile, :enobufs, :enomem] ->
        Process.sleep(200)
        accept(listener, owner)

      {:error, :econnaborted} ->
        accept(listener, owner)

      {:error, reason} ->
        exit({:shutdown, reason})
    end
  end

  defp failed(state, reason) do
    if reason != state.reason do
      # A place that nobody chose may well be out of reach (no /run for an ordinary user): that is not an alarm.
      level = if Map.get(state, :chosen, true), do: :warning, else: :info
      Logger.log(level, "unix socket #{state.socket}.sock is not served: #{reason}")
      emit(%{state | reason: reason}, :unavailable)
    end

    state = %{state | reason: reason}
    put_info(state, :down)
    again(state)
  end

  defp close(%{listener: nil} = state), do: state

  defp close(state) do
    Process.unlink(state.acceptor)
    :gen_tcp.close(state.listener)
    UnixSocket.remove(state.path, state.identity)
    %{state | listener: nil, acceptor: nil}
  end

  defp again(state) do
    Process.send_after(self(), :check, @retry_ms)
    state
  end

  defp put_info(state, status) do
    Names.put_value(state.gateway, :unix_listener, state.socket, %{
      path: state.path,
      status: status,
      reason: state.reason
    })
  end

  defp emit(state, event) do
    metadata = Map.take(state, [:gateway, :socket, :path, :reason])
    :telemetry.execute([:aerie, :client, event], %{}, metadata)
  end
end
