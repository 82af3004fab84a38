defmodule Aerie.Fleet.Bridge.Connection.Settings do
  @moduledoc "The settings of a `Gnat` connection, from the configuration. Secrets are revealed only here."

  alias Aerie.Fleet.Bridge
  alias Aerie.Fleet.Bridge.NatsServer.Token
  alias Aerie.Base.Secret

  # A server that does not read must not hold the client up for ever. The Hex package sets none of these.
  @tcp [nodelay: true, keepalive: true, send_timeout: 10_000, send_timeout_close: true]

  @doc "Settings for one of the URLs, or why there are none (an unreadable file)."
  @spec gnat(Bridge.Settings.t(), String.t()) :: {:ok, map()} | {:error, String.t()}
  def gnat(%Bridge.Settings{nats: nats}, url) do
    uri = URI.parse(url)
    host = uri.host |> String.trim("[") |> String.trim("]")

    with {:ok, auth} <- auth(nats) do
      settings =
        %{
          host: host,
          port: uri.port || 4222,
          connection_timeout: round(nats.connect_timeout_s * 1000),
          no_responders: true,
          tcp_opts: [:binary] ++ family(host) ++ @tcp
        }
        |> Map.merge(auth)
        |> Map.merge(tls(nats, uri.scheme, host))

      {:ok, settings}
    end
  end

  defp family(host), do: if(String.contains?(host, ":"), do: [:inet6], else: [])

  # The embedded server's token is in its folder.
  defp auth(%{mode: :embedded} = nats),
    do: with({:ok, token} <- Token.read(nats), do: {:ok, %{token: token, auth_required: true}})

  defp auth(%{credentials: file}) when file != nil,
    do: with({:ok, parts} <- Nkey.Credentials.read(file), do: {:ok, Map.put(parts, :auth_required, true)})

  defp auth(%{nkey_seed_file: file}) when file != nil do
    case File.read(file) do
      {:ok, text} -> {:ok, %{nkey_seed: String.trim(text), auth_required: true}}
      {:error, reason} -> {:error, "cannot read nats.nkey_seed_file #{file}: #{:file.format_error(reason)}"}
    end
  end

  defp auth(%{token: token}) when token != nil,
    do: {:ok, %{token: Secret.reveal(token), auth_required: true}}

  defp auth(%{user: user, password: password}) when user != nil,
    do: {:ok, %{username: user, password: Secret.reveal(password) || "", auth_required: true}}

  defp auth(_anonymous), do: {:ok, %{}}

  defp tls(%{tls: %{enabled: false}}, scheme, _host) when scheme != "tls", do: %{}

  defp tls(%{tls: tls}, _scheme, host) do
    verify =
      if tls.verify do
        trusted = if tls.ca_file, do: [cacertfile: tls.ca_file], else: [cacerts: :public_key.cacerts_get()]
        name = String.to_charlist(tls.server_name || host)
        match = [match_fun: :public_key.pkix_verify_hostname_match_fun(:https)]

        trusted ++
          [verify: :verify_peer, depth: 5, server_name_indication: name, customize_hostname_check: match]
      else
        [verify: :verify_none]
      end

    own = if tls.cert_file, do: [certfile: tls.cert_file, keyfile: tls.key_file], else: []
    %{tls: true, ssl_opts: verify ++ own}
  end
end
