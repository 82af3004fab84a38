defmodule FleetWeb.API.Access do
  @moduledoc """
  Who may use `/api` and the WebSocket. Pure, from the facts of a request.

  1. A web page (a request with an `Origin`) must be one of the server's own or of `api.origins`; any other page's is
     refused whatever key it brings, because browsers send requests for anybody's page.
  2. With keys configured, a request needs one of them, in `X-Aerie-Key` or as `Authorization: Bearer`.
  3. Without, only this machine may: the peer is on loopback, is no proxy that speaks for somebody else, and the `Host`
     is a name of this machine, so that a foreign name that was made to point here (DNS rebinding) leads nowhere.

  Metrics and health want no key, but a `Host` that is the gateway's (`host/2`), for the same reason.
  """

  alias Aerie.Client.Keys
  alias FleetWeb.API.Error

  @typedoc """
  * `peer` - address of the other end
  * `forwarded` - whether a proxy says that it speaks for somebody
  * `host`, `origin`, `key` - from the headers; nil when absent
  """
  @type facts :: %{
          peer: :inet.ip_address(),
          forwarded: boolean(),
          host: String.t() | nil,
          origin: String.t() | nil,
          key: String.t() | nil
        }

  @typedoc """
  What is checked against: the keys, the origins of other servers' pages that are allowed, the ports whose pages are
  the gateway's own (HTTP serves the console, which opens a WebSocket at another port of the same host), and further names
  that the gateway is called by.
  """
  @type policy :: %{
          keys: [Keys.key()],
          origins: [String.t()],
          ports: [:inet.port_number()],
          hosts: [String.t()]
        }

  @doc "The name of who asks (a key's name, or `\"local\"`), or why not."
  @spec decide(policy(), facts()) :: {:ok, String.t()} | {:error, Error.t()}
  def decide(policy, facts) do
    with :ok <- origin(policy, facts), do: key(policy, facts)
  end

  @doc "Whether a page of this origin may use the server; no origin is no page."
  @spec origin(policy(), facts()) :: :ok | {:error, Error.t()}
  def origin(_policy, %{origin: nil}), do: :ok

  def origin(policy, %{origin: origin, host: host}) do
    if own?(URI.new(origin), host, policy.ports) or String.downcase(origin) in policy.origins,
      do: :ok,
      else: {:error, Error.new(:forbidden, "pages of this origin may not use the gateway; see api.origins")}
  end

  @doc """
  Whether a request that needs no key may be answered: its `Host` is an address, `localhost`, this machine's name or one of
  `http.hosts`, or it brings a key. A page that had its own name pointed here (DNS rebinding) has none of these.
  """
  @spec host(policy(), facts()) :: :ok | {:error, Error.t()}
  def host(_policy, %{host: nil}), do: :ok

  def host(policy, %{host: host} = facts) do
    {name, _port} = split(host)

    if address(name) != nil or name in own_names() or name in policy.hosts or
         Keys.check(policy.keys, facts.key) != :error,
       do: :ok,
       else:
         {:error, Error.new(:forbidden, "this is not the gateway's name; use its address, or see http.hosts")}
  end

  defp own_names do
    {:ok, own} = :inet.gethostname()
    own = own |> to_string() |> String.downcase()
    ["localhost", own, own <> ".local"]
  end

  # "null" (a sandboxed page, a file) is nobody's own.
  defp own?({:ok, %URI{scheme: scheme, host: name, port: port}}, host, ports)
       when scheme in ["http", "https"] and is_binary(name) and is_binary(host) do
    {host, host_port} = split(host)
    String.downcase(name) == host and (port == (host_port || port) or port in ports)
  end

  defp own?(_other, _host, _ports), do: false

  defp key(%{keys: []}, facts) do
    if Keys.loopback?(facts.peer) and not facts.forwarded and local_name?(facts.host),
      do: {:ok, "local"},
      else: {:error, Error.new(:forbidden, "no key is configured, so only this machine may; set api.key")}
  end

  defp key(%{keys: keys}, facts) do
    with :error <- Keys.check(keys, facts.key) do
      message = if facts.key, do: "this key is not known", else: "the header X-Aerie-Key is missing"
      {:error, Error.new(:unauthorized, message, %{"www-authenticate" => "Bearer"})}
    end
  end

  defp local_name?(nil), do: true

  defp local_name?(host) do
    {name, _port} = split(host)
    ip = address(name)
    name == "localhost" or (ip != nil and Keys.loopback?(ip))
  end

  defp address(name) do
    case :inet.parse_strict_address(String.to_charlist(name)) do
      {:ok, ip} -> ip
      {:error, _reason} -> nil
    end
  end

  # Name in lower case and without brackets, port if there is one.
  defp split(host) do
    case Regex.run(~r/\A\[?(.*?)\]?(?::(\d{1,5}))?\z/, String.downcase(host)) do
      [_all, name, port] -> {name, String.to_integer(port)}
      [_all, name] -> {name, nil}
      nil -> {host, nil}
    end
  end
end
