defmodule Gnat.AuthTest do
  use ExUnit.Case, async: true

  alias Gnat.Error
  alias Gnat.Test.{Jwt, NatsServer}

  @moduletag :capture_log

  defp connect(server, more), do: Gnat.start_link(NatsServer.settings(server, more))

  defp works(server, more) do
    assert {:ok, gnat} = connect(server, more)
    assert :ok = Gnat.pub(gnat, "a", "b")
    assert :ok = Gnat.flush(gnat)
    gnat
  end

  defp refused(server, more) do
    assert {:error, %Error{reason: {:auth, _}} = error} = connect(server, more)
    assert Exception.message(error) =~ "refused the credentials: Authorization Violation"
  end

  test "user and password" do
    server = start_supervised!({NatsServer, config: "authorization { user: joe, password: secret }"})
    works(server, %{username: "joe", password: "secret"})
    refused(server, %{username: "joe", password: "wrong"})
    refused(server, %{})
  end

  test "token" do
    server = start_supervised!({NatsServer, config: "authorization { token: s3cr3t }"})
    works(server, %{token: "s3cr3t"})
    refused(server, %{token: "wrong"})
  end

  test "nkey" do
    nkey = Nkey.generate(:user)
    server = start_supervised!({NatsServer, config: "authorization { users: [ { nkey: #{nkey.public} } ] }"})
    works(server, %{nkey_seed: Nkey.seed(nkey)})
    refused(server, %{nkey_seed: Nkey.seed(Nkey.generate(:user))})
    assert {:error, %Error{reason: {:credentials, _}}} = connect(server, %{nkey_seed: "SUABC"})
  end

  test "JWT" do
    %{config: config, jwt: jwt, seed: seed} = Jwt.deployment()
    server = start_supervised!({NatsServer, config: config})
    works(server, %{jwt: jwt, nkey_seed: seed})
    refused(server, %{jwt: jwt, nkey_seed: Nkey.seed(Nkey.generate(:user))})
    refused(server, %{jwt: Jwt.deployment().jwt, nkey_seed: seed})
  end

  test "a JWT that expires ends the connection with that reason" do
    %{config: config, again: again, seed: seed} = Jwt.deployment()
    server = start_supervised!({NatsServer, config: config})
    Process.flag(:trap_exit, true)

    # A busy machine may need longer for connecting than the JWT counts.
    gnat =
      Enum.find_value([2, 10, 30, 60], fn seconds ->
        jwt = again.(%{exp: System.os_time(:second) + seconds})

        case connect(server, %{jwt: jwt, nkey_seed: seed}) do
          {:ok, gnat} -> gnat
          {:error, %Error{}} -> nil
        end
      end)

    assert is_pid(gnat)
    assert_receive {:EXIT, ^gnat, {:shutdown, %Error{reason: {:server, text}}}}
    assert text =~ "Expired"
  end

  test "a JWT that has expired is refused" do
    %{config: config, jwt: jwt, seed: seed} = Jwt.deployment(%{exp: System.os_time(:second) - 10})
    server = start_supervised!({NatsServer, config: config})
    refused(server, %{jwt: jwt, nkey_seed: seed})
  end

  test "credentials are not sent to a server that does not ask for them, unless configured so" do
    {:ok, listener} = :gen_tcp.listen(0, [:binary, ip: {127, 0, 0, 1}, active: false])
    {:ok, port} = :inet.port(listener)

    for {more, sent?} <- [{%{}, false}, {%{auth_required: true}, true}] do
      login = %{username: "joe", password: "secret", connection_timeout: 60_000}
      settings = login |> Map.merge(%{host: "127.0.0.1", port: port}) |> Map.merge(more)
      client = Task.async(fn -> Gnat.start_link(settings) end)
      {:ok, socket} = :gen_tcp.accept(listener)
      :ok = :gen_tcp.send(socket, "INFO {\"headers\":true}\r\n")
      {:ok, "CONNECT " <> connect} = :gen_tcp.recv(socket, 0)
      assert connect =~ "secret" == sent?
      :gen_tcp.close(socket)
      assert {:error, %Error{}} = Task.await(client, 60_000)
    end
  end

  test "an nkey at a server without nkeys is an error that says so" do
    {:ok, listener} = :gen_tcp.listen(0, [:binary, ip: {127, 0, 0, 1}, active: false])
    {:ok, port} = :inet.port(listener)

    settings = %{
      host: "127.0.0.1",
      port: port,
      nkey_seed: Nkey.seed(Nkey.generate(:user)),
      connection_timeout: 60_000
    }

    client = Task.async(fn -> Gnat.start_link(settings) end)
    {:ok, socket} = :gen_tcp.accept(listener)
    :ok = :gen_tcp.send(socket, "INFO {\"headers\":true,\"auth_required\":true}\r\n")

    assert {:error, %Error{reason: {:credentials, "the server gives no nonce" <> _}}} =
             Task.await(client, 60_000)
  end

  test "a refused permission is reported, and the connection lives" do
    config = """
    authorization { users: [ { user: joe, password: secret, permissions: { publish: "ok.>", subscribe: ["ok.>", "_INBOX.>"] } } ] }
    """

    server = start_supervised!({NatsServer, config: config})
    gnat = works(server, %{username: "joe", password: "secret"})
    Gnat.Test.telemetry([:gnat, :server_error])

    log =
      ExUnit.CaptureLog.capture_log([level: :error], fn ->
        {:ok, _} = Gnat.sub(gnat, self(), "forbidden.things")
        :ok = Gnat.pub(gnat, "forbidden.too", "x")
        assert_receive {:telemetry, _, %{count: 1}, %{message: "Permissions Violation for Subscription" <> _}}
        assert_receive {:telemetry, _, %{count: 1}, %{message: "Permissions Violation for Publish" <> _}}
        # Answered when all of that is done.
        _ = Gnat.server_info(gnat)
      end)

    assert log =~ "NATS server reports: Permissions Violation for Publish"
    {:ok, _} = Gnat.sub(gnat, self(), "ok.>")
    :ok = Gnat.pub(gnat, "ok.a", "x")
    assert_receive {:msg, %{topic: "ok.a"}}
    # The server hangs up later: that is not because of the permission.
    Process.flag(:trap_exit, true)
    :ok = NatsServer.kill(server)
    assert_receive {:EXIT, ^gnat, {:shutdown, %Error{reason: reason}}}
    assert reason == :closed or match?({:transport, _}, reason)
  end
end
