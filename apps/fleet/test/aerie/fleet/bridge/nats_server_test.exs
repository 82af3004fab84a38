defmodule Aerie.Fleet.Bridge.NatsServerTest do
  use Aerie.BridgeCase, async: true

  alias Aerie.Base.Files.FolderLock

  @moduletag :tmp_dir
  @moduletag :capture_log

  test "killed, the server is back with its data, on its port", %{tmp_dir: dir} do
    gateway = start_bridge(config(dir))
    url = await_up(gateway)
    commit(gateway, "A", 1..10)
    await_empty(gateway)
    pid = server_pid(dir)
    kill9(pid)
    await(gateway, :server, &(&1[:restarts] == 1 and &1[:status] == :up))

    eventually(fn ->
      match?(
        %{conn: conn, streams: :ok} when conn != nil,
        Bridge.Connection.current(Bridge.Status.Tables.get(gateway))
      )
    end)

    assert await_up(gateway) == url
    assert server_pid(dir) != pid
    assert Enum.map(events(client(url)), &elem(&1, 1)) == Enum.to_list(1..10)
    assert metric(gateway, "gateway_nats_server_restarts_total") == 1
  end

  test "one that starts slowly is left alone, although it accepts no connection", %{tmp_dir: dir} do
    gate = Path.join(dir, "gate")
    {_, 0} = System.cmd("mkfifo", [gate])
    slow = Path.join(dir, "slow-nats-server")
    File.write!(slow, ~s(#!/bin/sh\nread -r go < "#{gate}"\nexec #{config(dir).nats.binary} "$@"\n))
    File.chmod!(slow, 0o700)
    gateway = start_bridge(config(dir, [{"nats.binary", slow}]))
    await(gateway, :server, &(&1[:status] == :starting))
    Bridge.NatsServer.stalled(gateway, "it accepts no connection")
    # It has taken note of it.
    _ = :sys.get_state(Aerie.Base.Names.whereis(gateway, :bridge_server), Aerie.Patience.ms())
    assert %{fault: nil, status: :starting} = Bridge.info(gateway).server
    File.write!(gate, "go\n")
    await_up(gateway)
    assert %{fault: nil, restarts: 0} = Bridge.info(gateway).server
  end

  test "the process that keeps it killed, the old server goes and a new one comes", %{tmp_dir: dir} do
    gateway = start_bridge(config(dir))
    await_up(gateway)
    old = server_pid(dir)
    keeper = Aerie.Base.Names.whereis(gateway, :bridge_server)
    ref = Process.monitor(keeper)
    Process.exit(keeper, :kill)
    assert_receive {:DOWN, ^ref, _, _, _}
    eventually(fn -> FolderLock.start_time(old) == "" end)
    eventually(fn -> Bridge.info(gateway)[:connected] && server_pid(dir) != old end)
    commit(gateway, "A", 1..3)
    await_empty(gateway)
  end

  test "the shell in between killed, the server goes on, and is still watched", %{tmp_dir: dir} do
    gateway = start_bridge(config(dir))
    await_up(gateway)
    server = server_pid(dir)
    [_, fields] = "/proc/#{server}/stat" |> File.read!() |> String.split(") ", parts: 2)
    [_state, shell | _] = String.split(fields)
    kill9(shell)
    eventually(fn -> FolderLock.start_time(shell) == "" end)
    commit(gateway, "A", 1..3)
    await_empty(gateway)
    assert server_pid(dir) == server
    kill9(server)
    await(gateway, :server, &(&1[:restarts] == 1 and &1[:status] == :up))
  end

  test "kill -9 of the whole gateway ends its server", %{tmp_dir: dir} do
    script = """
    Application.ensure_all_started(:fleet)
    alias Aerie.Base.PubSub
    config = Aerie.BridgeCase.settings([{"nats.port", 0}, {"nats.store_dir", #{inspect(Path.join(dir, "nats"))}},
                             {"outbox.dir", #{inspect(Path.join(dir, "outbox"))}}])
    {:ok, _} = Aerie.Base.Store.start_link([gateway: :g] ++ Aerie.GatewayCase.plugs(%{}))
    {:ok, _} = PubSub.start_link(gateway: :g)
    PubSub.subscribe(:g, :bridge)
    {:ok, _} = Aerie.Fleet.Bridge.Supervisor.start_link(gateway: :g, settings: config)
    wait = fn wait ->
      receive do
        {:fleet, :bridge, {:connection, %{status: :up}}} -> IO.puts("up \#{System.pid()}")
        _ -> wait.(wait)
      end
    end
    wait.(wait)
    Process.sleep(:infinity)
    """

    {port, pid} = other_vm(script, "up ")
    server = server_pid(dir)
    assert FolderLock.start_time(server) != ""
    # While it runs, its folder is not ours.
    second = start_bridge(config(dir))
    assert %{status: {:failed, text}} = await(second, :server, &match?(%{status: {:failed, _}}, &1))
    assert text =~ "process #{pid}"
    kill9(pid)
    eventually(fn -> FolderLock.start_time(server) == "" end)
    # And then it is.
    await_up(second)
    if Port.info(port), do: Port.close(port)
  end

  describe "its login" do
    test "a client without it is refused; it is in files for their owner alone, and nowhere else",
         context do
      %{tmp_dir: dir} = context

      log =
        ExUnit.CaptureLog.capture_log(fn ->
          gateway = start_bridge(config(dir))
          %URI{userinfo: token, host: host, port: port} = URI.parse(await_up(gateway))
          send(self(), {:login, gateway, token, host, port})
          commit(gateway, "A", 1..3)
          await_empty(gateway)
          kill9(server_pid(dir))
          await(gateway, :server, &(&1[:restarts] == 1 and &1[:status] == :up))
        end)

      assert_received {:login, gateway, token, host, port}
      assert byte_size(token) == 32
      Process.flag(:trap_exit, true)
      assert {:error, _refused} = log_in(%{host: host, port: port})

      assert {:error, _refused} =
               log_in(%{host: host, port: port, token: String.reverse(token)})

      assert {:ok, _conn} = log_in(%{host: host, port: port, token: token})

      nats = Path.join(dir, "nats")
      assert File.read!(Path.join(nats, "url")) == "nats://#{token}@#{host}:#{port}\n"
      for file <- ~w(url token nats.conf), do: assert(mode(Path.join(nats, file)) == 0o600)
      # Whatever else is in them, nobody gets into the folders.
      for folder <- ["nats", "outbox"], do: assert(mode(Path.join(dir, folder)) == 0o700)

      refute log =~ token
      refute inspect({Bridge.info(gateway), Bridge.metrics(gateway)}, limit: :infinity) =~ token
      refute File.read!("/proc/#{server_pid(dir)}/cmdline") =~ token
      refute File.read!("/proc/#{server_pid(dir)}/environ") =~ token
      refute File.read!(Path.join(nats, "nats-server.log")) =~ token
    end

    test "stays the same over starts; a folder that was open before is closed", %{tmp_dir: dir} do
      File.mkdir_p!(Path.join(dir, "nats"))
      File.chmod!(Path.join(dir, "nats"), 0o755)
      gateway = start_bridge(config(dir))
      %URI{userinfo: token} = URI.parse(await_up(gateway))
      assert mode(Path.join(dir, "nats")) == 0o700
      stop_bridge(gateway)
      start_bridge_again(gateway, config(dir))
      assert %URI{userinfo: ^token} = URI.parse(await_up(gateway))
    end

    test "may be chosen", %{tmp_dir: dir} do
      gateway = start_bridge(config(dir, [{"nats.token", "a b/c"}]))
      await_up(gateway)
      assert File.read!(Path.join(dir, "nats/url")) =~ "nats://a%20b%2Fc@127.0.0.1:"
    end

    defp mode(path), do: Bitwise.band(File.stat!(path).mode, 0o777)
  end

  describe "a server that wants a login" do
    setup %{tmp_dir: dir} do
      conf = Path.join(dir, "auth.conf")
      store = Path.join(dir, "store")

      File.write!(conf, """
      host: 127.0.0.1
      port: -1
      jetstream { store_dir: #{JSON.encode!(store)} }
      authorization { users: [
        { user: gw, password: "geheim" }
        { user: mute, password: "geheim", permissions: { publish: { deny: ["fleet.*.*.event.>"] } } }
      ] }
      """)

      port = Bridge.NatsServer.OsProcess.start(System.find_executable("nats-server"), ["-c", conf])
      %{server: port, tcp_port: listening(port)}
    end

    test "and denies events names the right that is missing, not a full disk", context do
      %{tmp_dir: dir, tcp_port: tcp_port} = context
      url = {"nats.url", "nats://127.0.0.1:#{tcp_port}"}
      user = [{"nats.user", "mute"}, {"nats.password", "geheim"}]
      gateway = start_bridge(config(Path.join(dir, "mute"), [url | user]))
      commit(gateway, "A", 1..5)
      await(gateway, :outbox, &is_binary(&1[:stalled]))
      problem = Bridge.info(gateway).problem
      assert problem =~ "the gateway's user lacks a right (Permissions Violation for Publish to"
      refute problem =~ "disk"
    end

    test "gets user and password; the log of a wrong password does not contain it, and events wait on disk",
         context do
      %{tmp_dir: dir, tcp_port: tcp_port, server: server} = context
      url = {"nats.url", "nats://127.0.0.1:#{tcp_port}"}

      log =
        ExUnit.CaptureLog.capture_log(fn ->
          gateway =
            start_bridge(config(Path.join(dir, "a"), [url, {"nats.user", "gw"}, {"nats.password", "falsch"}]))

          commit(gateway, "A", 1..5)
          await(gateway, :outbox, &(&1[:events] == 5))
          # It was refused, and the log says so.
          await(gateway, :connection, &(&1[:status] == :down and is_binary(&1[:problem])))
          refute Bridge.info(gateway).connected
        end)

      # "cannot connect to …" or, by the namesake of the client, "the connection to … is lost".
      assert log =~ "NATS at nats://127.0.0.1:#{tcp_port}"
      refute log =~ "falsch"

      gateway =
        start_bridge(config(Path.join(dir, "b"), [{"nats.url", "nats://gw:geheim@127.0.0.1:#{tcp_port}"}]))

      assert await_up(gateway) == "nats://127.0.0.1:#{tcp_port}"
      Bridge.NatsServer.OsProcess.stop(server)
      assert_receive {^server, {:exit_status, _}}
    end
  end
end
