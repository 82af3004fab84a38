defmodule MavRouter.LinkTest do
  use ExUnit.Case, async: true
  use Aerie.LinkCase

  alias MavRouter.Link
  alias Aerie.Base.Names

  setup do
    {:ok, gateway: start_parts()}
  end

  defp socket(options \\ []) do
    {:ok, socket} = :gen_udp.open(0, [:binary, active: false] ++ options)
    on_exit(fn -> :gen_udp.close(socket) end)
    socket
  end

  defp say(socket, port, bytes), do: :ok = :gen_udp.send(socket, {127, 0, 0, 1}, port, bytes)

  describe "UDP server" do
    test "frames of a datagram reach the session in one message, unaltered, with their time (F12, R3)", c do
      be_session(c.gateway, 1)
      {id, port} = add_link(c.gateway, "udpin:127.0.0.1:0")
      assert port > 0
      sent = for n <- 1..5, do: attitude(1, n)
      before = System.os_time(:microsecond)
      say(socket(), port, sent)

      assert_receive {:frames, ^id, frames}
      assert Enum.map(frames, & &1.bytes) == sent
      assert Enum.all?(frames, &(&1.at >= before and &1.at <= System.os_time(:microsecond)))
    end

    test "each sender is a peer of its own; garbage makes no peer and costs no frame", c do
      be_session(c.gateway, 1)
      be_session(c.gateway, 2)
      {id, port} = add_link(c.gateway, "udpin:127.0.0.1:0")
      [a, b, noise] = [socket(), socket(), socket()]

      # No burst is a backlog (`MavRouter.Link.Transport.Net.Backlog`), however long a busy machine lets the link stand
      # still.
      frames =
        Enum.flat_map(Enum.chunk_every(1..300, 15), fn chunk ->
          for n <- chunk do
            say(a, port, attitude(1, n))
            # The start of a frame that never ends, and plain noise.
            say(noise, port, <<0xFD, 255, 0, 0, 7>>)
            say(a, port, <<0xFD, 200, 0>>)
            say(b, port, :binary.copy(<<0x55>>, 100) <> attitude(2, n))
          end

          frames(2 * length(chunk))
        end)

      for system <- [1, 2], do: assert(numbers(frames, system) == Enum.to_list(1..300))

      snapshot = snapshot(c.gateway, id)
      assert length(snapshot.peers) == 2
      assert snapshot.counters.frames_in == 600
      assert snapshot.counters.resync_bytes > 0
      assert snapshot.counters.messages == %{30 => 600}
    end

    test "peers are bounded; a refused one is counted", c do
      be_session(c.gateway, 1)
      {id, port} = add_link(c.gateway, "udpin:127.0.0.1:0", options: [max_peers: 2])
      known = for _ <- 1..2, do: socket()
      for one <- known, do: say(one, port, attitude(1, 1))
      frames(2)
      # Heard for half a second they are known, and are not replaced, however late the others come.
      Process.sleep(600)
      for one <- known, do: say(one, port, attitude(1, 2))
      frames(2)
      for _ <- 1..2, do: say(socket(), port, attitude(1, 1))
      eventually(fn -> snapshot(c.gateway, id).counters.peers_refused == 2 end)
      assert length(snapshot(c.gateway, id).peers) == 2
    end

    @tag :capture_log
    test "no loss is silent: datagrams that a suspended link cannot read are counted", c do
      be_session(c.gateway, 1)
      {id, port} = add_link(c.gateway, "udpin:127.0.0.1:0")
      socket = socket()
      say(socket, port, attitude(1, 0))
      frames(1)
      link = Aerie.Base.Names.whereis(c.gateway, :link, id)

      :sys.suspend(link, Aerie.Patience.ms())
      frame = attitude(1, 1)
      for _ <- 1..20_000, do: say(socket, port, frame)
      :sys.resume(link, Aerie.Patience.ms())

      snapshot =
        eventually(fn ->
          %{counters: counters} = snapshot = snapshot(c.gateway, id)
          counters.frames_in + dropped(counters) == 20_001 && snapshot
        end)

      assert snapshot.counters.kernel_dropped > 0
      assert %{datagrams: dropped} = snapshot.overload
      assert dropped == dropped(snapshot.counters)
      assert snapshot.text =~ "overloaded"
    end

    test "a known vehicle loses nothing beside two thousand forged senders, of which few become peers and vehicles",
         c do
      be_session(c.gateway, 1)
      {id, port} = add_link(c.gateway, "udpin:127.0.0.1:0", options: %{max_peers: 256})
      known = socket()
      say(known, port, heartbeat(1))
      say(known, port, attitude(1, 0))
      frames(2)

      for n <- 1..2_000 do
        # A new address each time, and all system ids, that of the vehicle from four hundred of them.
        {:ok, other} = :gen_udp.open(0, [:binary, ip: {127, rem(n, 250) + 1, div(n, 250) + 1, 2}])
        {type, autopilot} = if rem(n, 2) == 0, do: {2, 3}, else: {6, 8}
        system = if rem(n, 5) == 0, do: 1, else: rem(n, 250) + 2
        beat = heartbeat(system, type: type, autopilot: autopilot)
        :ok = :gen_udp.send(other, {127, 0, 0, 1}, port, beat)
        :gen_udp.close(other)

        # Awaited, because nothing slows down the sender while a busy machine keeps the link from reading.
        if rem(n, 10) == 0 do
          say(known, port, attitude(1, div(n, 10)))
          assert Enum.map(attitudes(), &number/1) == [div(n, 10)]
        end
      end

      eventually(fn ->
        counters = snapshot(c.gateway, id).counters
        assert dropped(counters) == 0
        counters.frames_in + counters.peers_refused == 2_202
      end)

      snapshot = snapshot(c.gateway, id)
      assert snapshot.counters.peers_refused > 0
      assert Enum.count(MavRouter.Router.endpoints(c.gateway)) < 1_024
      # Few of the other senders receive the vehicle's frames.
      tables = MavRouter.Tables.of(c.gateway)
      assert map_size(MavRouter.Forward.Table.read(tables).listeners) <= 32
    end

    # What the session gets besides are the forged heartbeats with its vehicle's id.
    defp dropped(counters), do: counters.kernel_dropped + counters.shed + counters.shed_new

    defp attitudes do
      case Enum.filter(frames(1), &(&1.id == 30)) do
        [] -> attitudes()
        found -> found
      end
    end

    test "a system is answered at the peer from which it was heard last", c do
      be_session(c.gateway, 1)
      {id, port} = add_link(c.gateway, "udpin:127.0.0.1:0")
      [a, b] = [socket(), socket()]
      say(a, port, attitude(1, 1))
      frames(1)
      assert MavRouter.Router.send(c.gateway, {"main", 1}, "to a") == :ok
      assert {:ok, {_, _, "to a"}} = :gen_udp.recv(a, 0, Aerie.Patience.ms())

      # The time of hearing has milliseconds.
      eventually(fn ->
        say(b, port, attitude(1, 2))
        frames(1)
        :ok = Link.send_bytes(c.gateway, id, "to b", {:system, 1})
        match?({:ok, {_, _, "to b"}}, :gen_udp.recv(b, 0, 20))
      end)

      assert Link.send_bytes(c.gateway, id, "x", {:system, 9}) == {:error, :no_route}
      assert MavRouter.Router.send(c.gateway, {"main", 9}, "x") == {:error, :no_route}
      assert MavRouter.Router.send(c.gateway, {"other", 1}, "x") == {:error, :no_route}
      assert Link.send_bytes(c.gateway, "nobody", "x", :all) == {:error, :no_link}

      :ok = MavRouter.Router.broadcast(c.gateway, "to all", "main")
      # Of what was sent to it before, some may come late.
      eventually(fn -> match?({:ok, {_, _, "to all"}}, :gen_udp.recv(b, 0, Aerie.Patience.ms())) end)
    end

    test "IPv6", c do
      be_session(c.gateway, 1)
      {id, port} = add_link(c.gateway, "udpin:[::1]:0")
      socket = socket([:inet6])
      :ok = :gen_udp.send(socket, {0, 0, 0, 0, 0, 0, 0, 1}, port, attitude(1, 1))
      frames(1)
      assert [%{text: "[::1]:" <> _}] = snapshot(c.gateway, id).peers
      :ok = MavRouter.Router.send(c.gateway, {"main", 1}, "six")
      assert {:ok, {_, _, "six"}} = :gen_udp.recv(socket, 0, Aerie.Patience.ms())
    end

    test "a taken port is an error that names the owner, and nothing is left behind", c do
      {_id, port} = add_link(c.gateway, "udpin:127.0.0.1:0")
      assert {:error, %Aerie.Base.Error{} = error} = Link.start(c.gateway, "udpin:127.0.0.1:#{port}")
      assert Exception.message(error) =~ "127.0.0.1:#{port} is in use by"
      assert Exception.message(error) =~ "(process #{System.pid()})"
      assert [_one] = Link.list(c.gateway)
      assert {:error, %{reason: {:invalid, "cannot use " <> _}}} = Link.start(c.gateway, "nonsense")
    end
  end

  describe "UDP client" do
    test "calls a host, accepts its datagrams, and follows its port", c do
      be_session(c.gateway, 1)
      server = socket()
      {:ok, port} = :inet.port(server)
      {id, _} = add_link(c.gateway, "udpout:localhost:#{port}")
      eventually(fn -> snapshot(c.gateway, id).status in [:up, :idle] end)
      :ok = Link.send_bytes(c.gateway, id, "hello", :all)
      {address, client} = hears(server, "hello")

      other = socket()
      :ok = :gen_udp.send(other, address, client, attitude(1, 1))
      frames(1)
      :ok = MavRouter.Router.send(c.gateway, {"main", 1}, "again")
      hears(other, "again")
    end

    # Until something is heard, our heartbeat comes in between.
    defp hears(socket, text) do
      case :gen_udp.recv(socket, 0, Aerie.Patience.ms()) do
        {:ok, {address, port, ^text}} -> {address, port}
        {:ok, _our_heartbeat} -> hears(socket, text)
      end
    end

    test "sends our heartbeat until something is heard: only so does the server learn of us", c do
      server = socket()
      {:ok, port} = :inet.port(server)
      add_link(c.gateway, "udpout:127.0.0.1:#{port}")
      assert {:ok, {_, _, bytes}} = :gen_udp.recv(server, 0, Aerie.Patience.ms())
      # An on-board computer at 237/191, never a ground station (H5).
      assert {[%{system: 237, component: 191, id: 0} = frame], _} =
               MavCodec.Parser.push(MavCodec.Parser.new(), bytes)

      assert {:ok, %{type: 18, autopilot: 8}} = MavCodec.decode(frame)

      snapshot = %{spec: %{announced: true}, status: :up, last_heard: nil}
      assert MavRouter.Link.Announcer.silent?(snapshot, 10_000_000)
      refute MavRouter.Link.Announcer.silent?(%{snapshot | last_heard: 9_000_000}, 10_000_000)
      assert MavRouter.Link.Announcer.silent?(%{snapshot | last_heard: 5_000_000, status: :idle}, 10_000_000)
      refute MavRouter.Link.Announcer.silent?(%{snapshot | status: :down}, 10_000_000)
      refute MavRouter.Link.Announcer.silent?(%{snapshot | spec: %{announced: false}}, 10_000_000)
    end

    test "X6: says it more and more seldom on a link of high latency that hears nothing, and no more when it has" do
      link = %{id: "sat", since: 5, last_heard: nil}
      second = 1_000_000

      {said, _seldom} =
        Enum.flat_map_reduce(0..7_200, %{}, fn at, seldom ->
          {links, seldom} = MavRouter.Link.Announcer.seldom(seldom, [link], at * second)
          {Enum.map(links, fn _sat -> at end), seldom}
        end)

      assert said == [0, 30, 90, 210, 450, 930, 1_890, 3_810]
      assert MavRouter.Link.Announcer.seldom(%{}, [%{link | last_heard: 6}], 0) == {[], %{}}
      # It was opened again since, so that the other end does not know where from.
      assert {[_sat], _seldom} = MavRouter.Link.Announcer.seldom(%{}, [%{link | last_heard: 4}], 0)
    end

    test "datagrams of other hosts are ignored", c do
      be_session(c.gateway, 1)
      server = socket(ip: {127, 0, 0, 2})
      {:ok, port} = :inet.port(server)
      {id, _} = add_link(c.gateway, "udpout:127.0.0.2:#{port}")
      eventually(fn -> snapshot(c.gateway, id).status in [:up, :idle] end)
      "0.0.0.0:" <> port = snapshot(c.gateway, id).local
      say(socket(), String.to_integer(port), attitude(1, 1))
      # A socket reads in the order of arrival.
      say(server, String.to_integer(port), attitude(1, 2))
      assert numbers(frames(1), 1) == [2]
      assert snapshot(c.gateway, id).counters.frames_in == 1
    end
  end

  describe "TCP" do
    test "a client finds a server that starts later, loses it, and reconnects by itself", c do
      be_session(c.gateway, 1)
      listen(c.gateway, [:up, :down])
      {:ok, listener} = :gen_tcp.listen(0, [:binary, active: false, reuseaddr: true, ip: {127, 0, 0, 1}])
      {:ok, port} = :inet.port(listener)
      :gen_tcp.close(listener)

      {id, _} = add_link(c.gateway, "tcp:127.0.0.1:#{port}")
      # The first retry is at once.
      assert_receive {:down, %{retry_ms: 0}, %{reason: "connection refused by 127.0.0.1:" <> _}}
      assert_receive {:down, %{retry_ms: wait}, _} when wait in 250..500

      # While it is being tried the text is another one; on a busy machine it is a later try's, with a longer wait.
      eventually(fn ->
        Link.get(c.gateway, id).text =~ ~r/^connection refused by 127.0.0.1:\d+, next try (now|in \d+\.\d s)$/
      end)

      {:ok, listener} = :gen_tcp.listen(port, [:binary, active: false, reuseaddr: true, ip: {127, 0, 0, 1}])
      {:ok, server} = :gen_tcp.accept(listener, Aerie.Patience.ms())
      assert_receive {:up, _, %{link: ^id}}
      # Bytes are cut anywhere on a stream.
      <<a::binary-size(17), b::binary>> = attitude(1, 1) <> attitude(1, 2)
      pieces = for piece <- [a, b], do: {byte_size(piece), fn -> :gen_tcp.send(server, piece) end}
      in_pieces(c.gateway, id, pieces)
      assert [1, 2] = Enum.map(frames(2), &number/1)

      :ok = MavRouter.Router.send(c.gateway, {"main", 1}, "hello")
      assert {:ok, "hello"} = :gen_tcp.recv(server, 5, Aerie.Patience.ms())

      :gen_tcp.close(server)
      assert_receive {:down, _, %{reason: "connection closed by 127.0.0.1:" <> _}}
      assert {:ok, server} = :gen_tcp.accept(listener, Aerie.Patience.ms())
      assert_receive {:up, %{reconnects: 1}, _}
      :ok = :gen_tcp.send(server, attitude(1, 3))
      assert [3] = Enum.map(frames(1), &number/1)
      assert %{reconnects: 1, frames_in: 3} = snapshot(c.gateway, id).counters
    end

    test "a server accepts many connections, each with its own parser; a closed one takes its routes along",
         c do
      be_session(c.gateway, 1)
      be_session(c.gateway, 2)
      {id, port} = add_link(c.gateway, "tcpin:127.0.0.1:0", options: [max_peers: 2])
      listen(c.gateway, [:peer_down])
      {:ok, a} = :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false])
      {:ok, b} = :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false])
      # Sockets are read once the link has accepted them.
      eventually(fn -> length(snapshot(c.gateway, id).peers) == 2 end)
      <<half::binary-size(10), rest::binary>> = attitude(1, 1)

      pieces =
        for {socket, piece} <- [{a, half}, {b, attitude(2, 1)}, {a, rest}],
            do: {byte_size(piece), fn -> :gen_tcp.send(socket, piece) end}

      in_pieces(c.gateway, id, pieces)
      assert [1, 2] = frames(2) |> Enum.map(& &1.system) |> Enum.sort()

      {:ok, refused} = :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false])
      assert {:error, :closed} = :gen_tcp.recv(refused, 0, Aerie.Patience.ms())
      assert snapshot(c.gateway, id).counters.peers_refused == 1

      assert :ok = MavRouter.Router.send(c.gateway, {"main", 2}, "b")
      assert read_until(b, "b")
      :gen_tcp.close(a)
      assert_receive {:peer_down, _, _}
      assert MavRouter.Router.send(c.gateway, {"main", 1}, "a") == {:error, :no_route}
      assert [%{frames_in: 1}] = snapshot(c.gateway, id).peers
    end

    test "a peer that does not read affects nobody else", c do
      be_session(c.gateway, 1)
      be_session(c.gateway, 2)
      {id, port} = add_link(c.gateway, "tcpin:127.0.0.1:0")
      {:ok, stuck} = :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false, recbuf: 4096])
      {:ok, reads} = :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false])
      :ok = :gen_tcp.send(stuck, attitude(1, 1))
      :ok = :gen_tcp.send(reads, attitude(2, 1))
      frames(2)
      block = :binary.copy("x", 50_000)
      for _ <- 1..200, do: :ok = MavRouter.Router.send(c.gateway, {"main", 1}, block)
      :ok = MavRouter.Router.send(c.gateway, {"main", 2}, "still here")
      assert read_until(reads, "still here")
      assert snapshot(c.gateway, id).counters.dropped_out > 0
    end
  end

  # Frames of others come to a peer as well (R1).
  defp read_until(socket, text, before \\ "") do
    {:ok, bytes} = :gen_tcp.recv(socket, 0, Aerie.Patience.ms())
    String.ends_with?(before <> bytes, text) or read_until(socket, text, before <> bytes)
  end

  describe "a killed link" do
    test "fifty times in a row: it is back each time, and the others lose nothing", c do
      for system <- 1..3, do: be_session(c.gateway, system)
      {victim, port} = add_link(c.gateway, "udpin:127.0.0.1:0", id: "victim")
      {udp, udp_port} = add_link(c.gateway, "udpin:127.0.0.1:0", id: "udp")
      {tcp, tcp_port} = add_link(c.gateway, "tcpin:127.0.0.1:0", id: "tcp")
      # Port 0 would be another one after a restart.
      :ok = Link.stop(c.gateway, victim)
      {victim, ^port} = add_link(c.gateway, "udpin:127.0.0.1:#{port}", id: "victim")
      {:ok, stream} = :gen_tcp.connect({127, 0, 0, 1}, tcp_port, [:binary, active: false])
      [a, b] = [socket(), socket()]
      supervisors = for role <- [:links, :link_trees], do: Names.whereis(c.gateway, role)

      got =
        Enum.reduce(1..50, [], fn n, got ->
          # Killed before it has started, it would not be counted.
          before = n - 1

          pid =
            eventually(fn ->
              match?(%{counters: %{restarts: ^before}}, Link.get(c.gateway, victim)) &&
                Names.whereis(c.gateway, :link, victim)
            end)

          say(a, port, attitude(1, n))

          for m <- (n * 20 - 19)..(n * 20) do
            say(b, udp_port, attitude(2, m))
            :ok = :gen_tcp.send(stream, attitude(3, m))
          end

          Process.exit(pid, :kill)

          # Many at once would be a backlog (`MavRouter.Link.Transport.Net.Backlog`) of a link that a busy machine lets
          # stand still.
          got ++ collect(%{2 => 20, 3 => 20})
        end)

      for system <- [2, 3], do: assert(numbers(got, system) == Enum.to_list(1..1000))

      eventually(fn -> match?(%{status: up} when up in [:up, :idle], snapshot(c.gateway, victim)) end)
      say(a, port, attitude(1, 99))
      eventually(fn -> Enum.any?(frames(1), &(number(&1) == 99)) end)
      assert snapshot(c.gateway, victim).counters.restarts == 50
      for id <- [udp, tcp], do: assert(snapshot(c.gateway, id).counters.restarts == 0)
      assert supervisors == for(role <- [:links, :link_trees], do: Names.whereis(c.gateway, role))
    end

    @tag :capture_log
    test "its tree killed twenty times in a row: it waits for the children of the last one each time", c do
      {id, port} = add_link(c.gateway, "udpin:127.0.0.1:0", id: "victim")
      :ok = Link.stop(c.gateway, id)
      {^id, ^port} = add_link(c.gateway, "udpin:127.0.0.1:#{port}", id: id)
      trees = Names.whereis(c.gateway, :link_trees)

      for _n <- 1..20 do
        tree = eventually(fn -> Names.whereis(c.gateway, :link_tree, id) end)
        Process.exit(tree, :kill)
        eventually(fn -> Names.whereis(c.gateway, :link_tree, id) not in [nil, tree] end)
      end

      eventually(fn ->
        match?(%{status: up, port: ^port} when up in [:up, :idle], snapshot(c.gateway, id))
      end)

      assert Names.whereis(c.gateway, :link_trees) == trees
    end

    test "keeps its counters", c do
      be_session(c.gateway, 1)
      {_, port} = add_link(c.gateway, "udpin:127.0.0.1:0", id: "a")
      :ok = Link.stop(c.gateway, "a")
      {id, _} = add_link(c.gateway, "udpin:127.0.0.1:#{port}", id: "a")
      socket = socket()
      say(socket, port, attitude(1, 1))
      frames(1)
      # Written four times a second.
      eventually(fn -> Link.get(c.gateway, id).counters.frames_in == 1 end)
      pid = Names.whereis(c.gateway, :link, id)
      Process.exit(pid, :kill)

      eventually(fn ->
        say(socket, port, attitude(1, 2))
        match?(%{counters: %{frames_in: n, restarts: 1}} when n > 1, Link.get(c.gateway, id))
      end)
    end

    @tag :capture_log
    test "the links' supervisor comes back with its links, those added at run time included", c do
      {id, _} = add_link(c.gateway, "udpin:127.0.0.1:0", id: "kept")
      {gone, _} = add_link(c.gateway, "udpin:127.0.0.1:0", id: "gone")
      :ok = Link.stop(c.gateway, gone)
      trees = Names.whereis(c.gateway, :link_trees)
      Process.exit(trees, :kill)

      eventually(fn ->
        Names.whereis(c.gateway, :link_trees) not in [nil, trees] and
          match?(%{status: up} when up in [:up, :idle], snapshot(c.gateway, id))
      end)

      assert [%{id: "kept"}] = Link.list(c.gateway)
    end

    # Frames until there are so many of each system, others between them.
    defp collect(wanted, got \\ []) do
      if Enum.all?(wanted, fn {system, n} -> Enum.count(got, &(&1.system == system)) >= n end) do
        got
      else
        collect(wanted, got ++ frames(1))
      end
    end
  end

  test "restarted on request, a link connects again and keeps its counters", c do
    be_session(c.gateway, 1)
    {id, port} = add_link(c.gateway, "udpin:127.0.0.1:0")
    say(socket(), port, attitude(1, 1))
    frames(1)
    before = Names.whereis(c.gateway, :link, id)
    assert Link.restart(c.gateway, id) == :ok
    refute Names.whereis(c.gateway, :link, id) in [before, nil]

    again =
      eventually(fn ->
        match?(%{status: up} when up in [:up, :idle], snapshot(c.gateway, id)) && snapshot(c.gateway, id)
      end)

    assert again.counters.frames_in == 1
    say(socket(), again.port, attitude(1, 2))
    assert [2] = Enum.map(frames(1), &number/1)
    assert {:error, %{reason: {:unknown, :link, "none"}}} = Link.restart(c.gateway, "none")
  end

  test "configured links are started with the gateway" do
    config = %{
      links: [
        %{id: "one", url: "udpin:127.0.0.1:0", network: "a", label: "Mast", enabled: true},
        %{id: "two", url: "udpin:127.0.0.1:0", network: "a", label: nil, enabled: false}
      ],
      limits: %{max_links: 1, max_peers: 3},
      mavlink: %{system_id: 245, component_id: 191, dialects: [:common], sysid32: true}
    }

    assert [
             {:max_peers, 3},
             {:idle_ms, 10_000},
             {:parser, [dialects: [MavCodec.Dialects.Common], sysid32: true]} | _serial
           ] =
             config |> Link.Settings.from() |> Link.Settings.options()

    gateway = start_parts(config)
    assert [%{id: "one", network: "a", label: "Mast"}] = Link.list(gateway)

    assert {:error, %{reason: {:limit, "there are as many links as limits.max_links allows"}}} =
             Link.start(gateway, "udpin:127.0.0.1:0")
  end

  test "one id, one link", c do
    {id, _} = add_link(c.gateway, "udpin:127.0.0.1:0")

    assert {:error, %{reason: {:exists, :link, "udpin:127.0.0.1:0"}}} =
             Link.start(c.gateway, "udpin:127.0.0.1:0")

    :ok = Link.stop(c.gateway, id)
    :ok = Link.stop(c.gateway, id)
    assert Link.list(c.gateway) == []
    assert snapshot(c.gateway, id) == nil
  end

  test "the id of a client is taken, and the client stays", c do
    {:ok, "gcs"} = MavRouter.Client.add(c.gateway, "udpin:127.0.0.1:0", id: "gcs")
    client = Names.whereis(c.gateway, :link, "gcs")

    assert {:error, %{reason: {:exists, :link, "gcs"}}} =
             Link.start(c.gateway, "udpin:127.0.0.1:0", id: "gcs")

    assert {:error, %{reason: {:exists, :client, "gcs"}}} =
             MavRouter.Client.add(c.gateway, "udpin:127.0.0.1:0", id: "gcs")

    assert Names.whereis(c.gateway, :link, "gcs") == client
  end

  defp numbers(frames, system), do: for(%{system: ^system} = frame <- frames, do: number(frame))

  test "the snapshot of a link that does not answer is the one that it published last" do
    gateway = start_parts()
    {id, port} = add_link(gateway, "udpin:127.0.0.1:0")
    link = Aerie.Base.Names.whereis(gateway, :link, id)
    :erlang.suspend_process(link)
    assert %{id: ^id, port: ^port} = Link.snapshot(gateway, id)
    :erlang.resume_process(link)
  end
end
