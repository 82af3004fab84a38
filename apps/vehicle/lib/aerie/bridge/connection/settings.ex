defmodule Aerie.Bridge.Connection.Settings do
  @moduledoc "The settings of a `Gnat` connection from the configuration. The one place where secrets are revealed."

  alias Aerie.Config
  alias Aerie.Config.Secret

  @doc "Settings for one of the URLs, or why there are none (a file that cannot be read)."
  @spec gnat(Config.t(), String.t()) :: {:ok, map()} | {:error, String.t()}
  def gnat(%Config{nats: nats}, url) do
    uri = URI.parse(url)
    host = uri.host |> String.trim("[") |> String.trim("]")

    with {:ok, nkey_seed} <- seed(nats.nkey_seed_file) do
      settings =
        %{
          host: host,
          port: uri.port || 4222,
          connection_timeout: round(nats.connect_timeout_s * 1000),
          no_responders: true,
          tcp_opts: [:binary | family(host)]
        }
        |> Map.merge(auth(nats, nkey_seed))
        |> Map.merge(tls(nats, uri.scheme, host))

      {:ok, settings}
    end
  end

  defp family(host), do: if(String.contains?(host, ":"), do: [:inet6], else: [])

  defp seed(nil), do: {:ok, nil}

  defp seed(file) do
    case File.read(file) do
      {:ok, text} -> {:ok, String.trim(text)}
      {:error, reason} -> {:error, "cannot read nats.nkey_seed_file #{file}: #{:file.format_error(reason)}"}
    end
  end

  defp auth(%{mode: :embedded}, _seed), do: %{}

  defp auth(nats, seed) do
    cond do
      nats.credentials -> %{credentials: nats.credentials}
      seed -> %{nkey_seed: seed}
      nats.token -> %{token: Secret.reveal(nats.token)}
      nats.user -> %{username: nats.user, password: Secret.reveal(nats.password) || ""}
      true -> %{}
    end
    |> then(&if &1 == %{}, do: &1, else: Map.put(&1, :auth_required, true))
  end

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
