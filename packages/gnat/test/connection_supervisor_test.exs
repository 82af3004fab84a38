defmodule Gnat.ConnectionSupervisorTest do
  use ExUnit.Case, async: true

  import ExUnit.CaptureLog
  import Gnat.Test

  alias Gnat.{ConnectionSupervisor, Error}
  alias Gnat.Test.NatsServer

  @moduletag :capture_log

  setup do
    name = :"#{unique("gnat")}"
    for event <- [:up, :down, :failed], do: telemetry([:gnat, :connection, event])
    {:ok, name: name}
  end

  defp supervise(name, servers, more \\ %{}) do
    settings = Map.merge(%{name: name, connection_settings: servers, backoff_period: 10}, more)
    start_supervised!({ConnectionSupervisor, settings})
  end

  defp await(event, name) do
    assert_receive {:telemetry, [:gnat, :connection, ^event], measurements, %{name: ^name} = metadata}
    Map.merge(measurements, metadata)
  end

  defp free_port do
    {:ok, socket} = :gen_tcp.listen(0, ip: {127, 0, 0, 1})
    {:ok, port} = :inet.port(socket)
    :gen_tcp.close(socket)
    port
  end

  test "keeps a connection under its name", %{name: name} do
    server = start_supervised!(NatsServer)
    supervise(name, [NatsServer.settings(server)])
    await(:up, name)
    {:ok, _} = Gnat.sub(name, self(), "a")
    :ok = Gnat.pub(name, "a", "b")
    assert_receive {:msg, %{body: "b"}}
  end

  test "takes a name of a registry", %{name: registry} do
    start_supervised!({Registry, keys: :unique, name: registry})
    server = start_supervised!(NatsServer)
    name = {:via, Registry, {registry, {:gateway, :nats}}}
    supervise(name, [NatsServer.settings(server)])
    await(:up, name)
    assert :ok = Gnat.pub(name, "a", "b")
  end

  test "starts without a server, and says when there is none", %{name: name} do
    port = free_port()

    log =
      capture_log(fn ->
        supervise(name, [%{host: "127.0.0.1", port: port}])
        assert %{retry_in: retry, reason: %Error{reason: {:connect, :econnrefused}}} = await(:failed, name)
        assert retry in 5..10
        assert {:error, %Error{reason: :not_connected}} = Gnat.pub(name, "a", "b")
        await(:failed, name)
      end)

    # Many tries are one line. Tests beside this one write into the log as well.
    assert length(Regex.scan(~r/127\.0\.0\.1:#{port}: .*connection refused/, log)) == 1
  end

  test "connects again after kill -9 of the server", %{name: name} do
    server = start_supervised!(NatsServer)
    supervise(name, [NatsServer.settings(server)])
    await(:up, name)
    first = Process.whereis(name)

    :ok = NatsServer.kill(server)
    assert %{reason: %Error{reason: reason}} = await(:down, name)
    assert reason == :closed or match?({:transport, _}, reason)
    assert {:error, %Error{}} = Gnat.pub(name, "a", "b")
    await(:failed, name)

    :ok = NatsServer.start(server)
    await(:up, name)
    assert Process.whereis(name) != first
    assert :ok = Gnat.pub(name, "a", "b")
    assert :ok = Gnat.flush(name)
  end

  test "goes to another server of the list", %{name: name} do
    servers = for _ <- 1..2, do: start_supervised!(Supervisor.child_spec(NatsServer, id: make_ref()))
    supervise(name, Enum.map(servers, &NatsServer.settings/1))
    %{port: port} = await(:up, name)
    [used, other] = Enum.sort_by(servers, &(NatsServer.port(&1) != port))
    :ok = NatsServer.kill(used)
    other_port = NatsServer.port(other)
    assert %{port: ^other_port} = await(:up, name)
  end

  test "notices a server that lives but answers nothing", %{name: name} do
    server = start_supervised!(NatsServer)
    supervise(name, [NatsServer.settings(server, %{ping_interval: 30, connection_timeout: 1_000})])
    await(:up, name)
    :ok = NatsServer.freeze(server)
    assert %{reason: %Error{reason: :unresponsive}} = await(:down, name)
    # Whether the kernel still takes the connection for the frozen server is its business.
    %{reason: %Error{reason: reason}} = await(:failed, name)
    assert reason in [:timeout, {:connect, :timeout}]
    :ok = NatsServer.thaw(server)
    await(:up, name)
  end

  test "reconnects when the connection process is killed", %{name: name} do
    server = start_supervised!(NatsServer)
    supervise(name, [NatsServer.settings(server)])
    await(:up, name)
    Process.exit(Process.whereis(name), :kill)
    assert %{reason: :killed} = await(:down, name)
    await(:up, name)
  end

  test "tries on when its settings cannot work, without dying", %{name: name} do
    supervise(name, [%{host: "127.0.0.1", prot: 1}])
    assert %{reason: %Error{reason: {:settings, _}}} = await(:failed, name)
    assert %{reason: %Error{reason: {:settings, _}}} = await(:failed, name)
  end

  test "shows no secrets in its status", %{name: name} do
    supervisor =
      supervise(name, [%{host: "127.0.0.1", port: free_port(), username: "joe", password: "s3cr3t"}])

    await(:failed, name)
    refute inspect(:sys.get_status(supervisor, 60_000), limit: :infinity) =~ "s3cr3t"
  end

  test "can be stopped while it connects", %{name: name} do
    {:ok, socket} = :gen_tcp.listen(0, ip: {127, 0, 0, 1})
    {:ok, port} = :inet.port(socket)
    supervise(name, [%{host: "127.0.0.1", port: port, connection_timeout: 60_000}])
    {:ok, _client} = :gen_tcp.accept(socket)
    assert :ok = stop_supervised(ConnectionSupervisor)
  end

  test "closes the connection when it is stopped", %{name: name} do
    server = start_supervised!(NatsServer)
    supervise(name, [NatsServer.settings(server)])
    await(:up, name)
    ref = Process.monitor(Process.whereis(name))
    :ok = stop_supervised(ConnectionSupervisor)
    assert_receive {:DOWN, ^ref, _, _, :normal}
  end
end
