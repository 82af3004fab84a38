defmodule Aerie.Api.AttackTest do
  @moduledoc "What somebody sends who means no good: each is refused by its kind, none makes an error of ours."
  use Aerie.APICase, async: true

  alias Aerie.Api.Rest.Routes

  @pages ["/", "/metrics", "/healthz", "/readyz", "/nothing"]
  @methods ~w(GET HEAD OPTIONS POST PUT PATCH DELETE BREW)
  @json {"content-type", "application/json"}
  # Without a key nobody changes what is desired of vehicles, nor begins an operation on many.
  @others [
    {"POST", "/api/tickets", 201},
    {"POST", "/api/plans", 403},
    {"POST", "/api/operations", 403},
    {"DELETE", "/api/operations/x", 403},
    {"POST", "/api/operations/x/pause", 403},
    {"POST", "/api/operations/x/continue", 403},
    {"POST", "/api/operations/x/abort", 403},
    {"POST", "/api/abort", 403},
    {"DELETE", "/api/vehicles/x/shadow", 403}
  ]

  defp paths(segment) do
    @pages ++ for {path, _resource} <- Routes.paths(), do: filled(path, segment)
  end

  defp filled(path, segment), do: String.replace(path, ~r/:id|:name|\[\.\.\.\]/, segment)

  # The status of an answer; nothing in it is about our code.
  defp status(answer) do
    assert ["HTTP/1.1 " <> <<status::binary-3>> <> _reason, body] = String.split(answer, "\r\n\r\n", parts: 2)
    refute body =~ ~r/\.erl|\.ex\b|Elixir\.|\*\* \(|stacktrace|function_clause|#PID/
    String.to_integer(status)
  end

  defp ask(port, method, path, headers \\ [], body \\ "") do
    length = {"content-length", "#{byte_size(body)}"}

    lines =
      for {name, value} <- [{"connection", "close"}, length | headers], do: [name, ": ", value, "\r\n"]

    host = if List.keymember?(headers, "host", 0), do: "", else: "host: 127.0.0.1\r\n"
    status(answer(port, [method, " ", path, " HTTP/1.1\r\n", host, lines, "\r\n", body]))
  end

  test "a path, a query or a header that is not UTF-8 is refused with 400, on every route, with every method" do
    %{port: port} = start_server()

    for bad <- ["%FF", "a%FFb", "%C0%AF", "%ED%A0%80", "%", "%zz", <<255>>],
        path <- paths(bad),
        String.contains?(path, bad),
        method <- @methods do
      assert {method, path, ask(port, method, path, [@json], "{}")} == {method, path, 400}
    end

    for path <- @pages ++ ["/api/status"],
        query <- ["%FF", "a=%C0%AF", <<255>>],
        do: assert(ask(port, "GET", path <> "?" <> query) == 400)

    for name <- ~w(host origin content-type authorization x-aerie-key),
        path <- ["/api/status", "/metrics"],
        method <- ["GET", "OPTIONS", "POST"],
        do: assert(ask(port, method, path, [{name, <<"http://", 255>>}]) == 400)

    assert ask(port, "GET", "/healthz") == 200
  end

  test "behind a proxy of ours, what is forwarded and is not text is refused like everything else" do
    %{port: port} = start_server(proxies: ["127.0.0.1"])

    for name <- ~w(x-forwarded-for x-forwarded-proto),
        value <- [<<255>>, <<"203.0.113.7, ", 255>>, <<255, ", 203.0.113.7">>],
        path <- ["/healthz", "/metrics", "/api/status", <<"/", 255>>],
        do: assert({name, path, ask(port, "GET", path, [{name, value}])} == {name, path, 400})

    assert ask(port, "GET", "/healthz", [{"x-forwarded-for", "203.0.113.7"}]) == 200
  end

  test "every method on every route has its answer; HEAD is GET without a body, OPTIONS lists the methods" do
    %{port: port} = start_server()

    admins =
      for %{role: :admin, method: method, path: path} <- Routes.all(), do: {method, path}

    for {path, _resource} <- Routes.paths(), method <- @methods do
      status = ask(port, method, path |> filled("x"), [@json], "{}")

      cond do
        # Without a key nobody is an admin.
        {method, path} in admins -> assert {method, path, status} == {method, path, 403}
        {method, filled(path, "x"), status} in @others -> :ok
        true -> assert status in [200, 204, 404, 405, 422, 503], "#{method} #{path}: #{status}"
      end
    end

    for path <- @pages,
        method <- @methods,
        do: assert(ask(port, method, path, [@json], "{}") in [200, 204, 404, 405, 503])

    for path <- paths("x") do
      get = answer(port, ["GET ", path, " HTTP/1.1\r\nhost: 127.0.0.1\r\nconnection: close\r\n\r\n"])
      head = answer(port, ["HEAD ", path, " HTTP/1.1\r\nhost: 127.0.0.1\r\nconnection: close\r\n\r\n"])
      assert {path, status(head)} == {path, status(get)}
      assert [_head, ""] = String.split(head, "\r\n\r\n", parts: 2)
    end

    assert {204, %{"allow" => "GET, HEAD"}, nil} = request(port, "OPTIONS", "/metrics")
    assert {204, %{"allow" => allow}, nil} = request(port, "OPTIONS", "/api/rules/x")
    assert allow =~ "PATCH" and allow =~ "DELETE"
  end

  test "an allowed page may use every method of a route" do
    %{port: port} = start_server(key: true, origins: ["https://gcs.example.org"])

    for {path, resource} <- Routes.paths(), resource != :missing do
      path = String.replace(path, ~r/:id|:name|\[\.\.\.\]/, "x")
      assert {204, headers, nil} = request(port, "OPTIONS", path, [{"origin", "https://gcs.example.org"}])
      allowed = String.split(headers["access-control-allow-methods"], ", ")
      assert Enum.sort(allowed) == Enum.sort(Routes.methods(resource))

      for method <- ~w(PUT PATCH),
          match?({:ok, _}, Routes.find(resource, method)),
          do: assert(method in allowed)
    end
  end

  test "metrics and health refuse a foreign host name (DNS rebinding)" do
    %{port: port} = start_server(key: true, hosts: ["gateway.example.org"])
    {:ok, own} = :inet.gethostname()

    for path <- @pages -- ["/nothing"] do
      for host <- [
            "evil.example",
            "evil.example:80",
            "127.0.0.1.evil.example",
            "localhost.evil.example"
          ],
          do: assert({path, host, ask(port, "GET", path, [{"host", host}])} == {path, host, 403})

      for host <- [
            "localhost",
            "127.0.0.1:1",
            "[::1]:4000",
            "10.1.2.3:4000",
            "GATEWAY.example.org:4000",
            "#{own}"
          ],
          do:
            assert({path, host, ask(port, "GET", path, [{"host", host}]) in [200, 503]} == {path, host, true})

      # A scraper that is configured with the key may call the gateway what it likes.
      key = {"authorization", "Bearer " <> key()}
      assert ask(port, "GET", path, [{"host", "gw.lan"}, key]) in [200, 503]
    end
  end

  @tag :tmp_dir
  test "no name leads out of the folder of recordings", %{tmp_dir: dir} do
    folder = Path.join(dir, "recordings")
    File.mkdir_p!(folder)
    File.write!(Path.join(dir, "secret.tlog"), "secret")
    %{port: port} = start_server(links: true, recorder: %{dir: folder, min_free_mb: 0})

    for name <-
          [
            "../secret.tlog",
            "..%2Fsecret.tlog",
            "%2e%2e%2fsecret.tlog",
            "..%5Csecret.tlog",
            "....//secret.tlog"
          ] ++
            [
              "%2Fetc%2Fpasswd",
              "//etc/passwd",
              Path.join(dir, "secret.tlog") |> URI.encode_www_form()
            ] do
      answer =
        answer(port, [
          "GET /api/recordings/",
          name,
          " HTTP/1.1\r\nhost: 127.0.0.1\r\nconnection: close\r\n\r\n"
        ])

      assert {name, status(answer)} == {name, 404}
      refute answer =~ "secret" and not (answer =~ "error")
    end
  end

  test "a body that is too long, not JSON, or of another type is refused with its own status" do
    %{port: port} = start_server(key: true)
    admin = {"x-aerie-key", key()}
    post = &ask(port, "POST", "/api/clients", [admin | &1], &2)

    for type <- [
          "text/plain",
          "application/x-www-form-urlencoded",
          "multipart/form-data; boundary=x",
          "",
          "json"
        ],
        do: assert(post.([{"content-type", type}], "{}") == 415)

    for body <- [
          "",
          "{",
          "nul",
          "[]",
          "1",
          "\"x\"",
          <<"{\"", 255, "\":1}">>,
          ~s({"id":"\\ud800"}),
          String.duplicate("[", 16_000)
        ],
        do: assert({body, post.([@json], body)} == {body, 400})

    for body <- [~s({"\\u0000":1}), ~s({"url":{"a":[1e308]}}), ~s({"url":"udpout:h:1","id":"\\u0000"}), "{}"],
        do: assert({body, post.([@json], body)} == {body, 422})

    assert post.([@json], String.duplicate("x", 16_385)) == 413
    chunk = ["4000\r\n", String.duplicate("a", 0x4000), "\r\n"]

    head =
      "POST /api/clients HTTP/1.1\r\nhost: 127.0.0.1\r\nx-aerie-key: #{key()}\r\ncontent-type: application/json\r\ntransfer-encoding: chunked\r\n\r\n"

    assert status(answer(port, [head, List.duplicate(chunk, 100)])) == 413
  end

  test "headers and request lines have limits; only HTTP/1.1 is spoken" do
    %{port: port} = start_server()
    long = String.duplicate("x", 100_000)

    for {line, headers, expected} <- [
          {"GET /#{long} HTTP/1.1", "", 414},
          {"#{long} / HTTP/1.1", "", 414},
          {"GET / HTTP/1.1", "x: #{long}\r\n", 431},
          {"GET / HTTP/1.1", "#{long}: x\r\n", 431},
          {"GET / HTTP/1.1", String.duplicate("x: y\r\n", 1000), 431},
          {"GET / HTTP/1.1", "content-length: -1\r\n", 400},
          {"GET / HTTP/1.1", "content-length: 5\r\ntransfer-encoding: chunked\r\n", 400},
          {"GET / HTTP/1.1", "host: evil.example\r\n", 400},
          {"GET http://evil.example/metrics HTTP/1.1", "", 400},
          {"TRACE / HTTP/1.1", "", 501},
          {"PRI * HTTP/2.0", "", 501}
        ] do
      answer = answer(port, [line, "\r\nhost: 127.0.0.1\r\n", headers, "\r\n"])

      assert {String.slice(line, 0, 40), String.slice(headers, 0, 40), status(answer)} ==
               {String.slice(line, 0, 40), String.slice(headers, 0, 40), expected}
    end

    assert ask(port, "GET", "/healthz") == 200
  end

  test "a slow sender, or one with an unexpected body, is disconnected" do
    %{port: port} = start_server(key: true)

    post =
      "POST /api/clients HTTP/1.1\r\nhost: 127.0.0.1\r\nx-aerie-key: #{key()}\r\ncontent-type: application/json\r\n"

    # Not asked to close, the server does: nothing of such a connection can be trusted to end.
    for {head, drop} <- [
          {"GET /api/status HTTP/1.1\r\nhost: 127.0.0.1\r\ncontent-length: 900000\r\n\r\n{", "x"},
          {"GET /metrics HTTP/1.1\r\nhost: 127.0.0.1\r\ncontent-length: 9\r\n\r\n", "x"},
          {"GET /metrics HTTP/1.1\r\nhost: 127.0.0.1\r\nx: ", "a"},
          {post <> "content-length: 10000\r\n\r\n{", "1"},
          {post <> "transfer-encoding: chunked\r\n\r\n", "1\r\na\r\n"}
        ] do
      Task.async(fn -> assert trickle(port, head, drop) =~ "HTTP/1.1 " end)
    end
    |> Task.await_many(Aerie.Patience.ms())
  end

  test "connections have a limit; a waiting one is served when another ends" do
    gateway = make_ref()
    start_endpoint(gateway, %{http: %{port: 0}, websocket: %{enabled: false}}, max_connections: 2)
    port = Aerie.Api.Endpoint.port(gateway)
    keep = "GET /healthz HTTP/1.1\r\nhost: 127.0.0.1\r\n\r\n"

    open =
      for _n <- 1..12 do
        {:ok, socket} = :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: true])
        :ok = :gen_tcp.send(socket, keep)
        socket
      end

    for _two <- 1..2, do: assert_receive({:tcp, _socket, "HTTP/1.1 200" <> _})
    connections = length(:ranch.procs(Aerie.Api.Listener.ref(gateway), :connections))
    # Ranch's acceptors notice the limit when they have one more connection in hand each.
    assert connections <= 2 + 4
    Enum.each(open, &:gen_tcp.close/1)
    eventually(fn -> :ranch.procs(Aerie.Api.Listener.ref(gateway), :connections) == [] end)
    assert ask(port, "GET", "/healthz") == 200
  end

  # A piece every now and then until the server closes; gives what it said.
  defp trickle(port, head, drop) do
    {:ok, socket} = :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: true])
    :ok = :gen_tcp.send(socket, head)
    trickle(socket, drop, "", 1000)
  end

  defp trickle(_socket, _drop, _said, 0), do: flunk("a connection that trickles is kept")

  defp trickle(socket, drop, said, left) do
    receive do
      {:tcp, ^socket, bytes} -> trickle(socket, drop, said <> bytes, left)
      {:tcp_closed, ^socket} -> said
    after
      50 ->
        _ = :gen_tcp.send(socket, drop)
        trickle(socket, drop, said, left - 1)
    end
  end
end
