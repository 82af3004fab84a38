defmodule Phoenix.LiveViewTest.Wire do
  @moduledoc "HTTP and WebSocket by hand, for what no browser would do. A connection is a passive socket."

  alias Phoenix.LiveViewTest.DOM

  # It only guards against hanging.
  @timeout 180_000

  @doc "GETs a path: status, headers (lower case, in order), body."
  def get(port, path, headers \\ []) do
    {:ok, socket} = connect(port)

    :ok =
      :gen_tcp.send(socket, ["GET ", path, " HTTP/1.1\r\nconnection: close\r\n", lines(port, headers), "\r\n"])

    case socket |> all("") |> String.split("\r\n\r\n", parts: 2) do
      [head, body] ->
        {status, headers} = head(head)
        {status, headers, body}

      # Closed before it was read, on a machine that stood still.
      [""] ->
        get(port, path, headers)
    end
  end

  defp all(socket, read) do
    case :gen_tcp.recv(socket, 0, @timeout) do
      {:ok, more} -> all(socket, read <> more)
      {:error, :closed} -> read
    end
  end

  @doc "A page as a browser has it: its cookie, its CSRF token, and what its container says."
  def page(port, path \\ "/") do
    {200, headers, body} = get(port, path)

    [cookie] =
      for {"set-cookie", "_live_view=" <> _ = cookie} <- headers, do: cookie |> String.split(";") |> hd()

    nodes = DOM.parse(body)
    [meta] = DOM.all(nodes, "meta[name=csrf-token]")
    [container] = DOM.all(nodes, "[data-phx-main]")

    %{
      cookie: cookie,
      csrf: DOM.attribute(meta, "content"),
      id: DOM.attribute(container, "id"),
      session: DOM.attribute(container, "data-phx-session"),
      path: path,
      port: port
    }
  end

  @doc "Opens the WebSocket of a page: the connection, or the status with which it was refused."
  def open(page, changes \\ []) do
    query = URI.encode_query(Keyword.get(changes, :query, %{"_csrf_token" => page.csrf, "vsn" => "2.0.0"}))
    origin = Keyword.get(changes, :origin, "http://127.0.0.1:#{page.port}")
    {:ok, socket} = connect(page.port, Keyword.get(changes, :recbuf, 65_536))

    headers = [
      {"cookie", Keyword.get(changes, :cookie, page.cookie)},
      {"origin", origin},
      {"upgrade", "websocket"},
      {"connection", "upgrade"},
      {"sec-websocket-version", "13"},
      {"sec-websocket-key", Base.encode64(:crypto.strong_rand_bytes(16))}
      | Keyword.get(changes, :headers, [])
    ]

    :ok =
      :gen_tcp.send(socket, [
        "GET /live/websocket?",
        query,
        " HTTP/1.1\r\n",
        lines(page.port, headers),
        "\r\n"
      ])

    case socket |> until_blank("") |> head() do
      {101, _headers} -> {:ok, socket}
      {status, _headers} -> {:refused, status}
    end
  end

  defp connect(port, recbuf \\ 65_536),
    do: :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: false, recbuf: recbuf], @timeout)

  defp lines(port, headers) do
    host = if List.keymember?(headers, "host", 0), do: [], else: [{"host", "127.0.0.1:#{port}"}]
    for {name, value} <- host ++ headers, value != nil, do: [name, ": ", value, "\r\n"]
  end

  defp until_blank(socket, read) do
    if String.ends_with?(read, "\r\n\r\n") do
      read
    else
      {:ok, byte} = :gen_tcp.recv(socket, 1, @timeout)
      until_blank(socket, read <> byte)
    end
  end

  defp head(head) do
    ["HTTP/1.1 " <> status | headers] = String.split(head, "\r\n", trim: true)

    {status |> String.slice(0, 3) |> String.to_integer(),
     for header <- headers do
       [name, value] = String.split(header, ": ", parts: 2)
       {String.downcase(name), value}
     end}
  end

  @doc "Joins the page's view; the rest of the payload may be given."
  def join(socket, page, changes \\ %{}) do
    payload = %{
      url: "http://127.0.0.1:#{page.port}#{page.path}",
      params: %{_mounts: 0},
      session: page.session,
      static: nil
    }

    push(socket, ["1", "1", "lv:" <> page.id, "phx_join", Map.merge(payload, changes)])
    recv(socket)
  end

  @doc "Sends a message, masked as a browser does."
  def push(socket, message), do: frame(socket, 1, JSON.encode!(message))

  @doc "Sends a frame of an opcode."
  def frame(socket, opcode, data) do
    size = byte_size(data)
    length = if size < 126, do: <<1::1, size::7>>, else: <<1::1, 126::7, size::16>>
    # A mask of zeros changes nothing.
    :gen_tcp.send(socket, [<<8::4, opcode::4>>, length, <<0::32>>, data])
  end

  @doc "The next message, or `{:close, code}`, or `:closed`."
  def recv(socket) do
    with {:ok, <<_flags::4, opcode::4, 0::1, short::7>>} <- :gen_tcp.recv(socket, 2, @timeout) do
      size =
        case short do
          126 -> socket |> exactly(2) |> :binary.decode_unsigned()
          127 -> socket |> exactly(8) |> :binary.decode_unsigned()
          short -> short
        end

      data = exactly(socket, size)

      case opcode do
        1 -> JSON.decode!(data)
        8 -> {:close, data |> binary_part(0, 2) |> :binary.decode_unsigned()}
      end
    else
      {:error, _closed} -> :closed
    end
  end

  defp exactly(_socket, 0), do: ""

  defp exactly(socket, size) do
    {:ok, data} = :gen_tcp.recv(socket, size, @timeout)
    data
  end
end
