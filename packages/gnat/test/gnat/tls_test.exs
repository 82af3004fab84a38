defmodule Gnat.TlsTest do
  use ExUnit.Case, async: true

  alias Gnat.Error
  alias Gnat.Test.{Certificates, NatsServer}

  @moduletag :capture_log

  setup_all do
    {:ok, certificates: Certificates.make()}
  end

  defp server(certificates, more \\ "", options \\ "") do
    config = fn dir -> Certificates.config(dir, String.replace(more, "DIR", dir)) <> options end
    start_supervised!({NatsServer, config: config, files: certificates.files}, id: make_ref())
  end

  defp works(settings) do
    assert {:ok, gnat} = Gnat.start_link(settings)
    {:ok, _} = Gnat.sub(gnat, self(), "a")
    body = :binary.copy("x", 200_000)
    :ok = Gnat.pub(gnat, "a", body)
    assert_receive {:msg, %{body: ^body}}
    gnat
  end

  test "a connection over TLS, by address and by name", %{certificates: certificates} do
    server = server(certificates)
    trusted = [cacerts: certificates.cacerts]
    works(NatsServer.settings(server, %{tls: true, ssl_opts: trusted}))
    works(NatsServer.settings(server, %{tls: true, ssl_opts: trusted, host: "localhost"}))
    works(NatsServer.settings(server, %{tls: true, ssl_opts: [verify: :verify_none]}))
  end

  test "a server that requires TLS gets it without a setting", %{certificates: certificates} do
    works(NatsServer.settings(server(certificates), %{ssl_opts: [cacerts: certificates.cacerts]}))
  end

  test "an untrusted certificate is refused", %{certificates: certificates} do
    settings = NatsServer.settings(server(certificates), %{tls: true})

    for ssl_opts <- [[], [cacerts: Certificates.make().cacerts]] do
      assert {:error, %Error{reason: {:tls, _}} = error} =
               Gnat.start_link(Map.put(settings, :ssl_opts, ssl_opts))

      assert Exception.message(error) =~ "TLS with the NATS server failed"
    end
  end

  test "a certificate of another host is refused", %{certificates: certificates} do
    settings = %{
      tls: true,
      ssl_opts: [cacerts: certificates.cacerts, server_name_indication: ~c"other.example"]
    }

    assert {:error, %Error{reason: {:tls, _}}} =
             Gnat.start_link(NatsServer.settings(server(certificates), settings))
  end

  test "a server that requires a client certificate", %{certificates: certificates} do
    server = server(certificates, "verify: true, ca_file: \"DIR/client-ca.pem\"")
    trusted = [cacerts: certificates.cacerts]
    works(NatsServer.settings(server, %{tls: true, ssl_opts: trusted ++ certificates.client}))
    without = NatsServer.settings(server, %{tls: true, ssl_opts: trusted})
    assert {:error, %Error{reason: reason}} = Gnat.start_link(without)
    # The server's alert, or only its end, if that was faster.
    assert match?({:tls, _}, reason) or match?({:transport, _}, reason) or reason == :closed
  end

  test "TLS with a server that has none is an error, and nothing is sent in the clear" do
    server = start_supervised!(NatsServer)
    settings = NatsServer.settings(server, %{tls: true, username: "joe", password: "secret"})
    assert {:error, %Error{reason: :tls_not_offered}} = Gnat.start_link(settings)
  end

  test "injected bytes before TLS are refused" do
    {:ok, listener} = :gen_tcp.listen(0, [:binary, ip: {127, 0, 0, 1}, active: false])
    {:ok, port} = :inet.port(listener)

    client =
      Task.async(fn -> Gnat.start_link(%{host: "127.0.0.1", port: port, connection_timeout: 60_000}) end)

    {:ok, socket} = :gen_tcp.accept(listener)
    :ok = :gen_tcp.send(socket, "INFO {\"tls_required\":true}\r\nMSG a 1 5")
    assert {:error, %Error{reason: {:protocol, "bytes between" <> _}}} = Task.await(client, 60_000)
  end

  test "unknown TLS options are an error", %{certificates: certificates} do
    settings = %{tls: true, ssl_opts: [cacertfile: "/nonexistent", verify: :verify_peer]}

    assert {:error, %Error{reason: {:tls, _}}} =
             Gnat.start_link(NatsServer.settings(server(certificates), settings))
  end

  test "the end of a TLS connection is noticed", %{certificates: certificates} do
    server = server(certificates)
    Process.flag(:trap_exit, true)
    gnat = works(NatsServer.settings(server, %{tls: true, ssl_opts: [cacerts: certificates.cacerts]}))
    :ok = NatsServer.kill(server)
    assert_receive {:EXIT, ^gnat, {:shutdown, %Error{}}}
  end

  test "user and password are sent inside TLS", %{certificates: certificates} do
    server = server(certificates, "", "authorization { user: joe, password: secret }")
    settings = %{tls: true, ssl_opts: [cacerts: certificates.cacerts], username: "joe", password: "secret"}
    works(NatsServer.settings(server, settings))
  end
end
