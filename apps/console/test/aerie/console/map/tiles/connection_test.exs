defmodule Aerie.Console.Map.Tiles.ConnectionTest do
  use ExUnit.Case, async: true

  alias Aerie.Console.Map.Tiles.Fetcher.Connection
  alias Aerie.TileServer

  @ok "HTTP/1.1 200 OK\r\n"

  defp get(url, options \\ []) do
    {answer, conn} = Connection.get(nil, url, [{"user-agent", "t"}], options)
    Connection.close(conn)
    answer
  end

  defp said(parts), do: get(TileServer.says(parts) <> "/1/2/3")

  test "a connection is kept, and opened again when the server has closed it" do
    url = TileServer.start()

    assert {{:ok, 200, %{"content-type" => "image/png"}, body}, conn} =
             Connection.get(nil, url <> "/a?b=c", [])

    assert body == TileServer.png()
    assert_receive {:asked, "/a?b=c", %{"host" => "127.0.0.1:" <> _port}}
    assert {{:ok, 200, _headers, ^body}, %{socket: socket} = ^conn} = Connection.get(conn, url <> "/d", [])
    :gen_tcp.shutdown(socket, :read_write)
    assert {{:ok, 200, _headers, ^body}, %{socket: other} = again} = Connection.get(conn, url <> "/e", [])
    assert other != socket
    Connection.close(again)
  end

  test "bodies of all kinds" do
    assert {:ok, 200, _, "abcdef"} =
             said([@ok, "Transfer-Encoding: chunked\r\n\r\n3;x=y\r\nabc\r\n3\r\ndef\r\n0\r\nX: y\r\n\r\n"])

    assert {:ok, 200, _, "until the end"} = said([@ok, "\r\nuntil ", "the end"])
    assert {:ok, 204, _, ""} = said(["HTTP/1.1 204 No Content\r\n\r\n"])

    assert {:ok, 200, _, "x"} =
             said(["HTTP/1.1 103 Early Hints\r\nLink: a\r\n\r\n", @ok, "Content-Length: 1\r\n\r\nx"])

    assert {:ok, 200, _, ""} = said([@ok, "content-length: 0\r\n\r\n"])
  end

  test "an answer that is not HTTP, too long or cut off is an error, not a crash" do
    large = String.duplicate("x", 3_000_000)

    for {parts, words} <- [
          {["SSH-2.0-OpenSSH_9\r\n"], "not HTTP"},
          {[@ok, "Content-Length: 3000000\r\n\r\n", large], "more than 2097152 bytes"},
          {[@ok, "Content-Length: -1\r\n\r\n"], "no length"},
          {[@ok, "Content-Length: 9\r\n\r\nabc"], "closed"},
          {[@ok, "\r\n", large], "more than 2097152 bytes"},
          {[@ok, "Transfer-Encoding: chunked\r\n\r\nffffffff\r\n"], "more than 2097152 bytes"},
          {[@ok, "Transfer-Encoding: chunked\r\n\r\nxyz\r\n"], "not HTTP"},
          {[@ok, "Transfer-Encoding: chunked\r\n\r\n2\r\nabc\r\n"], "not HTTP"},
          {[@ok, for(n <- 1..200, do: "A#{n}: b\r\n"), "\r\n"], "more than 100 headers"},
          {[for(_n <- 1..9, do: "HTTP/1.1 102 Processing\r\n\r\n")], "does not answer"},
          {[@ok, "A: ", String.duplicate("b", 40_000), "\r\n\r\n"], ""},
          {["HTTP/1.1 500 No\r\nContent-Length: 99999999\r\n\r\n"], "more than 2097152 bytes"}
        ] do
      assert {:error, text} = said(parts)
      assert text =~ words
    end
  end

  test "an answer that never ends takes no longer than it may" do
    {:ok, listener} = :gen_tcp.listen(0, [:binary, active: false, ip: {127, 0, 0, 1}])
    {:ok, port} = :inet.port(listener)
    assert {:error, "it does not answer in time"} = get("http://127.0.0.1:#{port}/", total_ms: 50)
    :gen_tcp.close(listener)
    assert {:error, "connection refused"} = get("http://127.0.0.1:#{port}/")
    assert {:error, "its name is not known here" <> _} = get("http://nowhere.invalid/")
  end

  test "redirects are followed a few times, and nowhere that is less safe" do
    to = fn location -> TileServer.start(fn _asked -> {302, %{"location" => location}, ""} end) end
    target = TileServer.start()
    assert {:ok, 200, _headers, _png} = get(to.(target <> "/x"))
    assert_receive {:asked, "/x", _headers}
    assert {:error, "it redirects more than 3 times"} = get(to.("/again"))
    assert {:error, "it redirects to file"} = get(to.("file:///etc/passwd"))
    assert {:error, "it redirects to gopher"} = get(to.("gopher://127.0.0.1/"))
    for odd <- ["http://[::", "", "http:///", "//"], do: assert({:error, _words} = get(to.(odd)))
  end

  describe "TLS" do
    setup do
      key = [key: {:namedCurve, :secp256r1}, digest: :sha256]
      name = {:Extension, {2, 5, 29, 17}, false, [dNSName: ~c"localhost"]}
      chain = %{root: key, intermediates: [], peer: key ++ [extensions: [name]]}

      %{server_config: server, client_config: client} =
        :public_key.pkix_test_data(%{server_chain: chain, client_chain: chain})

      {:ok, server: Keyword.take(server, [:cert, :key, :cacerts]), cacerts: client[:cacerts]}
    end

    test "by a certificate of an authority that is trusted", %{server: server, cacerts: cacerts} do
      url = TileServer.start(fn _asked -> {200, %{}, "x"} end, server)
      assert {:ok, 200, _headers, "x"} = get(url, cacerts: cacerts)
    end

    @tag :capture_log
    test "not by another one, nor for another name, nor down to http", %{server: server, cacerts: cacerts} do
      url = TileServer.start(fn _asked -> {302, %{"location" => "http://127.0.0.1/"}, ""} end, server)
      assert {:error, "it redirects to http"} = get(url, cacerts: cacerts)

      %{server_config: other} =
        :public_key.pkix_test_data(%{
          server_chain: %{root: [], intermediates: [], peer: []},
          client_chain: %{root: [], intermediates: [], peer: []}
        })

      assert {:error, "its certificate" <> _} = get(url, cacerts: other[:cacerts])

      assert {:error, "its certificate" <> _} =
               url |> String.replace("localhost", "127.0.0.1") |> get(cacerts: cacerts)
    end
  end
end
