defmodule Aerie.Api.WebSocketTest do
  use Aerie.APICase, async: true

  alias Aerie.Access.KeyRing
  alias Aerie.Base.Store
  alias MavRouter.Router
  alias MavRouter.Endpoints.Endpoint
  alias MavRouter.Client.LocalEndpoint
  alias Aerie.WSClient

  @settings %{
    enabled: true,
    sign: false,
    address: "127.0.0.1",
    port: 0,
    max_clients: 8,
    cert_file: nil,
    key_file: nil
  }

  # The test process in the place of a link to vehicles.
  defp start(options \\ []) do
    c =
      start_server(
        [websocket: Map.merge(@settings, options[:websocket] || %{})] ++ Keyword.delete(options, :websocket)
      )

    {:ok, link} = LocalEndpoint.attach(c.gateway, id: "radio", side: :vehicle)
    Map.merge(c, %{ws: Aerie.Api.WebSocket.port(c.gateway), link: link})
  end

  defp open(c, path \\ "/", options \\ [], n \\ 1) do
    with %WSClient{} = client <- WSClient.open(c.ws, path, options) do
      eventually(fn -> length(clients(c.gateway)) == n end)
      client
    end
  end

  defp clients(gateway), do: Enum.filter(Router.endpoints(gateway), &(&1.kind == :websocket))

  defp heartbeat(system, type \\ 2, autopilot \\ 3) do
    message = %MavCodec.Messages.Heartbeat{
      type: type,
      autopilot: autopilot,
      system_status: 4,
      mavlink_version: 3
    }

    MavCodec.encode(message, system: system, component: 1, seq: 0)
  end

  defp attitude(n),
    do:
      MavCodec.encode(%MavCodec.Messages.Attitude{time_boot_ms: n}, system: 1, component: 1, seq: rem(n, 256))

  defp say(link, bytes) do
    {frames, _parser} = MavCodec.Parser.push(MavCodec.Parser.new(), bytes, 1)
    LocalEndpoint.ingress(link, frames)
  end

  describe "frames" do
    test "leave one per message, unchanged, and arrive one or several per message" do
      c = start()
      client = open(c)
      say(c.link, heartbeat(1) <> attitude(7))
      {first, client} = WSClient.recv(client)
      {second, client} = WSClient.recv(client)
      assert [first, second] == [{2, heartbeat(1)}, {2, attitude(7)}]

      ours = heartbeat(255, 6, 8)
      :ok = WSClient.send(client, ours)
      assert_receive {:forward, [^ours], :control}
      :ok = WSClient.send(client, ours <> "rubbish" <> ours)
      assert_receive {:forward, [^ours, ^ours], :control}

      assert [%{side: :client, counters: %{frames_in: 3}, peer: "local@127.0.0.1:" <> _port}] =
               clients(c.gateway)
    end

    test "a read-only client gets everything, and nothing that it sends is forwarded" do
      c = start()
      client = open(c, "/mavlink?access=read")
      :ok = WSClient.send(client, heartbeat(255, 6, 8))
      eventually(fn -> match?([%{counters: %{read_only: 1}}], clients(c.gateway)) end)
      refute_received {:forward, _frames, _class}
      say(c.link, heartbeat(1))
      assert {{2, _frame}, _client} = WSClient.recv(client)
    end

    test "a client of another network gets nothing of this one" do
      c = start(links: true)

      for name <- ["field", "lab"],
          do: {:ok, ^name} = MavRouter.Link.start(c.gateway, "udpin:127.0.0.1:0?id=#{name}&network=#{name}")

      client = open(c, "/?network=field,lab")
      assert [%{networks: ["field", "lab"]}] = clients(c.gateway)
      say(c.link, heartbeat(1))
      assert {{:closed, :timeout}, _client} = WSClient.recv(client, 100)
    end

    test "a text message, and one that is too large, close the connection with a reason" do
      c = start()
      client = open(c)
      :ok = WSClient.send(client, "hello", 1)
      assert {{8, <<1003::16, words::binary>>}, _client} = WSClient.recv(client)
      assert words =~ "binary"
      eventually(fn -> clients(c.gateway) == [] end)

      client = open(c)
      :ok = WSClient.send(client, :binary.copy(<<0>>, 70_000))
      assert {{8, <<1009::16, _words::binary>>}, _client} = WSClient.recv(client)
      assert Store.counter(c.gateway, {:clients, :websocket, :text}) == 1
    end

    test "a client that does not read loses its oldest, least important frames, and delays nobody" do
      c = start()
      reader = open(c)
      [%{id: id}] = clients(c.gateway)

      deaf = fn ->
        open(c, "/", [socket: [recbuf: 2048]], 2)
        Enum.find(clients(c.gateway), &(&1.id != id)).id
      end

      # Who takes nothing at all for ten seconds is let go. On a busy machine that is too early, and another one is deaf.
      assert %{waiting: waiting} =
               Enum.reduce_while(1..100, {reader, deaf.()}, fn n, {reader, id} ->
                 for m <- 1..500, do: say(c.link, Aerie.LinkCase.odometry(1, 500 * n + m))

                 reader =
                   Enum.reduce(1..500, reader, fn _m, reader -> reader |> WSClient.recv() |> elem(1) end)

                 case Enum.find(Router.endpoints(c.gateway), &(&1.id == id)) do
                   nil -> {:cont, {reader, deaf.()}}
                   %{counters: %{dropped_state: 0}} -> {:cont, {reader, id}}
                   endpoint -> {:halt, endpoint}
                 end
               end)

      assert waiting <= Endpoint.max_waiting()
    end

    test "a client that vanishes leaves nothing behind" do
      c = start()
      client = open(c)
      WSClient.close(client)
      eventually(fn -> clients(c.gateway) == [] end)
    end
  end

  describe "access" do
    test "with a key: the header, a ticket in the address, a ticket as subprotocol; each ticket once" do
      c = start(key: true)
      assert {401, %{"error" => %{"code" => "unauthorized"}}} = open(c)
      assert {401, _body} = open(c, "/", headers: [{"x-aerie-key", "not-the-key-of-tests"}])
      assert %WSClient{} = open(c, "/", headers: [{"x-aerie-key", key()}])

      {201, _headers, %{"ticket" => ticket}} =
        request(c.port, "POST", "/api/tickets", [{"x-aerie-key", key()}])

      assert %WSClient{protocol: nil} = open(c, "/?ticket=" <> ticket, [], 2)
      assert {401, %{"error" => %{"message" => message}}} = open(c, "/?ticket=" <> ticket)
      assert message =~ "used up"

      {201, _headers, %{"ticket" => ticket}} =
        request(c.port, "POST", "/api/tickets", [{"x-aerie-key", key()}])

      protocols = [{"sec-websocket-protocol", "mavlink, ticket." <> ticket}]
      assert %WSClient{protocol: "mavlink"} = open(c, "/", [headers: protocols], 3)
      assert {401, _body} = open(c, "/", headers: protocols)
      assert "api.key@" <> _address = hd(clients(c.gateway)).peer
      assert Store.counter(c.gateway, {:clients, :websocket, :unauthorized}) == 4
    end

    @tag :tmp_dir
    test "by the role of its key: a viewer only looks on, what an operator commands is judged as an operator's",
         %{
           tmp_dir: dir
         } do
      file = Path.join(dir, "keys")
      File.write!(file, "olga the-key-of-olga-0 role=operator\nvictor the-key-of-victor role=viewer\n")
      File.chmod!(file, 0o600)
      c = start(keys_file: file)
      {:ok, policy} = Aerie.Control.Policy.compile(%{})
      start_supervised!({Aerie.Control.Policy.Store, gateway: c.gateway, policy: policy})
      say(c.link, heartbeat(1))
      reboot = MavCodec.encode(%MavCodec.Messages.CommandLong{target_system: 1, command: 246}, system: 255)

      arm =
        MavCodec.encode(%MavCodec.Messages.CommandLong{target_system: 1, command: 400, param1: 1.0},
          system: 255
        )

      victor = [{"x-aerie-key", "the-key-of-victor"}]
      viewer = open(c, "/?access=full", headers: victor)
      :ok = WSClient.send(viewer, arm)
      eventually(fn -> match?([%{counters: %{read_only: 1}}], clients(c.gateway)) end)
      {201, _headers, %{"ticket" => ticket}} = request(c.port, "POST", "/api/tickets", victor)
      viewer = open(c, "/?ticket=" <> ticket, [], 2)
      :ok = WSClient.send(viewer, arm)
      eventually(fn -> Enum.all?(clients(c.gateway), &(&1.counters.read_only == 1)) end)

      operator = open(c, "/", [headers: [{"x-aerie-key", "the-key-of-olga-0"}]], 3)
      :ok = WSClient.send(operator, reboot <> arm)
      assert_receive {:forward, [^arm], :control}
      refute_received {:forward, [^reboot], :control}
      # It hears the vehicle's heartbeat no more; the answer is the first that comes.
      {{2, answer}, _operator} = WSClient.recv(operator)
      frame = MavCodec.Frame.from_bytes(answer, nil)
      assert {:ok, %MavCodec.Messages.CommandAck{command: 246, result: 2}} = MavCodec.decode(frame)
    end

    @tag :tmp_dir
    @tag capture_log: true
    test "ends with its key", %{tmp_dir: dir} do
      c = start(config: %{console: %{enabled: false, dir: dir}})
      {:ok, wall} = KeyRing.make(c.gateway, "wall", "viewer", "", "ann")
      {:ok, other} = KeyRing.make(c.gateway, "other", "viewer", "", "ann")
      client = open(c, "/", headers: [{"x-aerie-key", wall}])
      stays = open(c, "/", [headers: [{"x-aerie-key", other}]], 2)
      :ok = KeyRing.revoke(c.gateway, "wall", "ann")
      assert {{8, <<1008::16, "the key was revoked">>}, _client} = WSClient.recv(client)
      assert {401, _body} = WSClient.open(c.ws, "/", headers: [{"x-aerie-key", wall}])
      # The other one still serves, until it is sent what it does not take.
      :ok = WSClient.send(stays, "hello", 1)
      assert {{8, <<1003::16, _words::binary>>}, _client} = WSClient.recv(stays)
    end

    test "pages: the gateway's own and the configured ones; no others, not even with a valid ticket" do
      c = start(key: true, origins: ["https://gcs.example.org"])
      key = {"x-aerie-key", key()}
      assert %WSClient{} = open(c, "/", headers: [key, {"origin", "http://127.0.0.1:#{c.port}"}])
      assert %WSClient{} = open(c, "/", [headers: [key, {"origin", "https://gcs.example.org"}]], 2)

      {201, _headers, %{"ticket" => ticket}} = request(c.port, "POST", "/api/tickets", [key])

      for origin <- ["https://evil.example", "null", "http://127.0.0.1:1"] do
        assert {403, %{"error" => %{"code" => "forbidden"}}} =
                 open(c, "/?ticket=" <> ticket, headers: [{"origin", origin}])
      end

      # It was not used up by that.
      assert %WSClient{} = open(c, "/?ticket=" <> ticket, [], 3)
    end

    test "without a key: this machine, but no foreign page, name or proxy" do
      c = start()
      assert {403, _body} = open(c, "/", headers: [{"origin", "https://evil.example"}])
      assert {403, _body} = open(c, "/", headers: [{"host", "evil.example"}])
      assert {403, _body} = open(c, "/", headers: [{"x-forwarded-for", "10.0.0.1"}])
      assert %WSClient{} = open(c)
    end

    test "the number of clients is limited" do
      c = start(websocket: %{max_clients: 2})
      first = open(c)
      _second = open(c, "/", [], 2)
      assert {503, %{"error" => %{"message" => message}}} = open(c)
      assert message =~ "max_clients"
      WSClient.close(first)
      # Its place is free when its process has ended.
      assert eventually(fn -> is_struct(WSClient.open(c.ws, "/")) end)
    end

    test "simultaneous handshakes cannot exceed the limit" do
      c = start(websocket: %{max_clients: 4})
      test = self()

      for _ <- 1..16 do
        # A connection ends with the process that opened it.
        spawn_link(fn ->
          send(test, {:answer, WSClient.open(c.ws, "/")})
          receive(do: (:never -> :ok))
        end)
      end

      answers =
        for _ <- 1..16 do
          assert_receive {:answer, answer}
          answer
        end

      assert Enum.count(answers, &is_struct(&1, WSClient)) == 4
      assert Enum.count(answers, &match?({503, %{"error" => %{"code" => "unavailable"}}}, &1)) == 12
    end

    test "reserved places outlive the process that counts them" do
      c = start(websocket: %{max_clients: 1})
      client = open(c)
      capacity = Aerie.Base.Names.whereis(c.gateway, :websocket_capacity)
      Process.exit(capacity, :kill)
      eventually(fn -> Aerie.Base.Names.whereis(c.gateway, :websocket_capacity) not in [nil, capacity] end)
      assert {503, %{"error" => %{"message" => message}}} = open(c)
      assert message =~ "max_clients"
      WSClient.close(client)
      assert eventually(fn -> is_struct(WSClient.open(c.ws, "/")) end)
    end

    test "a request that is not UTF-8 is refused first, and takes no place" do
      c = start(websocket: %{max_clients: 1})

      upgrade =
        "connection: upgrade\r\nupgrade: websocket\r\nsec-websocket-version: 13\r\nsec-websocket-key: AA==\r\n"

      for {path, header} <- [
            {"/?ticket=%FF", ""},
            {"/%FF", ""},
            {"/", <<"sec-websocket-protocol: mavlink, ticket.", 255, "\r\n">>},
            {"/", <<"origin: http://", 255, "\r\n">>}
          ] do
        answer = answer(c.ws, ["GET ", path, " HTTP/1.1\r\nhost: 127.0.0.1\r\n", upgrade, header, "\r\n"])
        assert answer =~ ~r/\AHTTP\/1.1 400 /
        refute answer =~ ~r/\.erl|\.ex\b|Elixir\./
      end

      open(c)
    end

    test "a request for anything else gets an error that says so" do
      c = start()
      assert {426, %{"error" => %{"code" => "upgrade_required"}}} = open(c, "/", headers: [{"upgrade", nil}])
      assert {404, nil} = open(c, "/elsewhere")

      for query <- ["network=", "network=a/b", "access=all", "network=" <> String.duplicate("x", 100)],
          do: assert({400, %{"error" => %{"code" => "bad_request"}}} = open(c, "/?" <> query))

      # A misspelt network would be silence.
      assert {400, %{"error" => %{"message" => text}}} = open(c, "/?network=main,feild")
      assert text == ~s(unknown network "feild"; known: main)
    end
  end

  @tag :tmp_dir
  test "with a certificate it speaks wss, and only that", %{tmp_dir: dir} do
    %{cert: cert, key: key, ca: ca} = certificate(dir)
    c = start(websocket: %{cert_file: cert, key_file: key})
    client = open(c, "/", tls: ca)
    say(c.link, heartbeat(1))
    assert {{2, frame}, _client} = WSClient.recv(client)
    assert frame == heartbeat(1)
    refute raw(c.ws, "GET / HTTP/1.1\r\nhost: localhost\r\n\r\n") =~ "HTTP/1.1"
  end

  # A certificate of localhost, of an authority made for it.
  defp certificate(dir) do
    chain = [key: {:namedCurve, :secp256r1}, digest: :sha256]

    %{server_config: server, client_config: client} =
      :public_key.pkix_test_data(%{
        server_chain: %{root: chain, intermediates: [], peer: chain ++ [extensions: [san()]]},
        client_chain: %{root: chain, intermediates: [], peer: chain}
      })

    {type, der} = server[:key]

    write = fn name, entries ->
      dir |> Path.join(name) |> tap(&File.write!(&1, :public_key.pem_encode(entries)))
    end

    %{
      cert: write.("cert.pem", [{:Certificate, server[:cert], :not_encrypted}]),
      key: write.("key.pem", [{type, der, :not_encrypted}]),
      ca: write.("ca.pem", for(der <- client[:cacerts], do: {:Certificate, der, :not_encrypted}))
    }
  end

  defp san do
    {:Extension, {2, 5, 29, 17}, false, [dNSName: ~c"localhost"]}
  end

  for sign <- [true, false] do
    test "websocket.sign: #{sign} is a rule of its clients" do
      c = start(websocket: %{sign: unquote(sign)})
      open(c)
      [%{owner: id}] = clients(c.gateway)
      assert %{sign: unquote(sign)} = c.gateway |> MavRouter.Tables.of() |> MavRouter.Endpoints.owner(id)
    end
  end
end
