defmodule Gnat.Transport do
  @moduledoc """
  A TCP or TLS connection as one value.

  Passive while it is made (`recv/2` with a deadline), then switched to messages with `activate/1`. Messages come in
  batches of at most #{100} reads before the socket asks again, so a server that sends faster than this process works is slowed
  down by TCP instead of filling the mailbox. Sending never blocks for longer than the settings' `send_timeout`.
  """

  alias Gnat.Error

  @active 100

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

  @doc "Makes it a TLS connection. `ssl_opts` wins over the defaults: the system's authorities, the host's name checked."
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
  def send(%__MODULE__{kind: :tcp, socket: socket}, iodata) do
    with {:error, reason} <- :gen_tcp.send(socket, iodata), do: failed(reason)
  end

  def send(%__MODULE__{kind: :tls, socket: socket}, iodata) do
    with {:error, reason} <- :ssl.send(socket, iodata), do: failed(reason)
  end

  @doc "Reads what has arrived, or arrives before the deadline."
  @spec recv(t(), deadline()) :: {:ok, binary()} | {:error, Error.t()}
  def recv(%__MODULE__{kind: :tcp, socket: socket}, deadline) do
    with {:error, reason} <- :gen_tcp.recv(socket, 0, left(deadline)), do: failed(reason)
  end

  def recv(%__MODULE__{kind: :tls, socket: socket}, deadline) do
    with {:error, reason} <- :ssl.recv(socket, 0, left(deadline)), do: failed(reason)
  end

  @spec close(t()) :: :ok
  def close(%__MODULE__{kind: :tcp, socket: socket}), do: :gen_tcp.close(socket)

  def close(%__MODULE__{kind: :tls, socket: socket}) do
    _ = :ssl.close(socket)
    :ok
  end

  @doc "Gives the connection to another process; only while it is passive."
  @spec give(t(), pid()) :: :ok | {:error, Error.t()}
  def give(%__MODULE__{kind: :tcp, socket: socket}, pid) do
    with {:error, reason} <- :gen_tcp.controlling_process(socket, pid), do: failed(reason)
  end

  def give(%__MODULE__{kind: :tls, socket: socket}, pid) do
    with {:error, reason} <- :ssl.controlling_process(socket, pid), do: failed(reason)
  end

  @spec activate(t()) :: :ok | {:error, Error.t()}
  def activate(%__MODULE__{kind: :tcp, socket: socket}) do
    with {:error, reason} <- :inet.setopts(socket, active: @active), do: failed(reason)
  end

  def activate(%__MODULE__{kind: :tls, socket: socket}) do
    with {:error, reason} <- :ssl.setopts(socket, active: @active), do: failed(reason)
  end

  @doc "Reads a message of the process as one of this connection's, if it is one."
  @spec message(t(), term()) :: {:data, binary()} | :passive | {:closed, Error.t()} | :unknown
  def message(%__MODULE__{kind: :tcp, socket: socket}, message) do
    case message do
      {:tcp, ^socket, data} -> {:data, data}
      {:tcp_passive, ^socket} -> :passive
      {:tcp_closed, ^socket} -> {:closed, Error.new(:closed)}
      {:tcp_error, ^socket, reason} -> {:closed, Error.new({:transport, reason})}
      _other -> :unknown
    end
  end

  def message(%__MODULE__{kind: :tls, socket: socket}, message) do
    case message do
      {:ssl, ^socket, data} -> {:data, data}
      {:ssl_passive, ^socket} -> :passive
      {:ssl_closed, ^socket} -> {:closed, Error.new(:closed)}
      {:ssl_error, ^socket, reason} -> {:closed, Error.new({:transport, reason})}
      _other -> :unknown
    end
  end

  defp failed(:closed), do: {:error, Error.new(:closed)}
  defp failed(:timeout), do: {:error, Error.new(:timeout)}
  defp failed({:tls_alert, _} = alert), do: {:error, Error.new({:tls, alert})}
  defp failed(reason), do: {:error, Error.new({:transport, reason})}

  # A name that has no IPv4 address may have an IPv6 one.
  defp tcp(address, settings, deadline) do
    opts = tcp_opts(settings)

    case :gen_tcp.connect(address, settings.port, family(address) ++ opts, left(deadline)) do
      {:error, :nxdomain} when is_list(address) ->
        if :inet6 in opts do
          {:error, :nxdomain}
        else
          :gen_tcp.connect(address, settings.port, [:inet6 | opts], left(deadline))
        end

      result ->
        result
    end
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
    # A refusal is returned as an error; :ssl need not log it as well.
    opts = Keyword.merge([{:log_level, :error} | name_opts(address(host))], given)
    trust = [:verify, :cacerts, :cacertfile]

    if Enum.any?(trust, &Keyword.has_key?(opts, &1)) do
      {:ok, opts}
    else
      {:ok, [verify: :verify_peer, cacerts: :public_key.cacerts_get()] ++ opts}
    end
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
