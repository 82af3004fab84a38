defmodule Aerie.Api.WebSocket do
  @moduledoc """
  The listener for MAVLink over WebSocket, on a port of its own (`websocket.port`): `ws`, or `wss` only if there is a certificate.

  A handshake must finish within five seconds, its headers have at most 4 KiB each, and there are at most
  `websocket.max_clients` clients.
  """

  alias Aerie.Access.HTTP.Admission
  alias Aerie.Access.HTTP.Utf8Check
  alias Aerie.Api.Listener
  alias Aerie.Api.WebSocket.{Capacity, Handler}

  # Connections beyond the limit, which get an answer that says so.
  @spare 16

  @doc "Child specifications of a gateway's listener; `[]` if `websocket.enabled` is false."
  @spec listener(term(), map(), Admission.policy()) :: [
          {module(), keyword() | tuple()}
        ]
  def listener(gateway, %{enabled: true} = settings, policy) do
    ref = ref(gateway)
    handler = %{gateway: gateway, policy: policy, sign: settings.sign}
    paths = for path <- [~c"/", ~c"/mavlink"], do: {path, Handler, handler}

    protocol = %{
      env: %{dispatch: :cowboy_router.compile([{:_, paths}]), gateway: gateway},
      middlewares: Utf8Check.middlewares(),
      protocols: [:http],
      request_timeout: 5_000,
      idle_timeout: 10_000,
      max_skip_body_length: 0,
      max_keepalive: 10
    }

    # With megabytes in the kernel's buffer, a client that resumes reading would get old frames. A client that takes
    # nothing for ten seconds is disconnected.
    socket =
      [ip: Aerie.Api.Settings.ip(settings.address), port: settings.port, nodelay: true, sndbuf: 65_536] ++
        [send_timeout: 10_000, send_timeout_close: true]

    {transport, connection, socket} = secure(settings, socket)

    # Ranch applies the connection limit per connection supervisor, so there is only one.
    limits = %{
      socket_opts: socket,
      num_acceptors: 2,
      num_conns_sups: 1,
      max_connections: settings.max_clients + @spare
    }

    [
      {Capacity, gateway: gateway, max_clients: settings.max_clients},
      {Listener, {ref, transport, limits, connection, protocol}}
    ]
  end

  def listener(_gateway, _off, _policy), do: []

  @doc "The port on which the listener of a gateway listens."
  @spec port(term()) :: :inet.port_number()
  def port(gateway), do: Listener.port_of(ref(gateway))

  defp secure(%{cert_file: cert, key_file: key}, socket) when is_binary(cert),
    do:
      {:ranch_ssl, :cowboy_tls, socket ++ [certfile: cert, keyfile: key, versions: [:"tlsv1.3", :"tlsv1.2"]]}

  defp secure(_plain, socket), do: {:ranch_tcp, :cowboy_clear, socket}

  defp ref(gateway), do: {__MODULE__, gateway}
end
