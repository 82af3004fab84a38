defmodule Aerie.Fleet.Client.MavlinkSocketTest do
  use ExUnit.Case, async: true

  import Aerie.LinkCase

  alias Aerie.ShortDir
  alias Aerie.Base.Net.UnixSocket.{LengthPrefix, Listener}
  alias Aerie.Fleet.Client.MavlinkSocket
  alias Aerie.Base.Store
  alias Aerie.Base.Names
  alias MavRouter.Router
  alias MavRouter.Endpoints.Endpoint
  alias MavRouter.Client.LocalEndpoint

  # The test process in the place of a link to vehicles.
  defp start do
    dir = ShortDir.new()
    gateway = start_parts()
    settings = %{dir: dir, max_clients: 4}

    for child <-
          Listener.children(gateway, :mavlink, {MavlinkSocket, gateway: gateway, sign: false}, settings),
        do: start_supervised!(child)

    {:ok, link} = LocalEndpoint.attach(gateway, id: "radio", side: :vehicle)
    %{gateway: gateway, path: Path.join(dir, "mavlink.sock"), link: link}
  end

  defp connect(path, options) do
    eventually(fn ->
      case :gen_tcp.connect({:local, path}, 0, [:binary, active: false] ++ options) do
        {:ok, socket} -> socket
        {:error, reason} when reason in [:enoent, :econnrefused] -> nil
      end
    end)
  end

  defp join(c, n \\ 1, options \\ []) do
    socket = connect(c.path, options)
    eventually(fn -> length(clients(c.gateway)) == n end)
    socket
  end

  defp clients(gateway), do: Enum.filter(Router.endpoints(gateway), &(&1.kind == :unix))

  defp say(link, bytes) do
    {frames, _parser} = MavCodec.Parser.push(MavCodec.Parser.new(), bytes, 1)
    LocalEndpoint.ingress(link, frames)
  end

  defp frame(socket) do
    {:ok, <<length::32-little>>} = :gen_tcp.recv(socket, 4, Aerie.Patience.ms())
    {:ok, frame} = :gen_tcp.recv(socket, length, Aerie.Patience.ms())
    frame
  end

  test "a program gets each frame as it was received, with its length, and what it says reaches the vehicle" do
    c = start()
    socket = join(c)
    say(c.link, heartbeat(1) <> attitude(1, 7))
    assert frame(socket) == heartbeat(1)
    assert frame(socket) == attitude(1, 7)

    ours = heartbeat(255, type: 6, autopilot: 8, component: 190)
    :ok = :gen_tcp.send(socket, LengthPrefix.wrap(ours))
    assert_receive {:forward, [^ours], :control}
  end

  test "two programs hear each other, and each is an endpoint of its own" do
    c = start()
    [one, two] = [join(c), join(c, 2)]
    ours = heartbeat(255, type: 6, autopilot: 8, component: 190)
    :ok = :gen_tcp.send(one, [LengthPrefix.wrap(ours), LengthPrefix.wrap(ours)])
    for _ <- 1..2, do: assert(frame(two) == ours)
    # The next frame that this client gets was sent by another one.
    say(c.link, attitude(1, 1))
    assert frame(one) == attitude(1, 1)
  end

  test "garbage in a frame's place costs nothing but itself; another form ends the connection and is counted" do
    c = start()
    socket = join(c)
    ours = heartbeat(255, type: 6, autopilot: 8, component: 190)
    :ok = :gen_tcp.send(socket, [LengthPrefix.wrap(:binary.copy(<<0xFD>>, 40)), LengthPrefix.wrap(ours)])
    assert_receive {:forward, [^ours], :control}

    :ok = :gen_tcp.send(socket, "GET / HTTP/1.1\r\n\r\n")
    assert {:error, :closed} = :gen_tcp.recv(socket, 0, Aerie.Patience.ms())
    assert Store.counter(c.gateway, {:clients, :mavlink, :malformed}) == 1
    eventually(fn -> clients(c.gateway) == [] end)
  end

  test "a program that does not read loses the oldest of the least important, and holds nobody up" do
    c = start()
    deaf = join(c, 1, recbuf: 4096)
    [%{id: id}] = clients(c.gateway)

    reader = join(c, 2)

    dropped = fn ->
      deaf = Enum.find(Router.endpoints(c.gateway), &(&1.id == id)) || flunk("it was let go")
      deaf.counters.dropped_state
    end

    # No more than it takes: who takes nothing at all for half a minute is let go.
    last =
      Enum.find(50..50_000//50, fn n ->
        for m <- (n - 49)..n, do: say(c.link, odometry(1, m))
        for _ <- 1..50, do: frame(reader)
        dropped.() > 100
      end)

    assert last
    # Frames that wait; its mailbox also has messages of its own, timers and the like.
    assert Enum.find(Router.endpoints(c.gateway), &(&1.id == id)).waiting <= Endpoint.max_waiting()

    # It reads again: what it gets are whole frames, and the newest are among them.
    assert Enum.find(Stream.repeatedly(fn -> frame(deaf) end), &(&1 == odometry(1, last)))
  end

  test "the process of one program may be killed; the socket and the others go on" do
    c = start()
    one = join(c)

    [{_, pid, _, _}] =
      c.gateway |> Names.whereis(:socket_clients, :mavlink) |> DynamicSupervisor.which_children()

    two = join(c, 2)
    Process.exit(pid, :kill)
    assert {:error, :closed} = :gen_tcp.recv(one, 0, Aerie.Patience.ms())
    eventually(fn -> length(clients(c.gateway)) == 1 end)
    say(c.link, heartbeat(1))
    assert frame(two) == heartbeat(1)
  end
end
