defmodule Aerie.Base.Net.UnixSocket.ListenerTest do
  use ExUnit.Case, async: true

  import Aerie.Patience, only: [eventually: 1]
  import ExUnit.CaptureLog

  alias Aerie.Base.{Names, Store}
  alias Aerie.Base.Net.UnixSocket.Listener
  alias Aerie.ShortDir

  # A client that sends back what it gets.
  defmodule Echo do
    use GenServer

    def start_link(options), do: GenServer.start_link(__MODULE__, options)

    @impl GenServer
    def init(options), do: {:ok, options}

    @impl GenServer
    def handle_info({:socket, socket}, state) do
      :inet.setopts(socket, active: true)
      {:noreply, state}
    end

    def handle_info({:tcp, socket, bytes}, state) do
      :ok = :gen_tcp.send(socket, bytes)
      {:noreply, state}
    end

    def handle_info({:tcp_closed, _socket}, state), do: {:stop, :normal, state}
  end

  setup do
    gateway = make_ref()
    start_supervised!({Store, gateway: gateway})
    {:ok, gateway: gateway, dir: ShortDir.new()}
  end

  defp serve(%{gateway: gateway, dir: dir}, max_clients \\ 2) do
    settings = %{dir: dir, max_clients: max_clients}
    client = Supervisor.child_spec({Echo, []}, restart: :temporary)
    for child <- Listener.children(gateway, :state, client, settings), do: start_supervised!(child)
    Path.join(dir, "state.sock")
  end

  defp connect(path), do: :gen_tcp.connect({:local, path}, 0, [:binary, active: false])

  defp echoes?(socket) do
    :ok = :gen_tcp.send(socket, "ping")
    :gen_tcp.recv(socket, 4, Aerie.Patience.ms()) == {:ok, "ping"}
  end

  test "each client has a process; beyond the limit they are let go and counted", c do
    path = serve(c)
    assert %{path: ^path, status: :up, reason: nil} = Listener.info(c.gateway, :state)
    {:ok, one} = connect(path)
    {:ok, two} = connect(path)
    assert echoes?(one) and echoes?(two)
    {:ok, three} = connect(path)
    assert :gen_tcp.recv(three, 0, Aerie.Patience.ms()) == {:error, :closed}
    assert Store.counter(c.gateway, {:clients, :state, :refused}) == 1

    :gen_tcp.close(one)
    clients = Names.via(c.gateway, :socket_clients, :state)
    eventually(fn -> DynamicSupervisor.count_children(clients).active == 1 end)
    {:ok, four} = connect(path)
    assert echoes?(four)
  end

  test "the file goes with the listener, and one that somebody removed is made again", c do
    path = serve(c)
    File.rm!(path)
    send(Names.whereis(c.gateway, :unix_listener, :state), :check)
    eventually(fn -> File.exists?(path) end)
    {:ok, one} = connect(path)
    assert echoes?(one)
    stop_supervised!({Listener, :state})
    refute File.exists?(path)
  end

  test "a place that another program has is reported once, and taken when it is free", c do
    path = Path.join(c.dir, "state.sock")
    File.write!(path, "mine")

    log =
      capture_log(fn ->
        serve(c)
        listener = Names.whereis(c.gateway, :unix_listener, :state)
        send(listener, :check)
        assert %{status: :down, reason: reason} = Listener.info(c.gateway, :state)
        assert reason =~ "is not a socket"
        # The second look is over.
        _state = :sys.get_state(listener)
      end)

    assert length(String.split(log, "state.sock is not served")) == 2
    File.rm!(path)
    send(Names.whereis(c.gateway, :unix_listener, :state), :check)
    eventually(fn -> match?(%{status: :up}, Listener.info(c.gateway, :state)) end)
  end

  test "while the clients' supervisor is gone a client is let go, and the listener stays", c do
    path = serve(c)
    listener = Names.whereis(c.gateway, :unix_listener, :state)
    stop_supervised!({:clients, :state})
    {:ok, one} = connect(path)
    assert :gen_tcp.recv(one, 0, Aerie.Patience.ms()) == {:error, :closed}
    assert Names.whereis(c.gateway, :unix_listener, :state) == listener
  end

  test "an acceptor that dies leaves the socket down, to be opened again", c do
    path = serve(c)
    listener = Names.whereis(c.gateway, :unix_listener, :state)
    acceptor = :sys.get_state(listener).acceptor

    capture_log(fn ->
      Process.exit(acceptor, :kill)
      eventually(fn -> match?(%{status: :down}, Listener.info(c.gateway, :state)) end)
    end)

    send(listener, :check)
    eventually(fn -> match?(%{status: :up}, Listener.info(c.gateway, :state)) end)
    {:ok, one} = connect(path)
    assert echoes?(one)
  end
end
