defmodule Aerie.Base.Net.Address do
  @moduledoc """
  HOST:PORT of a connection string, and back to text: IPv4, IPv6 in brackets, or a name.

  A link-local IPv6 address says nothing without its interface (`[fe80::1%eth0]`), whose number may change. So it is a
  name still to be resolved, and as an address has that number in its second part, which is 0 in all others.
  """

  import Bitwise

  @interface ~r/\A[A-Za-z0-9_.:@-]{1,15}\z/
  @name ~r/\A(?=.{1,253}\z)[A-Za-z0-9_]([A-Za-z0-9_-]{0,62})(\.[A-Za-z0-9_-]{1,63})*\.?\z/

  @doc """
  Reads `HOST:PORT`. Only a server may leave the host empty (all IPv4 addresses) or ask for port 0 (any free one).

  The error is a text.
  """
  @spec parse(String.t(), server? :: boolean) ::
          {:ok, :inet.ip_address() | String.t(), :inet.port_number()} | {:error, String.t()}
  def parse(text, server?) do
    with {:ok, host, port} <- split(text),
         {:ok, port} <- port(port, server?),
         {:ok, host} <- host(host, server?) do
      {:ok, host, port}
    end
  end

  @doc "Text of an address and port: `127.0.0.1:14550`, `[::1]:14550`, `gcs.local:14550`."
  @spec format(:inet.ip_address() | String.t() | nil, :inet.port_number() | nil) :: String.t()
  def format(host, port) when tuple_size(host) == 8 do
    case scope(host) do
      {host, 0} -> "[#{:inet.ntoa(host)}]:#{port}"
      {host, number} -> "[#{:inet.ntoa(host)}%#{interface(number)}]:#{port}"
    end
  end

  def format(host, port) when is_tuple(host), do: "#{:inet.ntoa(host)}:#{port}"

  def format(host, port),
    do: if(is_binary(host) and host =~ "%", do: "[#{host}]:#{port}", else: "#{host}:#{port}")

  defp interface(number) do
    case :net.if_index2name(number) do
      {:ok, name} -> name
      {:error, _gone} -> number
    end
  end

  @doc "The address with the interface that `host` names behind a `%`; the error is a text."
  @spec scoped(String.t()) :: {:ok, :inet.ip6_address()} | {:error, String.t()}
  def scoped(host) do
    [text, name] = String.split(host, "%", parts: 2)
    {:ok, address} = :inet.parse_ipv6strict_address(String.to_charlist(text))

    with :error <- index(Integer.parse(name)),
         {:error, _reason} <- :net.if_name2index(String.to_charlist(name)) do
      {:error, "there is no interface #{name} for [#{host}]"}
    else
      {:ok, number} -> {:ok, with_scope(address, number)}
    end
  end

  defp index({number, ""}) when number in 1..0xFFFF, do: {:ok, number}
  defp index(_name), do: :error

  @doc "A link-local address with the number of its interface; any other stays as it is."
  @spec with_scope(:inet.ip_address(), non_neg_integer()) :: :inet.ip_address()
  def with_scope({a, 0, c, d, e, f, g, h}, number) when a in 0xFE80..0xFEBF and number in 0..0xFFFF,
    do: {a, number, c, d, e, f, g, h}

  def with_scope(address, _number), do: address

  @doc "An address without, and the number of its interface; 0 for none."
  @spec scope(:inet.ip_address()) :: {:inet.ip_address(), non_neg_integer()}
  def scope({a, number, c, d, e, f, g, h}) when a in 0xFE80..0xFEBF, do: {{a, 0, c, d, e, f, g, h}, number}
  def scope(address), do: {address, 0}

  @doc "Whether an address is this machine's own: 127.0.0.0/8, ::1, and the first one written as IPv6."
  @spec loopback?(:inet.ip_address()) :: boolean()
  def loopback?({127, _, _, _}), do: true
  def loopback?({0, 0, 0, 0, 0, 0, 0, 1}), do: true
  def loopback?({0, 0, 0, 0, 0, 0xFFFF, high, _low}), do: high >>> 8 == 127
  def loopback?(_address), do: false

  defp split("[" <> rest) do
    case String.split(rest, "]:", parts: 2) do
      [host, port] -> {:ok, {:v6, host}, port}
      [_no_end] -> {:error, "the port is missing"}
    end
  end

  defp split(text) do
    case String.split(text, ":") do
      [""] -> {:error, "host and port are missing"}
      [_host] -> {:error, "the port is missing"}
      [host, port] -> {:ok, host, port}
      _more -> {:error, "an IPv6 address needs brackets: [::1]:PORT"}
    end
  end

  defp port("", _server?), do: {:error, "the port is missing"}

  defp port(text, server?) do
    lowest = if server?, do: 0, else: 1

    case Integer.parse(text) do
      {port, ""} when port >= lowest and port <= 65_535 -> {:ok, port}
      _other -> {:error, "#{inspect(text)} is not a port (#{lowest} to 65535)"}
    end
  end

  defp host("", true), do: {:ok, {0, 0, 0, 0}}
  defp host("", false), do: {:error, "the host is missing"}

  defp host({:v6, text}, _server?) do
    case {:inet.parse_ipv6strict_address(String.to_charlist(text)), String.split(text, "%")} do
      {{:ok, {a, _, _, _, _, _, _, _}}, [_address]} when a in 0xFE80..0xFEBF ->
        {:error, "a link-local address needs its interface: [#{text}%eth0]:PORT"}

      {{:ok, address}, [_address]} ->
        {:ok, address}

      {{:ok, {a, _, _, _, _, _, _, _}}, [_address, name]} when a in 0xFE80..0xFEBF ->
        if name =~ @interface, do: {:ok, text}, else: {:error, "#{inspect(name)} is not an interface"}

      _other ->
        {:error, "#{inspect(text)} is not an IPv6 address"}
    end
  end

  defp host(text, _server?) do
    case :inet.parse_ipv4strict_address(String.to_charlist(text)) do
      {:ok, address} -> {:ok, address}
      {:error, _reason} -> name(text)
    end
  end

  # 1.2.3 and 300.1.1.1 are mistyped addresses rather than names.
  defp name(text) do
    if text =~ @name and not (text =~ ~r/\A[0-9.]+\z/) do
      {:ok, text}
    else
      {:error, "#{inspect(text)} is neither an address nor a name"}
    end
  end

  @login ~r{\A([A-Za-z][A-Za-z0-9+.-]*:(?://)?)?.*@}s
  # Values of these are shown; any other may be a password for the other end.
  @open ~w(network id secure gcs baud sysid share speed loop)

  @doc """
  An address or connection string as people may see it, in errors, logs, pages and records: without a login, and
  without the values behind its `?` that are not among the options of links.

      iex> Aerie.Base.Net.Address.shown("ws://ann:pass@10.0.0.5:8765/x?token=abc&id=north")
      "ws://[hidden]@10.0.0.5:8765/x?token=[hidden]&id=north"
  """
  @spec shown(String.t()) :: String.t()
  def shown(text) do
    case text |> String.replace(@login, "\\1[hidden]@") |> String.split("?", parts: 2) do
      [body] -> body
      [body, query] -> body <> "?" <> (query |> String.split("&") |> Enum.map_join("&", &option/1))
    end
  end

  defp option(pair) do
    case String.split(pair, "=", parts: 2) do
      [key, value] when key not in @open and value != "" -> key <> "=[hidden]"
      _open_or_flag -> pair
    end
  end
end
