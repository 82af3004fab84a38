defmodule Aerie.Console.Map.Tiles.Fetcher.Connection do
  @moduledoc """
  GET over HTTP/1.1, by TLS for https, with the connection kept for the next one. Whatever a server sends, an answer
  takes at most so long and so many bytes. Certificates are verified. A redirect may go elsewhere, but not from https
  to http.

  Errors are texts without the address, which may have a key in it.
  """

  @connect_ms 5_000
  @total_ms 15_000
  @max_body 2 * 1_048_576
  @max_line 16_384
  @max_headers 100
  @redirects 3

  @enforce_keys [:by, :socket, :origin]
  defstruct @enforce_keys

  @type t :: %__MODULE__{by: module(), socket: term(), origin: term()}
  @type answer ::
          {:ok, status :: pos_integer(), %{String.t() => String.t()}, body :: binary()} | {:error, String.t()}

  @doc "Options, for tests: `:cacerts`, `:total_ms`."
  @spec get(t() | nil, url :: String.t(), [{String.t(), String.t()}], keyword()) :: {answer(), t() | nil}
  def get(conn, url, headers, options \\ []) do
    deadline = now() + Keyword.get(options, :total_ms, @total_ms)
    follow(conn, URI.parse(url), headers, Map.new(options) |> Map.put(:deadline, deadline), @redirects)
  end

  @doc "Closes a connection."
  @spec close(t() | nil) :: nil
  def close(nil), do: nil

  def close(%{by: by, socket: socket}) do
    _ = by.close(socket)
    nil
  end

  defp follow(conn, uri, headers, options, left) do
    {answer, conn} = once(conn, uri, headers, options)

    case answer do
      {:ok, status, %{"location" => location}, _body} when status in [301, 302, 303, 307, 308] ->
        next = URI.merge(uri, location)

        cond do
          left == 0 ->
            {{:error, "it redirects more than #{@redirects} times"}, close(conn)}

          next.scheme not in ["https", uri.scheme] ->
            {{:error, "it redirects to #{next.scheme}"}, close(conn)}

          true ->
            follow(conn, next, headers, options, left - 1)
        end

      answer ->
        {answer, conn}
    end
  rescue
    # From URI.merge.
    _error in [URI.Error, ArgumentError] ->
      {{:error, "it redirects to something without an address"}, close(conn)}
  end

  defp once(conn, uri, headers, options) do
    origin = {uri.scheme, uri.host, uri.port}

    if conn != nil and conn.origin == origin do
      case ask(conn, uri, headers, options.deadline) do
        # The server closed it meanwhile.
        {{:error, :closed}, _closed} -> anew(origin, uri, headers, options)
        {answer, conn} -> {told(answer), conn}
      end
    else
      close(conn)
      anew(origin, uri, headers, options)
    end
  end

  defp anew(origin, uri, headers, options) do
    case connect(origin, options) do
      {:ok, conn} ->
        {answer, conn} = ask(conn, uri, headers, options.deadline)
        {told(answer), conn}

      {:error, reason} ->
        {told({:error, reason}), nil}
    end
  end

  defp connect({scheme, host, port} = origin, options) do
    left = min(left(options.deadline), @connect_ms)

    with {:ok, plain} <- plain(to_charlist(host), port, left),
         {:ok, by, socket} <- secure(scheme, plain, to_charlist(host), options, left),
         do: {:ok, %__MODULE__{by: by, socket: socket, origin: origin}}
  end

  defp plain(host, port, ms) do
    options = [
      :binary,
      active: false,
      packet: :raw,
      packet_size: @max_line,
      nodelay: true,
      send_timeout: 5_000
    ]

    with {:error, reason} when reason in [:nxdomain, :ehostunreach, :enetunreach] <-
           :gen_tcp.connect(host, port, options, ms),
         do: :gen_tcp.connect(host, port, [:inet6 | options], ms)
  end

  defp secure("http", plain, _host, _options, _ms), do: {:ok, :gen_tcp, plain}

  defp secure("https", plain, host, options, ms) do
    checks = [
      verify: :verify_peer,
      cacerts: options[:cacerts] || :public_key.cacerts_get(),
      depth: 5,
      versions: [:"tlsv1.3", :"tlsv1.2"],
      server_name_indication: host,
      customize_hostname_check: [match_fun: :public_key.pkix_verify_hostname_match_fun(:https)],
      packet_size: @max_line,
      log_level: :none
    ]

    case :ssl.connect(plain, checks, ms) do
      {:ok, socket} ->
        {:ok, :ssl, socket}

      {:error, reason} ->
        :gen_tcp.close(plain)
        {:error, reason}
    end
  rescue
    # Raised by cacerts_get/0 if the system has none.
    _none in [ErlangError, MatchError] -> {:error, "this system has no certificate authorities"}
  end

  defp ask(%{by: by, socket: socket} = conn, uri, headers, deadline) do
    # A connection that ends with its answer is an answer; one that ends before it is :closed.
    lines = for {name, value} <- headers, do: [name, ": ", value, "\r\n"]
    path = [uri.path || "/", if(uri.query, do: ["?", uri.query], else: [])]

    with :ok <- options(conn, packet: :http_bin),
         :ok <- by.send(socket, ["GET ", path, " HTTP/1.1\r\nhost: ", host(uri), "\r\n", lines, "\r\n"]),
         {:ok, status, headers} <- head(conn, deadline, 3),
         {:ok, body} <- body(conn, status, headers, deadline) do
      kept? =
        headers["connection"] != "close" and
          (is_map_key(headers, "content-length") or chunked?(headers) or status in [204, 304])

      {{:ok, status, headers, body}, if(kept?, do: conn, else: close(conn))}
    else
      {:error, reason} -> {{:error, reason}, close(conn)}
    end
  end

  defp host(%{host: host, port: port}), do: if(port in [80, 443], do: host, else: "#{host}:#{port}")

  # Answers of 1xx come before the one that counts.
  defp head(_conn, _deadline, 0), do: {:error, "it does not answer the question"}

  defp head(conn, deadline, left) do
    with {:ok, {:http_response, _version, status, _words}} <- recv(conn, 0, deadline),
         {:ok, headers} <- headers(conn, deadline, %{}, @max_headers) do
      if status in 100..199, do: head(conn, deadline, left - 1), else: {:ok, status, headers}
    else
      {:ok, _other} -> {:error, "its answer is not HTTP"}
      error -> error
    end
  end

  defp headers(_conn, _deadline, _headers, 0), do: {:error, "it sends more than #{@max_headers} headers"}

  defp headers(conn, deadline, headers, left) do
    case recv(conn, 0, deadline) do
      {:ok, {:http_header, _number, name, _name, value}} ->
        name = name |> to_string() |> String.downcase()
        headers(conn, deadline, Map.put_new(headers, name, value), left - 1)

      {:ok, :http_eoh} ->
        {:ok, headers}

      {:ok, _other} ->
        {:error, "its answer is not HTTP"}

      error ->
        error
    end
  end

  defp body(_conn, status, _headers, _deadline) when status in [204, 304], do: {:ok, ""}

  defp body(conn, _status, headers, deadline) do
    cond do
      chunked?(headers) ->
        chunks(conn, deadline, [], 0)

      is_map_key(headers, "content-length") ->
        with :ok <- options(conn, packet: :raw),
             do: sized(conn, Integer.parse(headers["content-length"]), deadline)

      true ->
        with :ok <- options(conn, packet: :raw), do: rest(conn, deadline, [], 0)
    end
  end

  defp chunked?(headers), do: String.downcase(headers["transfer-encoding"] || "") =~ "chunked"

  defp sized(_conn, {0, ""}, _deadline), do: {:ok, ""}
  defp sized(conn, {size, ""}, deadline) when size in 1..@max_body, do: recv(conn, size, deadline)
  defp sized(_conn, {size, ""}, _deadline) when size > @max_body, do: too_large()
  defp sized(_conn, _other, _deadline), do: {:error, "its answer has no length"}

  defp rest(_conn, _deadline, _parts, size) when size > @max_body, do: too_large()

  defp rest(conn, deadline, parts, size) do
    case recv(conn, 0, deadline) do
      {:ok, part} -> rest(conn, deadline, [parts, part], size + byte_size(part))
      {:error, :closed} -> {:ok, IO.iodata_to_binary(parts)}
      error -> error
    end
  end

  defp chunks(conn, deadline, parts, size) do
    with :ok <- options(conn, packet: :line),
         {:ok, line} <- recv(conn, 0, deadline),
         {length, _extension} <- Integer.parse(line, 16),
         true <- length >= 0 do
      cond do
        size + length > @max_body -> too_large()
        length == 0 -> trailer(conn, deadline, IO.iodata_to_binary(parts), @max_headers)
        true -> chunk(conn, deadline, parts, size, length)
      end
    else
      {:error, reason} -> {:error, reason}
      _no_length -> {:error, "its answer is not HTTP"}
    end
  end

  defp chunk(conn, deadline, parts, size, length) do
    with :ok <- options(conn, packet: :raw),
         {:ok, <<part::binary-size(^length), "\r\n">>} <- recv(conn, length + 2, deadline) do
      chunks(conn, deadline, [parts, part], size + length)
    else
      {:ok, _other} -> {:error, "its answer is not HTTP"}
      error -> error
    end
  end

  defp trailer(_conn, _deadline, _body, 0), do: {:error, "it sends more than #{@max_headers} headers"}

  defp trailer(conn, deadline, body, left) do
    case recv(conn, 0, deadline) do
      {:ok, "\r\n"} -> {:ok, body}
      {:ok, _line} -> trailer(conn, deadline, body, left - 1)
      error -> error
    end
  end

  defp too_large, do: {:error, "its answer has more than #{@max_body} bytes"}

  defp options(%{by: :ssl, socket: socket}, options), do: :ssl.setopts(socket, options)
  defp options(%{socket: socket}, options), do: :inet.setopts(socket, options)

  defp recv(%{by: by, socket: socket}, length, deadline) do
    case left(deadline) do
      0 -> {:error, :timeout}
      ms -> by.recv(socket, length, ms)
    end
  end

  defp left(deadline), do: max(deadline - now(), 0)
  defp now, do: System.monotonic_time(:millisecond)

  defp told({:error, reason}) when is_binary(reason), do: {:error, reason}
  defp told({:error, :nxdomain}), do: {:error, "its name is not known here: no internet?"}

  defp told({:error, reason}) when reason in [:timeout, :etimedout],
    do: {:error, "it does not answer in time"}

  defp told({:error, :closed}), do: {:error, "it closed the connection"}

  defp told({:error, {:tls_alert, {name, _text}}}),
    do: {:error, "its certificate or its TLS is refused (#{name})"}

  defp told({:error, reason}) when is_atom(reason), do: {:error, "#{:inet.format_error(reason)}"}
  defp told({:error, _reason}), do: {:error, "the connection failed"}
  defp told(answer), do: answer
end
