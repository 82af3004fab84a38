defmodule Aerie.Access.HTTP.Admission do
  @moduledoc """
  Decides who may use `/api` and the WebSocket. Pure, from the facts of a request.

  1. A web page (a request with an `Origin`) must be the server's own or listed in `api.origins`. A request of any other
     page is refused even with a valid key, because browsers send requests for any page.
  2. If keys are configured, a request needs one of them, in `X-Aerie-Key` or as `Authorization: Bearer`.
  3. Without keys only this machine may: the peer is on loopback, no proxy forwards for somebody else, and `Host` is a
     name of this machine, so that a foreign name that points here (DNS rebinding) gets no access.

  For the same reason, metrics and health need no key, but a `Host` that belongs to the gateway (`host/2`).
  """

  alias Aerie.Base.Net.Address
  alias Aerie.Base.Principal
  alias Aerie.Control.Policy.Roles
  alias Aerie.Access.{Keys, Principals}
  alias Aerie.Access.HTTP.Error

  @typedoc """
  * `peer` - address of the other end
  * `forwarded` - whether a proxy says that it forwards for somebody
  * `host`, `origin`, `key` - from the headers; nil if absent
  """
  @type facts :: %{
          peer: :inet.ip_address(),
          forwarded: boolean(),
          host: String.t() | nil,
          origin: String.t() | nil,
          key: String.t() | nil
        }

  @typedoc """
  What requests are checked against: the keys, the allowed origins of other servers' pages, the ports whose pages are the
  gateway's own (a page served by HTTP may open a WebSocket at another port of the same host), and further host names of the
  gateway.
  """
  @type policy :: %{
          keys: [Keys.key()],
          origins: [String.t()],
          ports: [:inet.port_number()],
          hosts: [String.t()]
        }

  @doc "Whose request it is, or why access is refused."
  @spec decide(policy(), facts()) :: {:ok, Principal.t()} | {:error, Error.t()}
  def decide(policy, facts) do
    with :ok <- origin(policy, facts), do: key(policy, facts)
  end

  @doc "Whether somebody may change what needs a role."
  @spec may(Principal.t(), least :: Roles.role()) :: :ok | {:error, Error.t()}
  def may(principal, least) do
    role = Principals.role(principal)

    if Roles.at_least?(role, least),
      do: :ok,
      else: {:error, Error.new(:forbidden, refusal(principal, role, least))}
  end

  defp refusal(%{kind: :client}, _role, least),
    do:
      "this needs the role #{least}, and while no key is configured programs of this machine are operators at most. Make a key in the " <>
        "console (Settings, Keys of programs; bin/run prints its address), or set api.key or api.keys_file, and send it as X-Aerie-Key"

  defp refusal(%{name: name}, :viewer, _least), do: "the key #{name} may only read (role=viewer)"

  defp refusal(%{name: name}, role, least),
    do: "the key #{name} has the role #{role}; this needs #{least}"

  @doc "Whether a page of this origin may use the server. A request without an origin comes from no page."
  @spec origin(policy(), facts()) :: :ok | {:error, Error.t()}
  def origin(_policy, %{origin: nil}), do: :ok

  def origin(policy, %{origin: origin, host: host}) do
    if own?(URI.new(origin), host, policy.ports) or String.downcase(origin) in policy.origins,
      do: :ok,
      else: {:error, Error.new(:forbidden, "pages of this origin may not use the gateway; see api.origins")}
  end

  @doc """
  Whether a request that needs no key may be answered: its `Host` is an address, `localhost`, this machine's name or one of
  `http.hosts`, or it has a valid key. A page whose own name points here (DNS rebinding) has none of these.
  """
  @spec host(policy(), facts()) :: :ok | {:error, Error.t()}
  def host(_policy, %{host: nil}), do: :ok

  def host(policy, %{host: host} = facts) do
    {name, _port} = split(host)

    if address(name) != nil or name in own_names() or name in policy.hosts or
         match?({:ok, _principal}, Keys.check(policy.keys, facts.key)),
       do: :ok,
       else:
         {:error,
          Error.new(
            :forbidden,
            "the Host header is not a name of this gateway; use its address, or add the name to http.hosts"
          )}
  end

  defp own_names do
    {:ok, own} = :inet.gethostname()
    own = own |> to_string() |> String.downcase()
    ["localhost", own, own <> ".local"]
  end

  # The origin "null" (a sandboxed page, a file) is never the server's own.
  defp own?({:ok, %URI{scheme: scheme, host: name, port: port}}, host, ports)
       when scheme in ["http", "https"] and is_binary(name) and is_binary(host) do
    {host, host_port} = split(host)
    String.downcase(name) == host and (port == (host_port || port) or port in ports)
  end

  defp own?(_other, _host, _ports), do: false

  defp key(%{keys: []}, facts) do
    if Address.loopback?(facts.peer) and not facts.forwarded and local_name?(facts.host),
      do: {:ok, Principals.of(:program)},
      else:
        {:error, Error.new(:forbidden, "no key is configured, so only this machine has access; set api.key")}
  end

  defp key(%{keys: keys}, facts) do
    case Keys.check(keys, facts.key) do
      {:ok, principal} -> {:ok, principal}
      {:error, {:expired, day}} -> unauthorized("this key was good until #{day}")
      {:error, :unknown} when facts.key == nil -> unauthorized("the header X-Aerie-Key is missing")
      {:error, :unknown} -> unauthorized("this key is unknown")
    end
  end

  defp unauthorized(message),
    do: {:error, Error.new(:unauthorized, message, %{"www-authenticate" => "Bearer"})}

  defp local_name?(nil), do: true

  defp local_name?(host) do
    {name, _port} = split(host)
    ip = address(name)
    name == "localhost" or (ip != nil and Address.loopback?(ip))
  end

  defp address(name) do
    case :inet.parse_strict_address(String.to_charlist(name)) do
      {:ok, ip} -> ip
      {:error, _reason} -> nil
    end
  end

  # {name in lower case without brackets, port or nil}
  defp split(host) do
    case Regex.run(~r/\A\[?(.*?)\]?(?::(\d{1,5}))?\z/, String.downcase(host)) do
      [_all, name, port] -> {name, String.to_integer(port)}
      [_all, name] -> {name, nil}
      nil -> {host, nil}
    end
  end
end
