defmodule Aerie.Base.Net.WebSocket.Handshake do
  @moduledoc "The request that opens a WebSocket, and its answer, from both sides (RFC 6455, section 4). Pure."

  alias Aerie.Base.Net.Address

  # A status line with its headers.
  @max_bytes 16_384
  @ports %{false => 80, true => 443}

  @typedoc "The parts of a URL."
  @type url :: %{
          :host => String.t() | :inet.ip_address(),
          :port => :inet.port_number(),
          :path => String.t(),
          :tls => term(),
          optional(atom()) => term()
        }

  @doc "The request for a URL; `key` is from `:cow_ws.key/0`."
  @spec request(url, binary) :: iodata
  def request(spec, key) do
    [
      ["GET ", spec.path, " HTTP/1.1\r\nHost: ", host(spec), "\r\n"],
      "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\nUser-Agent: aerie\r\n",
      ["Sec-WebSocket-Key: ", key, "\r\n\r\n"]
    ]
  end

  defp host(%{host: host, port: port, tls: tls}) do
    if port == @ports[tls],
      do: String.replace_suffix(Address.format(host, port), ":#{port}", ""),
      else: Address.format(host, port)
  end

  @doc """
  Checks what has come of the answer: `{:ok, rest}` if the server accepts, with the bytes after its answer; `:more` if the
  answer is incomplete. The error is words.
  """
  @spec answer(binary, key :: binary) :: {:ok, rest :: binary} | :more | {:error, String.t()}
  def answer(bytes, key) do
    case :binary.split(bytes, "\r\n\r\n") do
      [head, rest] -> check(head <> "\r\n\r\n", rest, key)
      [_all] when byte_size(bytes) > @max_bytes -> {:error, "the answer has no end"}
      [_all] -> :more
    end
  end

  defp check(head, rest, key) do
    with {:ok, {:http_response, _version, status, words}, headers} <-
           :erlang.decode_packet(:http_bin, head, []),
         {:ok, headers} <- headers(headers, %{}) do
      cond do
        status != 101 -> {:error, "it answered #{status} #{printable(words)}#{location(headers)}"}
        headers["sec-websocket-accept"] != :cow_ws.encode_key(key) -> {:error, "it is not a WebSocket server"}
        headers["sec-websocket-extensions"] != nil -> {:error, "it chose extensions that nobody offered"}
        true -> {:ok, rest}
      end
    else
      _no_http -> {:error, "it is not an HTTP server"}
    end
  end

  @doc """
  Reads the request of a client: its key, the origin of the page that it comes from (nil for a program), and the first protocol that it offers. An error is the
  answer to it.
  """
  @spec accept(binary) ::
          {:ok, %{key: binary, origin: String.t() | nil, protocol: String.t() | nil}, rest :: binary}
          | :more
          | {:error, iodata}
  def accept(bytes) do
    with [head, rest] <- :binary.split(bytes, "\r\n\r\n"),
         {:ok, {:http_request, :GET, _path, _version}, headers} <-
           :erlang.decode_packet(:http_bin, head <> "\r\n\r\n", []),
         {:ok, %{"sec-websocket-key" => <<_::binary-size(24)>> = key} = headers} <- headers(headers, %{}),
         "websocket" <- String.downcase(headers["upgrade"] || "") do
      {:ok, %{key: key, origin: headers["origin"], protocol: protocol(headers)}, rest}
    else
      [_all] when byte_size(bytes) <= @max_bytes -> :more
      _no_websocket -> {:error, refused("400 Bad Request", "this port speaks MSP, over TCP or a WebSocket")}
    end
  end

  # A page that offers protocols gives up if none of them is chosen.
  defp protocol(%{"sec-websocket-protocol" => offered}) do
    name = offered |> String.split(",") |> hd() |> String.trim()
    if name =~ ~r/\A[\w.-]{1,64}\z/, do: name
  end

  defp protocol(_none), do: nil

  @doc "The answer of a server that accepts."
  @spec accepted(%{:key => binary, :protocol => String.t() | nil, optional(atom) => term}) :: iodata
  def accepted(%{key: key, protocol: protocol}) do
    [
      "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Accept: ",
      :cow_ws.encode_key(key),
      "\r\n",
      if(protocol, do: ["Sec-WebSocket-Protocol: ", protocol, "\r\n"], else: []),
      "\r\n"
    ]
  end

  @doc "The answer of a server that does not."
  @spec refused(status :: String.t(), text :: String.t()) :: iodata
  def refused(status, text) do
    body = text <> "\n"

    [
      ["HTTP/1.1 ", status, "\r\nContent-Type: text/plain; charset=utf-8\r\nConnection: close\r\n"],
      ["Content-Length: #{byte_size(body)}\r\n\r\n", body]
    ]
  end

  defp location(%{"location" => place}), do: " (#{printable(place)})"
  defp location(_here), do: ""

  defp headers(bytes, headers) do
    case :erlang.decode_packet(:httph_bin, bytes, []) do
      {:ok, {:http_header, _n, name, _raw, value}, rest} ->
        headers(rest, Map.put(headers, name |> to_string() |> String.downcase(), value))

      {:ok, :http_eoh, _rest} ->
        {:ok, headers}

      _broken ->
        :error
    end
  end

  # For logs and terminals.
  defp printable(text), do: text |> String.slice(0, 200) |> String.replace(~r/[^ -~]/, "?")
end
