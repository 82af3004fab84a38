defmodule MavRouter.Client.ClientsTest do
  use ExUnit.Case, async: true
  use Aerie.LinkCase

  alias Aerie.Base.Error
  alias Aerie.Base.Names
  alias MavRouter.Router
  alias MavCodec.Messages

  @patience Aerie.Patience.ms()

  setup do
    gateway = start_parts(%{mavlink: %{system_id: 245, component_id: 191}}, Aerie.FakeVehicles.parts(10))
    {_id, port} = add_link(gateway, "udpin:127.0.0.1:0", id: "radio")
    {:ok, vehicle} = udp()
    say(vehicle, port, heartbeat(1))
    eventually(fn -> Router.route(gateway, {"main", 1}) end)
    {:ok, gateway: gateway, vehicle: vehicle, port: port}
  end

  defp udp(address \\ {127, 0, 0, 1}) do
    family = if tuple_size(address) == 8, do: [:inet6], else: []
    :gen_udp.open(0, [:binary, active: false, ip: address] ++ family)
  end

  defp say(socket, port, bytes), do: :ok = :gen_udp.send(socket, {127, 0, 0, 1}, port, bytes)
  defp gcs(system), do: heartbeat(system, type: 6, autopilot: 8, component: 190)

  defp order(system),
    do: encode(%Messages.CommandLong{target_system: system, target_component: 1, command: 400})

  defp encode(struct, system \\ 255), do: MavCodec.encode(struct, system: system, component: 190)

  defp client(gateway, client) do
    {:ok, id} = MavRouter.Client.add(gateway, client)
    {id, snapshot(gateway, id).port}
  end

  # One that calls is added before it has called: it gets what comes once it is an endpoint.
  defp caller(gateway, url) do
    {id, _our_port} = client(gateway, url)
    eventually(fn -> Enum.any?(Router.endpoints(gateway), &(&1.owner == id)) end)
    id
  end

  # Datagrams until one of them holds these bytes.
  defp until(socket, bytes) do
    {:ok, {_address, _port, got}} = :gen_udp.recv(socket, 0, @patience)
    if :binary.match(got, bytes) == :nomatch, do: until(socket, bytes), else: got
  end

  defp until_tcp(socket, bytes, before \\ "") do
    {:ok, got} = :gen_tcp.recv(socket, 0, @patience)
    all = before <> got
    if :binary.match(all, bytes) == :nomatch, do: until_tcp(socket, bytes, all), else: all
  end

  defp connect(port, options \\ []) do
    {:ok, socket} = :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false] ++ options)
    socket
  end

  test "a UDP server: each sender is an endpoint; telemetry to it, commands from it", c do
    {_id, port} = client(c.gateway, %{url: "udpin:127.0.0.1:0", id: "gcs"})
    {:ok, one} = udp()
    {:ok, two} = udp()
    for {socket, system} <- [{one, 255}, {two, 254}], do: say(socket, port, gcs(system))
    until(c.vehicle, gcs(255))
    eventually(fn -> Enum.count(Router.endpoints(c.gateway), &(&1.owner == "gcs")) == 2 end)
    say(c.vehicle, c.port, attitude(1, 7))
    for socket <- [one, two], do: until(socket, attitude(1, 7))
    say(one, port, order(1))
    until(c.vehicle, order(1))
    assert [%{id: "gcs", status: :up}] = MavRouter.Client.endpoints(c.gateway)
    # Nobody takes a ground station for a vehicle, and clients are no links.
    assert [%{id: "radio"}] = MavRouter.Link.list(c.gateway)
    assert Names.whereis(c.gateway, :session, {"main", 255}) == nil
  end

  test "the snapshot of a client that does not answer is the one that it published last", c do
    {id, port} = client(c.gateway, "udpin:127.0.0.1:0")
    link = Names.whereis(c.gateway, :link, id)
    :erlang.suspend_process(link)
    assert %{id: ^id, port: ^port} = MavRouter.Link.snapshot(c.gateway, id, 10)
    :erlang.resume_process(link)
  end

  test "a UDP client latches on where the answer comes from", c do
    {:ok, first} = udp()
    {:ok, from} = :inet.port(first)
    caller(c.gateway, "udpout:127.0.0.1:#{from}")
    say(c.vehicle, c.port, attitude(1, 1))
    {:ok, {_, ours, _}} = :gen_udp.recv(first, 0, @patience)
    {:ok, second} = udp()
    say(second, ours, gcs(255))
    until(c.vehicle, gcs(255))
    say(c.vehicle, c.port, attitude(1, 2))
    until(second, attitude(1, 2))
  end

  test "IPv6", c do
    {:ok, socket} = udp({0, 0, 0, 0, 0, 0, 0, 1})
    {:ok, port} = :inet.port(socket)
    caller(c.gateway, "udpout:[::1]:#{port}")
    say(c.vehicle, c.port, attitude(1, 1))
    until(socket, attitude(1, 1))
  end

  test "a TCP server, and a TCP client that comes again", c do
    {_id, port} = client(c.gateway, "tcpin:127.0.0.1:0")
    socket = connect(port)
    :ok = :gen_tcp.send(socket, gcs(255))
    until(c.vehicle, gcs(255))
    say(c.vehicle, c.port, attitude(1, 1))
    until_tcp(socket, attitude(1, 1))

    {:ok, listener} = :gen_tcp.listen(0, [:binary, active: false, ip: {127, 0, 0, 1}, reuseaddr: true])
    {:ok, there} = :inet.port(listener)
    {id, _} = client(c.gateway, "tcp:localhost:#{there}")

    for n <- 0..1 do
      {:ok, accepted} = :gen_tcp.accept(listener, @patience)

      eventually(fn ->
        match?(
          %{status: up, counters: %{reconnects: ^n}} when up in [:up, :idle],
          snapshot(c.gateway, id)
        )
      end)

      say(c.vehicle, c.port, attitude(1, n))
      until_tcp(accepted, attitude(1, n))
      :gen_tcp.close(accepted)
    end
  end

  test "a client that never reads costs the others nothing", c do
    {_id, port} = client(c.gateway, %{url: "tcpin:127.0.0.1:0", id: "tcp"})
    _stuck = connect(port, recbuf: 4096)
    reads = connect(port)
    eventually(fn -> Enum.count(Router.endpoints(c.gateway), &(&1.owner == "tcp")) == 2 end)
    n = 10_000

    # Long frames, so that the buffers of the kernel are full early; in bursts that are no backlog, however long they wait
    # (`MavRouter.Link.Transport.Net.Backlog`).
    texts =
      for i <- 1..n,
          do: {i, encode(%Messages.LogData{id: 1, ofs: i, count: 90, data: :binary.copy(<<i::16>>, 45)}, 1)}

    got = :counters.new(1, [])
    counter = Task.async(fn -> count(reads, MavCodec.Parser.new(), got, n) end)

    # Looked for meanwhile: its connection is given up when it has taken nothing for half a minute.
    stuck =
      Task.async(fn ->
        eventually(fn ->
          Enum.find(Router.endpoints(c.gateway), &(&1.owner == "tcp" and &1.counters.dropped_bulk > 0))
        end)
      end)

    for chunk <- Enum.chunk_every(texts, 50) do
      for {_i, bytes} <- chunk, do: say(c.vehicle, c.port, bytes)
      {last, _} = List.last(chunk)
      eventually(fn -> snapshot(c.gateway, "radio").counters.frames_in >= last + 1 end)
      # No faster than it reads on a busy machine.
      eventually(fn -> :counters.get(got, 1) > last - 500 end)
    end

    assert Task.await(counter, @patience) == n
    assert Task.await(stuck, @patience).counters.dropped_control == 0
  end

  defp count(socket, parser, got, n) do
    {:ok, bytes} = :gen_tcp.recv(socket, 0, @patience)
    {frames, parser} = MavCodec.Parser.push(parser, bytes)
    :ok = :counters.add(got, 1, Enum.count(frames, &(&1.id == 120)))
    if :counters.get(got, 1) < n, do: count(socket, parser, got, n), else: :counters.get(got, 1)
  end

  test "a ground station that calls a vehicles' port is a client, until an autopilot is heard from there",
       c do
    {:ok, gcs} = udp()
    say(gcs, c.port, gcs(255))
    until(c.vehicle, gcs(255))

    assert %{side: :client} =
             eventually(fn -> Enum.find(Router.endpoints(c.gateway), &(&1.side == :client)) end)

    say(gcs, c.port, heartbeat(9))
    eventually(fn -> Enum.all?(Router.endpoints(c.gateway), &(&1.side == :vehicle)) end)
    say(gcs, c.port, heartbeat(9))
    eventually(fn -> Names.whereis(c.gateway, :session, {"main", 9}) end)
  end

  test "an error says what is wrong, and nothing is added", c do
    {_id, port} = client(c.gateway, "tcpin:127.0.0.1:0")
    assert {:error, %Error{reason: reason}} = MavRouter.Client.add(c.gateway, "tcpin:127.0.0.1:#{port}")
    # Without a port in its id, the first one has another name.
    assert match?({:exists, :client, _id}, reason) or match?({:invalid, _in_use}, reason)

    assert {:error, %Error{reason: {:invalid, words}}} =
             MavRouter.Client.add(c.gateway, %{url: "tcpin:127.0.0.1:#{port}", id: "other"})

    assert words =~ "in use"
    assert {:error, _} = MavRouter.Client.add(c.gateway, "carrier pigeon")

    assert {:error, %Error{reason: {:invalid, "a recording" <> _}}} =
             MavRouter.Client.add(c.gateway, "replay:flight.tlog")

    assert {:error, %Error{reason: {:invalid, words}}} =
             MavRouter.Client.add(c.gateway, %{url: "udpin::0", rate_limits: %{"ATITUDE" => 1}})

    assert words =~ "ATITUDE"

    assert {:error, %Error{reason: {:exists, :link, "radio"}}} =
             MavRouter.Client.add(c.gateway, %{url: "udpin::0", id: "radio"})

    assert [_one] = MavRouter.Client.endpoints(c.gateway)
  end

  test "a removed client is gone, its port free and its routes with it", c do
    {id, port} = client(c.gateway, "udpin:127.0.0.1:0")
    {:ok, socket} = udp()
    say(socket, port, gcs(255))
    eventually(fn -> Router.route(c.gateway, {"main", 255}) end)
    :ok = MavRouter.Client.remove(c.gateway, id)
    assert Router.route(c.gateway, {"main", 255}) == nil
    assert MavRouter.Client.endpoints(c.gateway) == []
    assert Enum.map(Router.endpoints(c.gateway), & &1.owner) == ["radio"]
    assert {:ok, _} = :gen_udp.open(port, ip: {127, 0, 0, 1})
    assert {:error, %Error{reason: {:unknown, :client, ^id}}} = MavRouter.Client.remove(c.gateway, id)
  end

  test "rules change while it runs, for it alone", c do
    {_id, port} = client(c.gateway, %{url: "udpin:127.0.0.1:0", id: "a"})
    {_id, other} = client(c.gateway, %{url: "udpin:127.0.0.1:0", id: "b"})
    {:ok, a} = udp()
    {:ok, b} = udp()
    say(a, port, gcs(255))
    say(b, other, gcs(254))
    eventually(fn -> length(Router.endpoints(c.gateway)) == 3 end)
    :ok = Router.configure(c.gateway, "a", filter_out: %{block_messages: ["ATTITUDE"]})
    say(c.vehicle, c.port, [attitude(1, 1), heartbeat(1, seq: 5)])
    assert :binary.match(until(a, heartbeat(1, seq: 5)), attitude(1, 1)) == :nomatch
    until(b, attitude(1, 1))
    :ok = Router.configure(c.gateway, "a", filter_out: nil)
    say(c.vehicle, c.port, attitude(1, 2))
    until(a, attitude(1, 2))
    assert {:error, _} = Router.configure(c.gateway, "a", filter_out: %{block_messages: ["NOTHING"]})
    assert {:error, _} = Router.configure(c.gateway, "nobody", role: :full)
    # A budget takes the direct way to the socket away, and gives it back.
    :ok = Router.configure(c.gateway, "a", bytes_per_s: 1_000_000)
    say(c.vehicle, c.port, attitude(1, 3))
    until(a, attitude(1, 3))
    :ok = Router.configure(c.gateway, "a", bytes_per_s: nil)
    say(c.vehicle, c.port, attitude(1, 4))
    until(a, attitude(1, 4))
  end

  @tag :capture_log
  test "a client's process may be killed: it is back, with its rules; so are all after a restart of the router",
       c do
    {id, port} = client(c.gateway, %{url: "udpin:127.0.0.1:0", id: "gcs", rate_limits: %{"ATTITUDE" => 0}})
    assert port > 0
    pid = Names.whereis(c.gateway, :link, id)
    Process.exit(pid, :kill)

    eventually(fn ->
      match?(%{status: :up, counters: %{restarts: 1}}, hd(MavRouter.Client.endpoints(c.gateway)))
    end)

    :ok = MavRouter.Client.remove(c.gateway, id)
    {"kept", _} = client(c.gateway, %{url: "udpin:127.0.0.1:0", id: "kept"})
    Process.exit(Names.whereis(c.gateway, :router), :kill)
    eventually(fn -> match?([%{id: "kept", status: :up}], MavRouter.Client.endpoints(c.gateway)) end)
  end

  @tag :capture_log
  test "the clients' supervisor may be killed: the clients are back, and the router keeps its routes", c do
    {"gcs", _} = client(c.gateway, %{url: "udpin:127.0.0.1:0", id: "gcs"})
    router = Names.whereis(c.gateway, :router)

    for _n <- 1..5 do
      client = eventually(fn -> Names.whereis(c.gateway, :link, "gcs") end)
      Process.exit(clients_supervisor(router), :kill)
      eventually(fn -> Names.whereis(c.gateway, :link, "gcs") not in [nil, client] end)
    end

    assert Names.whereis(c.gateway, :router) == router
    assert Router.route(c.gateway, {"main", 1})
  end

  defp clients_supervisor(router) do
    Enum.find_value(Supervisor.which_children(router), fn {id, pid, _type, _modules} ->
      id == MavRouter.Client.Supervisor and is_pid(pid) and pid
    end)
  end
end
