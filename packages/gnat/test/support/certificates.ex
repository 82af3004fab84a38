defmodule Gnat.Test.Certificates do
  @moduledoc "A certificate authority with a server and a client certificate, made for one test."

  @doc "`%{files: PEM files for the server, cacerts: , client: ssl options}`; the server is 127.0.0.1 and localhost."
  def make do
    names = [{:iPAddress, <<127, 0, 0, 1>>}, {:dNSName, ~c"localhost"}]

    %{server_config: server, client_config: client} =
      :public_key.pkix_test_data(%{
        server_chain: %{
          root: [key: key(), digest: :sha256],
          intermediates: [],
          peer: [key: key(), digest: :sha256, extensions: [{:Extension, {2, 5, 29, 17}, false, names}]]
        },
        client_chain: %{
          root: [key: key(), digest: :sha256],
          intermediates: [],
          peer: [key: key(), digest: :sha256]
        }
      })

    %{
      files: %{
        "server-cert.pem" => pem([{:Certificate, server[:cert]}]),
        "server-key.pem" => pem([server[:key]]),
        "client-ca.pem" => pem(for cert <- server[:cacerts], do: {:Certificate, cert})
      },
      cacerts: client[:cacerts],
      client: [cert: client[:cert], key: client[:key]]
    }
  end

  @doc "The tls block of a server's configuration."
  def config(dir, more \\ "") do
    """
    tls {
      cert_file: "#{dir}/server-cert.pem"
      key_file: "#{dir}/server-key.pem"
      timeout: 20
      #{more}
    }
    """
  end

  defp key, do: {:namedCurve, :secp256r1}
  defp pem(entries), do: :public_key.pem_encode(for {type, der} <- entries, do: {type, der, :not_encrypted})
end
