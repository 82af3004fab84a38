defmodule Aerie.Base.Settings.Types do
  @moduledoc """
  The texts with a form of their own in the configuration: names, addresses, URLs. Each parser is total: `{:ok, value}`
  or `:error`, and nothing becomes an atom.
  """

  alias Aerie.Base.Settings.Field

  @doc "A name that can stand in a NATS subject: letters, digits, `-` and `_`, at most 64 bytes."
  @spec token() :: Field.type()
  def token do
    {:parse, &parse_token/1,
     "a name of at most 64 letters, digits, - and _ (it becomes part of NATS subjects)"}
  end

  @doc "A system id, or `auto`. Gives a number or `:auto`."
  @spec system_id() :: Field.type()
  def system_id, do: {:parse, &parse_system_id/1, "an integer from 1 to 4294967295, or auto"}

  @doc "`HOST:PORT`, `:PORT` (all addresses) or `[IPV6]:PORT`; or `off`. Gives `{host, port}` or `:off`."
  @spec listen_address() :: Field.type()
  def listen_address do
    {:parse, &parse_listen/1, "HOST:PORT, :PORT for all addresses, or off"}
  end

  @doc "A numeric address to listen on, IPv4 or IPv6. Gives the text."
  @spec ip() :: Field.type()
  def ip, do: {:parse, &parse_ip/1, "an IP address such as 127.0.0.1 or ::1"}

  @doc "`nats://[user:password@]host[:port]`, also `tls://`. Gives the text."
  @spec nats_url() :: Field.type()
  def nats_url, do: {:parse, &parse_nats_url/1, "a URL such as nats://host:4222 or tls://host:4222"}

  @doc "The name of a host, without a port. Gives the text in lower case."
  @spec host() :: Field.type()
  def host, do: {:parse, &parse_host/1, "the name of a host such as gateway.example.org"}

  @doc false
  @spec parse_host(String.t()) :: {:ok, String.t()} | :error
  def parse_host(text) do
    if byte_size(text) <= 253 and text =~ ~r/\A[A-Za-z0-9_-]+(\.[A-Za-z0-9_-]+)*\z/,
      do: {:ok, String.downcase(text)},
      else: :error
  end

  @doc "The origin of a web page, `SCHEME://HOST[:PORT]`, as browsers send it. Gives the text in lower case."
  @spec origin() :: Field.type()
  def origin,
    do: {:parse, &parse_origin/1, "an origin such as https://gcs.example.org or http://10.0.0.2:8080"}

  @doc false
  @spec parse_origin(String.t()) :: {:ok, String.t()} | :error
  def parse_origin(text) do
    case URI.new(text) do
      {:ok, %URI{scheme: scheme, host: host, path: nil, query: nil, fragment: nil, userinfo: nil}}
      when scheme in ["http", "https"] and is_binary(host) and host != "" ->
        {:ok, String.downcase(text)}

      _ ->
        :error
    end
  end

  @doc false
  @spec parse_token(String.t()) :: {:ok, String.t()} | :error
  def parse_token(text) do
    if Regex.match?(~r/\A[A-Za-z0-9_-]{1,64}\z/, text), do: {:ok, text}, else: :error
  end

  @doc false
  @spec parse_system_id(String.t()) :: {:ok, pos_integer | :auto} | :error
  def parse_system_id("auto"), do: {:ok, :auto}

  def parse_system_id(text) do
    with {n, ""} when n in 1..4_294_967_295 <- Integer.parse(text), do: {:ok, n}, else: (_ -> :error)
  end

  @doc false
  @spec parse_listen(String.t()) :: {:ok, {String.t(), :inet.port_number()} | :off} | :error
  def parse_listen("off"), do: {:ok, :off}
  # YAML 1.1 reads a bare `off` as false on some paths; it means the same here.
  def parse_listen("false"), do: {:ok, :off}

  def parse_listen(text) do
    with [_, host, port] <- Regex.run(~r/\A(\[[0-9A-Fa-f:.]+\]|[^:\s\[\]]*):(\d{1,5})\z/, text),
         {port, ""} when port in 0..65_535 <- Integer.parse(port) do
      {:ok, {if(host == "", do: "0.0.0.0", else: String.trim(host, "[") |> String.trim("]")), port}}
    else
      _ -> :error
    end
  end

  @doc false
  @spec parse_ip(String.t()) :: {:ok, String.t()} | :error
  def parse_ip(text) do
    # A server cannot be bound to the interface behind a %, which would be left out without a word.
    case :inet.parse_strict_address(String.to_charlist(text)) do
      {:ok, _ip} -> if text =~ "%", do: :error, else: {:ok, text}
      {:error, _} -> :error
    end
  end

  @doc false
  @spec parse_nats_url(String.t()) :: {:ok, String.t()} | :error
  def parse_nats_url(text) do
    case URI.new(text) do
      {:ok, %URI{scheme: scheme, host: host, port: port, path: path, query: nil, fragment: nil}}
      when scheme in ["nats", "tls"] and is_binary(host) and host != "" and path in [nil, "", "/"] and
             (port == nil or port in 1..65_535) ->
        {:ok, text}

      _ ->
        :error
    end
  end
end
