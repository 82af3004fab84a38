defmodule Gnat.Transport do
  @active 100

  @moduledoc """
  A TCP or TLS connection as one value.

  Passive while connecting (`recv/2` with a deadline), then switched to messages with `activate/1`. Messages come in
  batches of at most #{@active} reads before the socket asks again, so that TCP slows a fast server down instead of filling the
  mailbox. Sending never blocks for longer than the settings' `send_timeout`.
  """

  alias Gnat.Error

  @enforce_keys [:kind, :socket]
  defstruct @enforce_keys

  @type t :: %__MODULE__{kind: :tcp | :tls, socket: :inet.socket() | :ssl.sslsocket()}
  @type deadline :: integer()

  @doc "A point in time `ms` from now, for the functions that take one."
  @spec deadline(non_neg_integer()) :: deadline()
  def deadline(ms) when is_integer(ms), do: System.monotonic_time(:millisecond) + ms

  @spec connect(Gnat.Settings.t(), deadline()) :: {:ok, t()} | {:error, Error.t()}
  def connect(settings, deadline) do
    address = address(settings.host)

    case tcp(address, settings, deadline) do
      {:ok, socket} -> {:ok, %__MODULE__{kind: :tcp, socket: socket}}
      {:error, reason} -> {:error, Error.new({:connect, reason})}
    end
  end

  @doc "Upgrades to TLS. `ssl_opts` override the defaults: the system's authorities, and a check of the host's name."
  @spec upgrade(t(), Gnat.Settings.t(), deadline()) :: {:ok, t()} | {:error, Error.t()}
  def upgrade(%__MODULE__{kind: :tcp, socket: socket}, settings, deadline) do
    with {:ok, opts} <- tls_opts(settings) do
      case :ssl.connect(socket, opts, left(deadline)) do
        {:ok, tls} -> {:ok, %__MODULE__{kind: :tls, socket: tls}}
        {:error, reason} -> {:error, Error.new({:tls, reason})}
      end
    end
  end

  @spec send(t(), iodata()) :: :ok | {:error, Error.t()}
  def send(%__MODULE__{kind: kind, socket: socket}, iodata) do
    with {:error, reason} <- module(kind).send(socket, iodata), do: failed(reason)
  end

  @doc "Reads what has arrived, or arrives before the deadline."
  @spec recv(t(), deadline()) :: {:ok, binary()} | {:error, Error.t()}
  def recv(%__MODULE__{kind: kind, socket: socket}, deadline) do
    with {:error, reason} <- module(kind).recv(socket, 0, left(deadline)), do: failed(reason)
  end

  @spec close(t()) :: :ok
  def close(%__MODULE__{kind: kind, socket: socket}) do
    _ = module(kind).close(socket)
    :ok
  end

  @doc "Gives the connection to another process; only while it is passive."
  @spec give(t(), pid()) :: :ok | {:error, Error.t()}
  def give(%__MODULE__{kind: kind, socket: socket}, pid) do
    with {:error, reason} <- module(kind).controlling_process(socket, pid), do: failed(reason)
  end

  @spec activate(t()) :: :ok | {:error, Error.t()}
  def activate(%__MODULE__{kind: kind, socket: socket}) do
    options = if kind == :tcp, do: :inet, else: :ssl
    with {:error, reason} <- options.setopts(socket, active: @active), do: failed(reason)
  end

  defp module(:tcp), do: :gen_tcp
  defp module(:tls), do: :ssl

  @doc "Reads a message of the process as one of this connection's, if it is one."
  @spec message(t(), term()) :: {:data, binary()} | :passive | {:closed, Error.t()} | :unknown
  def message(%__MODULE__{kind: kind, socket: socket}, message) when elem(message, 1) == socket do
    case {kind, message} do
      {:tcp, {:tcp, _, data}} -> {:data, data}
      {:tls, {:ssl, _, data}} -> {:data, data}
      {:tcp, {:tcp_passive, _}} -> :passive
      {:tls, {:ssl_passive, _}} -> :passive
      {:tcp, {:tcp_closed, _}} -> {:closed, Error.new(:closed)}
      {:tls, {:ssl_closed, _}} -> {:closed, Error.new(:closed)}
      {:tcp, {:tcp_error, _, reason}} -> {:closed, Error.new({:transport, reason})}
      {:tls, {:ssl_error, _, reason}} -> {:closed, Error.new({:transport, reason})}
      _other -> :unknown
    end
  end

  def message(_transport, _message), do: :unknown

  defp failed(:closed), do: {:error, Error.new(:closed)}
  defp failed(:timeout), do: {:error, Error.new(:timeout)}
  defp failed({:tls_alert, _} = alert), do: {:error, Error.new({:tls, alert})}
  defp failed(reason), do: {:error, Error.new({:transport, reason})}

  # All addresses of a name are tried, IPv4 first, each for its share of the time; the error is that of the last one.
  defp tcp(name, settings, deadline) when is_list(name) do
    opts = tcp_opts(settings)
    families = if :inet6 in opts, do: [:inet6], else: [:inet, :inet6]

    addresses =
      for family <- families, {:ok, found} <- [:inet.getaddrs(name, family)], address <- found, do: address

    try_each(Enum.uniq(addresses), settings, deadline, {:error, :nxdomain})
  end

  defp tcp(address, settings, deadline), do: connect_to(address, settings, left(deadline))

  defp try_each([], _settings, _deadline, last), do: last

  defp try_each([address | others] = all, settings, deadline, _last) do
    case connect_to(address, settings, div(left(deadline), length(all))) do
      {:ok, socket} -> {:ok, socket}
      error -> try_each(others, settings, deadline, error)
    end
  end

  defp connect_to(address, settings, timeout) do
    opts = List.delete(tcp_opts(settings), :inet6)
    :gen_tcp.connect(address, settings.port, family(address) ++ opts, timeout)
  end

  defp tcp_opts(settings) do
    opts = Enum.reject(settings.tcp_opts, &(&1 in [:binary, :list] or match?({:active, _}, &1)))

    defaults = [
      nodelay: true,
      keepalive: true,
      buffer: 65_536,
      send_timeout: settings.send_timeout,
      send_timeout_close: true
    ]

    given = for {key, _value} <- opts, do: key
    [:binary, active: false, packet: :raw] ++ opts ++ Keyword.drop(defaults, given)
  end

  defp address(host) when is_tuple(host), do: host

  defp address(host) do
    host = to_charlist(host)

    case :inet.parse_strict_address(host) do
      {:ok, address} -> address
      {:error, :einval} -> host
    end
  end

  defp family(address) when tuple_size(address) == 8, do: [:inet6]
  defp family(_address), do: []

  defp tls_opts(%{ssl_opts: given, host: host}) do
    # A refusal is returned as an error, so :ssl need not log it.
    opts = Keyword.merge([{:log_level, :error} | name_opts(address(host))], given)
    trust = [:verify, :cacerts, :cacertfile]

    if Enum.any?(trust, &Keyword.has_key?(opts, &1)),
      do: {:ok, opts},
      else:
        with(
          {:ok, authorities} <- authorities(),
          do: {:ok, [verify: :verify_peer, cacerts: authorities] ++ opts}
        )
  end

  defp authorities do
    {:ok, :public_key.cacerts_get()}
  rescue
    _no_store in [ErlangError, MatchError, FunctionClauseError] ->
      {:error,
       Error.new({:tls, "no certificate authorities on this system; give ssl_opts cacertfile: or cacerts:"})}
  end

  defp name_opts(address) when is_tuple(address),
    do: [server_name_indication: :inet.ntoa(address)] ++ wildcard()

  defp name_opts(name), do: [server_name_indication: name] ++ wildcard()

  defp wildcard do
    [customize_hostname_check: [match_fun: :public_key.pkix_verify_hostname_match_fun(:https)]]
  end

  defp left(deadline), do: max(deadline - System.monotonic_time(:millisecond), 0)
end
