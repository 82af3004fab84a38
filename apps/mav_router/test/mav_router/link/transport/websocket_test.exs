defmodule MavRouter.Link.Transport.WebSocketTest do
  use ExUnit.Case, async: true
  use Aerie.LinkCase

  import :proper_types, only: [list: 1, non_empty: 1, oneof: 1, binary: 0, range: 2]

  alias MavRouter.Link
  alias MavRouter.Link.Spec
  alias MavRouter.Link.Transport.WebSocket
  alias Aerie.Base.Net.WebSocket.Frames
  alias Aerie.Base.Net.WebSocket.Handshake
  alias MavRouter.Router

  @patience Aerie.Patience.ms()
  # A link that is answered late would call again, and the test would go on with the former call.
  @patient %{connect_ms: @patience}

  ## A minimal server

  # Gives each connection to the test.
  defp serve(by \\ :gen_tcp, options \\ []) do
    {:ok, listener} = by.listen(0, [:binary, active: false, ip: {127, 0, 0, 1}, reuseaddr: true] ++ options)
    {:ok, {_address, port}} = if by == :ssl, do: :ssl.sockname(listener), else: :inet.sockname(listener)
    {by, listener, port}
  end

  defp accept({:gen_tcp, listener, _port}) do
    {:ok, socket} = :gen_tcp.accept(listener, @patience)
    {:gen_tcp, socket}
  end

  defp accept({:ssl, listener, _port}) do
    {:ok, socket} = :ssl.transport_accept(listener, @patience)
    with {:ok, socket} <- :ssl.handshake(socket, @patience), do: {:ssl, socket}
  end

  defp upgrade(server, early \\ "") do
    {by, socket} = accept(server)
    {request, key} = request(by, socket, "")

    :ok =
      by.send(socket, [
        "HTTP/1.1 101 Switching Protocols\r\nupgrade: websocket\r\nConnection: Upgrade\r\n",
        ["Sec-WebSocket-Accept: ", :cow_ws.encode_key(key), "\r\n\r\n", early]
      ])

    {by, socket, request}
  end

  defp request(by, socket, before) do
    {:ok, bytes} = by.recv(socket, 0, @patience)
    all = before <> bytes

    if String.ends_with?(all, "\r\n\r\n") do
      [_all, key] = Regex.run(~r/Sec-WebSocket-Key: (\S+)\r\n/, all)
      {all, key}
    else
      request(by, socket, all)
    end
  end

  defp say({by, socket, _request}, frame), do: :ok = by.send(socket, :cow_ws.frame(frame, %{}))

  # The next frame of the client: its type and payload, unmasked.
  defp hear({by, socket, _request}) do
    {:ok, <<1::1, 0::3, opcode::4, 1::1, length::7>>} = by.recv(socket, 2, @patience)
    {:ok, mask} = by.recv(socket, 4, @patience)

    payload =
      if length == 0, do: "", else: with({:ok, bytes} <- by.recv(socket, length, @patience), do: bytes)

    pad = binary_part(:binary.copy(mask, div(length, 4) + 1), 0, length)
    {opcode, :crypto.exor(payload, pad)}
  end

  defp up(gateway, id), do: eventually(fn -> snapshot(gateway, id).status in [:up, :idle] end)

  describe "a link" do
    setup do
      gateway = start_parts(%{mavlink: %{system_id: 245, component_id: 191}})
      be_session(gateway, 1)
      {:ok, gateway: gateway}
    end

    test "frames come in messages of any shape and go out one a message; pings are answered", c do
      {_by, _listener, port} = server = serve()

      {:ok, id} =
        Link.start(c.gateway, "ws://127.0.0.1:#{port}/mavlink?token=secret&network=main",
          id: "agent",
          options: @patient
        )

      client = upgrade(server, :cow_ws.frame({:binary, heartbeat(1)}, %{}))
      assert {_by, _socket, "GET /mavlink?token=secret HTTP/1.1\r\nHost: 127.0.0.1:" <> _} = client
      assert [%{id: 0}] = frames(1)

      # Two in one message, and one in two fragments with a ping between them.
      say(client, {:binary, attitude(1, 1) <> attitude(1, 2)})
      <<head::binary-size(9), tail::binary>> = attitude(1, 3)
      {by, socket, _request} = client

      pieces =
        for frame <- [
              <<2, byte_size(head), head::binary>>,
              IO.iodata_to_binary(:cow_ws.frame({:ping, "alive?"}, %{})),
              <<0x80, byte_size(tail), tail::binary>>
            ],
            do: {byte_size(frame), fn -> by.send(socket, frame) end}

      in_pieces(c.gateway, id, pieces)
      assert Enum.map(frames(3), &number/1) == [1, 2, 3]
      assert hear(client) == {10, "alive?"}

      ours = heartbeat(245, type: 18, autopilot: 8, component: 191)
      :ok = Router.send(c.gateway, {"main", 1}, [ours, ours])
      assert [hear(client), hear(client)] == [{2, ours}, {2, ours}]

      # The server's options are not shown.
      snapshot = snapshot(c.gateway, id)
      assert snapshot.url == "ws://127.0.0.1:#{port}/mavlink?…&network=main"
      assert snapshot.peer == "127.0.0.1:#{port}"
    end

    test "the server closes with a reason and comes back: so does the link", c do
      {_by, _listener, port} = server = serve()
      listen(c.gateway, [:down])
      {:ok, id} = Link.start(c.gateway, "ws://127.0.0.1:#{port}", id: "agent", options: @patient)
      client = upgrade(server)
      up(c.gateway, id)
      say(client, {:close, 1012, "restart"})
      assert_receive {:down, _wait, %{reason: "the server closed the WebSocket (1012: restart)"}}, @patience
      client = upgrade(server)
      say(client, {:binary, heartbeat(1)})
      assert [%{id: 0}] = frames(1)
    end

    test "a server that is not a WebSocket is reported in words", c do
      {_by, _listener, port} = server = serve()
      listen(c.gateway, [:down])
      {:ok, _id} = Link.start(c.gateway, "ws://127.0.0.1:#{port}", id: "agent", options: @patient)
      {by, socket} = accept(server)
      _request = request(by, socket, "")
      :ok = by.send(socket, "HTTP/1.1 403 Forbidden\r\ncontent-length: 0\r\n\r\n")
      place = "no WebSocket at 127.0.0.1:#{port}: "
      assert_receive {:down, _wait, %{reason: reason}}, @patience
      assert reason == place <> "it answered 403 Forbidden"

      # One that accepts the handshake and then sends something else.
      client = upgrade(server)
      {by, socket, _request} = client
      :ok = by.send(socket, "hello, who is there?")

      assert_receive {:down, _wait, %{reason: "the server sent something other than a WebSocket frame"}},
                     @patience
    end

    @tag :tmp_dir
    @tag capture_log: true
    test "wss: only with a certificate of a trusted authority for the server's name",
         %{tmp_dir: dir} = c do
      {ca, options} = certificates(dir)
      {_by, _listener, port} = server = serve(:ssl, options)
      listen(c.gateway, [:down])

      {:ok, id} = Link.start(c.gateway, "wss://localhost:#{port}/?ca=#{ca}", id: "good", options: @patient)
      client = upgrade(server)
      up(c.gateway, id)
      say(client, {:binary, heartbeat(1)})
      assert [%{id: 0}] = frames(1)
      :ok = Router.send(c.gateway, {"main", 1}, attitude(245, 1))
      assert hear(client) == {2, attitude(245, 1)}

      # A refused link may connect again at any time, so the server keeps accepting.
      start_supervised!({Task, fn -> Enum.each(Stream.cycle([server]), &accept/1) end})

      # The system does not trust this authority; and the certificate is not for an address.
      for {id, url, why} <- [
            {"unknown", "wss://localhost:#{port}", ~r/Unknown CA|no certificate authorities/i},
            {"misnamed", "wss://127.0.0.1:#{port}/?ca=#{ca}", ~r/hostname|host name/i}
          ] do
        {:ok, ^id} = Link.start(c.gateway, url, id: id, options: @patient)
        assert_receive {:down, _wait, %{link: ^id, reason: reason}}, @patience
        assert reason =~ why
        :ok = Link.stop(c.gateway, id)
      end
    end
  end

  # A server's certificate for localhost, and the file of its authority.
  defp certificates(dir) do
    key = [key: {:namedCurve, :secp256r1}, digest: :sha256]
    name = {:Extension, {2, 5, 29, 17}, false, [dNSName: ~c"localhost"]}

    %{server_config: server, client_config: client} =
      :public_key.pkix_test_data(%{
        server_chain: %{root: key, intermediates: [], peer: key ++ [extensions: [name]]},
        client_chain: %{root: key, intermediates: [], peer: key}
      })

    file = Path.join(dir, "authority.pem")
    entries = for der <- client[:cacerts], do: {:Certificate, der, :not_encrypted}
    File.write!(file, :public_key.pem_encode(entries))
    {file, Keyword.take(server, [:cert, :key, :cacerts])}
  end

  test "a server that answers no ping is given up" do
    {_by, _listener, port} = server = serve()
    test = self()

    spawn_link(fn ->
      {:ok, conn} = WebSocket.open(Spec.parse!("ws://127.0.0.1:#{port}"))
      :ok = WebSocket.give(conn, test)
      send(test, {:conn, conn})
    end)

    client = upgrade(server)
    assert_receive {:conn, conn}, @patience
    {:ok, conn, _info} = WebSocket.activate(conn)
    ping = {:websocket, :ping, conn.socket}

    conn =
      Enum.reduce(1..3, conn, fn _n, conn ->
        {[], conn} = WebSocket.handle(conn, ping)
        conn
      end)

    assert hear(client) == {9, ""}
    assert {[{:closed, :timeout}], _conn} = WebSocket.handle(conn, ping)
    # Anything that it sends is an answer.
    {[], conn} = WebSocket.handle(conn, {:tcp, conn.socket, IO.iodata_to_binary(:cow_ws.frame(:pong, %{}))})
    assert {[], conn} = WebSocket.handle(conn, ping)
    assert :ok = WebSocket.close(conn)
  end

  test "frames: the same in whatever pieces they come" do
    message = oneof([{:binary, binary()}, {:text, ""}, {:ping, ""}, {:binary, :long}])

    property =
      :proper.forall({non_empty(list(message)), non_empty(list(range(1, 400)))}, fn {messages, cuts} ->
        messages =
          Enum.map(messages, fn
            {:binary, :long} -> {:binary, :binary.copy("x", 70_000)}
            other -> other
          end)

        bytes = messages |> Enum.map(&:cow_ws.frame(&1, %{})) |> IO.iodata_to_binary()

        {events, frames} =
          bytes
          |> pieces(Stream.cycle(cuts) |> Enum.take(10_000))
          |> Enum.flat_map_reduce(Frames.new(), &Frames.push(&2, &1))

        data = for {:data, data} <- events, into: "", do: data

        data == Enum.map_join(messages, fn {kind, data} -> if kind == :binary, do: data, else: "" end) and
          Enum.count(events, &match?({:ping, _}, &1)) == Enum.count(messages, &match?({:ping, _}, &1)) and
          frames == Frames.new() and :bad not in events
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 100]) == true, inspect(:proper.counterexample())
  end

  defp pieces(<<>>, _cuts), do: []

  defp pieces(bytes, [n | cuts]) when n < byte_size(bytes),
    do: [binary_part(bytes, 0, n) | pieces(binary_part(bytes, n, byte_size(bytes) - n), cuts)]

  defp pieces(bytes, _cuts), do: [bytes]

  test "frames: garbage never raises, and a length that is only claimed costs nothing" do
    property =
      :proper.forall(list(binary()), fn pieces ->
        {_events, frames} = Enum.flat_map_reduce(pieces, Frames.new(), &Frames.push(&2, &1))
        byte_size(frames.buffer) <= byte_size(Enum.join(pieces))
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 500]) == true, inspect(:proper.counterexample())
    # A terabyte of a message.
    assert {[{:data, "abc"}], %{buffer: ""}} =
             Frames.push(Frames.new(), <<130, 127, 1_099_511_627_776::64, "abc">>)

    # Masked, reserved bits, a long control frame.
    for bad <- [<<130, 129, 1, 2, 3, 4, 5>>, <<0xC2, 1, 5>>, <<0x89, 126, 200::16>>],
        do: assert({[:bad], _frames} = Frames.push(Frames.new(), bad))
  end

  test "the answer of a server" do
    key = :cow_ws.key()

    good =
      "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nSec-Websocket-Accept: #{:cow_ws.encode_key(key)}\r\n"

    assert Handshake.answer(good <> "\r\nrest", key) == {:ok, "rest"}
    assert Handshake.answer(good, key) == :more

    assert {:error, "it answered 301 Moved (https://x/)"} =
             Handshake.answer("HTTP/1.1 301 Moved\r\nLocation: https://x/\r\n\r\n", key)

    assert {:error, "it is not a WebSocket server"} = Handshake.answer(good <> "\r\n", :cow_ws.key())

    assert {:error, "it chose extensions" <> _} =
             Handshake.answer(good <> "Sec-WebSocket-Extensions: x\r\n\r\n", key)

    assert {:error, "it is not an HTTP server"} = Handshake.answer("SSH-2.0-OpenSSH\r\n\r\n", key)
    assert {:error, "the answer has no end"} = Handshake.answer(String.duplicate("x", 20_000), key)
  end
end
