defmodule Aerie.Access.HTTP.RequestTest do
  @moduledoc "A port with what all of them have in front: what a handler is given of a request, and what it answers."
  use ExUnit.Case, async: true

  import Aerie.Patience, only: [eventually: 1]

  alias Aerie.Access.HTTP.{Compression, Error, Proxy, Request, Utf8Check}

  defmodule Handler do
    @moduledoc false
    def init(request, state) do
      {object, request} =
        case :cowboy_req.path(request) do
          "/json" -> request |> Request.json(20) |> object()
          "/facts" -> {inspect(Map.put(Request.facts(request), :query, Request.parameters(request))), request}
          "/long" -> {String.duplicate("the same again ", 100), request}
        end

      case object do
        %Error{} = error -> {:ok, Error.refuse(error, request), state}
        text -> {:ok, :cowboy_req.reply(200, %{"content-type" => "text/plain"}, text, request), state}
      end
    end

    defp object({:error, error, request}), do: {error, request}

    defp object({:ok, body, request}) do
      case Request.decode(body) do
        {:ok, object} -> {inspect(object), request}
        {:error, error} -> {error, request}
      end
    end
  end

  setup do
    gateway = make_ref()

    options = %{
      env: %{
        dispatch: :cowboy_router.compile([{:_, [{:_, Handler, nil}]}]),
        gateway: gateway,
        proxies: [{127, 0, 0, 1}]
      },
      middlewares: [Utf8Check, Proxy, :cowboy_router, :cowboy_handler],
      stream_handlers: [Compression, :cowboy_stream_h]
    }

    {:ok, _listener} = :cowboy.start_clear(gateway, [ip: {127, 0, 0, 1}, port: 0], options)
    on_exit(fn -> :cowboy.stop_listener(gateway) end)
    %{port: :ranch.get_port(gateway)}
  end

  # 21 bytes.
  @chunk "15\r\n" <> String.duplicate("1", 21) <> "\r\n0\r\n\r\n"
  @json {"content-type", "application/json; charset=utf-8"}

  # Status, headers and body.
  defp ask(port, method, path, headers \\ [], body \\ "") do
    chunked? = List.keymember?(headers, "transfer-encoding", 0)
    length = if body == "" or chunked?, do: [], else: [{"content-length", "#{byte_size(body)}"}]
    all = [{"host", "gateway"}, {"connection", "close"}] ++ length ++ headers
    lines = for {name, value} <- all, do: [name, ": ", value, "\r\n"]
    request = [method, " ", path, " HTTP/1.1\r\n", lines, "\r\n", body]
    # A server on a busy machine may reset a connection before its answer is read.
    answer = eventually(fn -> with "" <- raw(port, request), do: nil end)
    [head, body] = String.split(answer, "\r\n\r\n", parts: 2)
    ["HTTP/1.1 " <> <<status::binary-3, _reason::binary>> | lines] = String.split(head, "\r\n")
    headers = Map.new(lines, fn line -> line |> String.split(": ", parts: 2) |> List.to_tuple() end)
    {String.to_integer(status), headers, body}
  end

  defp raw(port, request) do
    {:ok, socket} = :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false])
    _ = :gen_tcp.send(socket, request)
    all(socket, "")
  end

  defp all(socket, got) do
    case :gen_tcp.recv(socket, 0, Aerie.Patience.ms()) do
      {:ok, bytes} -> all(socket, got <> bytes)
      {:error, _closed} -> got
    end
  end

  test "the facts of a request: peer, host, origin, key and query", %{port: port} do
    facts = fn headers, query ->
      {200, _headers, text} = ask(port, "GET", "/facts" <> query, headers)
      {facts, []} = Code.eval_string(text)
      facts
    end

    assert facts.([], "") == %{
             peer: {127, 0, 0, 1},
             forwarded: false,
             host: "gateway",
             origin: nil,
             key: nil,
             query: %{}
           }

    assert %{key: "one", origin: "http://a"} = facts.([{"x-aerie-key", "one"}, {"origin", "http://a"}], "")
    assert %{key: "two"} = facts.([{"authorization", "bearer  two "}], "")
    for other <- ["Basic dHdv", "two"], do: assert(%{key: nil} = facts.([{"authorization", other}], ""))
    assert %{query: %{"a" => "2", "b" => nil}} = facts.([], "?a=1&a=2&b")

    # This machine is the proxy.
    assert %{peer: {203, 0, 113, 7}, forwarded: true} = facts.([{"x-forwarded-for", "203.0.113.7"}], "")

    for header <- ~w(forwarded x-forwarded-host x-real-ip),
        do: assert(%{forwarded: true} = facts.([{header, "x"}], ""))
  end

  test "a body is JSON, an object, and of a size", %{port: port} do
    assert {200, _headers, ~s(%{"a" => 1})} = ask(port, "POST", "/json", [@json], ~s({"a": 1}))

    for {headers, body, status, words} <- [
          {[], ~s({"a": 1}), 415, "must be application/json"},
          {[{"content-type", "application/x-www-form-urlencoded"}], "a=1", 415, "must be application/json"},
          {[], "", 415, "this request has none: send {} with that type"},
          {[@json], "", 400, "is not JSON"},
          {[@json], "[1]", 400, "must be a JSON object"},
          {[@json], "{", 400, "is not JSON"},
          {[@json], String.duplicate("1", 21), 413, "at most 20 bytes"},
          {[@json, {"transfer-encoding", "chunked"}], @chunk, 413, "at most 20 bytes"}
        ] do
      assert {^status, answered, text} = ask(port, "POST", "/json", headers, body)
      assert text =~ words
      assert %{"error" => %{"code" => _, "message" => _}} = JSON.decode!(text)
      assert answered["connection"] == "close"
    end
  end

  test "what is not UTF-8 is refused before anybody reads it", %{port: port} do
    for {path, headers} <- [
          {"/%FF", []},
          {"/facts?a=%FF", []},
          {"/facts", [{"origin", <<255>>}]},
          {"/facts", [{"x-aerie-key", <<255>>}]}
        ] do
      assert {400, _headers, text} = ask(port, "GET", path, headers)
      assert text =~ "UTF-8" or text =~ "is not text"
    end

    # Nobody reads that one.
    assert {200, _headers, _facts} = ask(port, "GET", "/facts", [{"x-other", <<255>>}])
  end

  test "a long text is compressed for those who accept gzip, and says that it may be", %{port: port} do
    {200, _headers, text} = ask(port, "GET", "/long")

    for accepted <- ["gzip", "gzip, deflate, br, zstd", "br, gzip;q=0.5"] do
      assert {200, headers, packed} = ask(port, "GET", "/long", [{"accept-encoding", accepted}])
      assert %{"content-encoding" => "gzip", "vary" => "accept-encoding"} = headers
      assert headers["content-length"] == "#{byte_size(packed)}"
      assert :zlib.gunzip(packed) == text
    end

    for accepted <- ["br", "gzip;q=0", "gzip; q=0.0, br", "identity"] do
      assert {200, headers, ^text} = ask(port, "GET", "/long", [{"accept-encoding", accepted}])
      assert {accepted, headers["content-encoding"], headers["vary"]} == {accepted, nil, "accept-encoding"}
    end

    # What is short stays as it is.
    assert {200, headers, _facts} = ask(port, "GET", "/facts", [{"accept-encoding", "gzip"}])
    refute is_map_key(headers, "content-encoding") or is_map_key(headers, "vary")
  end
end
