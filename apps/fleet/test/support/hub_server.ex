defmodule Aerie.HubServer do
  @moduledoc """
  The nats-server of a hub for a test, from the files that `bin/nats-setup` writes, on free ports. It ends with the test, however the
  VM ends.

      hub = HubServer.start(dir, ["A", "B"])
      settings = HubServer.leaf(hub, dir, "A")
  """

  import ExUnit.Assertions

  alias Aerie.Fleet.Bridge.Hub.Setup
  alias Aerie.Fleet.Bridge.NatsServer.OsProcess
  alias Aerie.{BridgeCase, Patience}

  @doc "Writes the set and starts its server or servers (`servers: 3`: a cluster on three loopback addresses; `hosts`: by these names)."
  def start(dir, vehicles, options \\ []) do
    hosts = options[:hosts] || for n <- 1..(options[:servers] || 1), do: "127.0.0.#{n}"
    ports = %{client: free_port(), leaf: free_port(), route: free_port()}
    set = set(dir)

    {:ok, _lines} = Setup.write(set, %{environment: "test", hosts: hosts, vehicles: vehicles, ports: ports})
    hub = %{set: set, dir: dir, hosts: hosts, ports: ports, disk_mb: options[:disk_mb]}
    for host <- hosts, do: install(hub, host)
    pids = Map.new(hosts, &{&1, run(hub, &1)})
    if length(hosts) == 1, do: await(hub, hd(hosts))
    Map.put(hub, :keepers, pids)
  end

  # As the lines that it prints say: the server's folder.
  defp install(hub, host) do
    File.mkdir_p!(folder(hub, host))
    for name <- File.ls!(Path.join([hub.set, "hub", host])), do: copy(hub, name, host)
    if String.starts_with?(host, "127."), do: listen(hub, host)
  end

  # The three share a machine.
  defp listen(hub, host) do
    file = Path.join(folder(hub, host), "server.conf")

    text =
      file
      |> File.read!()
      |> String.replace("port: #{hub.ports.client}", "listen: \"#{host}:#{hub.ports.client}\"")

    text = String.replace(text, "port: #{hub.ports.leaf}", "listen: \"#{host}:#{hub.ports.leaf}\"")
    text = String.replace(text, "port: #{hub.ports.route}", "listen: \"#{host}:#{hub.ports.route}\"")
    File.write!(file, text)
  end

  defp copy(hub, name, host),
    do: File.cp!(Path.join([hub.set, "hub", host, name]), Path.join(folder(hub, host), name))

  @doc "The folder of the set; a shell would take its name apart."
  def set(dir), do: Path.join(dir, "Jörg's $fleet")

  @doc "The folder in which a server runs."
  def folder(hub, host \\ "127.0.0.1"), do: Path.join(hub.dir, "Jörg's $server #{host}")

  # A process that owns the port, so that a test can stop and start the server from any process.
  defp run(hub, host) do
    test = self()
    dir = folder(hub, host)
    words = command(hub.disk_mb, dir)

    ExUnit.Callbacks.start_supervised!(
      {Task,
       fn ->
         port = OsProcess.start(hd(words), tl(words))
         keep(port, test, host, File.open!(Path.join(dir, "log"), [:append]))
       end},
      id: {:hub, host, make_ref()}
    )
  end

  defp command(nil, dir), do: ["/bin/sh", "-c", "cd \"$1\" && exec nats-server -c hub.conf", "hub", dir]

  # A small disk of its own, which outlives the server: that is started again when it ends, as systemd would.
  defp command(mb, dir) do
    script = """
    cd "$1" && mkdir -p data && mount -t tmpfs -o size=#{mb}m disk data || exit 1
    trap 'ended=yes; kill $server' TERM
    while [ -z "$ended" ]; do nats-server -c hub.conf & server=$!; wait $server; done
    """

    [System.find_executable("unshare"), "-rm", "/bin/sh", "-c", script, "hub", dir]
  end

  @doc "Fills the disk of a server that has one of its own; gives the file to remove."
  def fill_disk(hub) do
    filler = Path.join(["/proc", pid(hub, hd(hub.hosts)), "root", folder(hub) <> "/data/filler"])
    {:ok, file} = :file.open(filler, [:write, :raw])
    fill(file)
    :ok = :file.close(file)
    filler
  end

  defp fill(file) do
    case :file.write(file, :binary.copy("x", 4096)) do
      :ok -> fill(file)
      {:error, :enospc} -> :ok
    end
  end

  defp keep(port, test, host, log) do
    receive do
      {^port, {:data, {_eol, line}}} ->
        IO.puts(log, line)
        if line =~ "Server is ready", do: send(test, {:hub_ready, host})
        keep(port, test, host, log)

      {^port, {:exit_status, status}} ->
        send(test, {:hub_ended, host, status})
    end
  end

  defp await(hub, host) do
    receive do
      {:hub_ready, ^host} ->
        :ok

      {:hub_ended, ^host, _status} ->
        flunk("the hub ended: " <> File.read!(Path.join(folder(hub, host), "log")))
    after
      Patience.ms() -> flunk("the hub is not ready")
    end
  end

  @doc "`kill -9` of a server; returns when it is gone."
  def kill(hub, host \\ "127.0.0.1") do
    signal(hub, "KILL", host)

    receive do
      {:hub_ended, ^host, _status} -> :ok
    after
      Patience.ms() -> flunk("the hub was not killed")
    end
  end

  @doc "Starts a server again after `kill/2`."
  def restart(hub, host \\ "127.0.0.1") do
    run(hub, host)
    await(hub, host)
  end

  @doc """
  Ends a server that has a disk of its own, which is then started again; returns when that one is ready. Who connects before may
  reach the one that is about to end.
  """
  def end_and_start(hub, host \\ "127.0.0.1") do
    signal(hub, "TERM", host)
    await(hub, host)
  end

  @doc "Sends a signal: STOP and CONT freeze and thaw it, HUP reloads its configuration."
  def signal(hub, name, host \\ "127.0.0.1") do
    BridgeCase.forget_news()
    {_, 0} = System.cmd("kill", ["-#{name}", pid(hub, host)])
    :ok
  end

  defp pid(hub, host),
    do: hub |> folder(host) |> Path.join("nats-server.pid") |> File.read!() |> String.trim()

  @doc "Takes vehicles out of the fleet, and reloads the server."
  def revoke(hub, vehicles) do
    change(hub, %{revoked: vehicles})
    for host <- hub.hosts, do: signal(hub, "HUP", host)
  end

  @doc "Runs `bin/nats-setup` again with a wish of `Setup.write/2`, and copies its result to the servers. They are restarted or reloaded then."
  def change(hub, wish) do
    {:ok, _lines} = Setup.write(hub.set, wish)
    for host <- hub.hosts, do: copy(hub, "accounts.conf", host)
  end

  @doc "A client with the key of the hub's gateway; `:error` for a server that does not answer."
  def client(hub, host \\ "127.0.0.1") do
    Gnat.start_link(login(hub, File.read!(Path.join(hub.set, "hub/gateway.nk")), host))
  end

  @doc "A client of a vehicle's own server, at the address with its login, that is told if nobody takes a request."
  def local_client(url) do
    uri = URI.parse(url)

    settings = %{
      host: uri.host,
      port: uri.port,
      token: uri.userinfo,
      no_responders: true,
      connection_timeout: Aerie.Patience.ms()
    }

    {:ok, conn} = Gnat.start_link(settings)
    conn
  end

  @doc "The settings of a client with an nkey seed."
  def login(hub, seed, host \\ "127.0.0.1") do
    %{
      host: host,
      port: hub.ports.client,
      nkey_seed: String.trim(seed),
      auth_required: true,
      no_responders: true,
      tls: true,
      connection_timeout: Aerie.Patience.ms(),
      ssl_opts: [verify: :verify_peer, cacertfile: Path.join(hub.set, "ca.pem")]
    }
  end

  @doc "The settings of the bridge aboard a vehicle, whose server is a leaf node of the hub."
  def leaf(hub, vehicle, overrides \\ []) do
    own = Path.join([hub.set, "vehicles", vehicle])

    BridgeCase.config(
      Path.join(hub.dir, vehicle),
      [
        {"vehicle_id", vehicle},
        {"nats.leaf.url", for(host <- hub.hosts, do: "tls://#{host}:#{hub.ports.leaf}")},
        {"nats.leaf.nkey_seed_file", Path.join(own, "leaf.nk")},
        {"nats.leaf.tls.ca_file", Path.join(own, "ca.pem")}
      ] ++ overrides
    )
  end

  @doc "The settings of the bridge of the hub's gateway."
  def gateway(hub, overrides \\ []) do
    BridgeCase.settings(
      [
        {"environment", "test"},
        {"nats.url", for(host <- hub.hosts, do: "tls://#{host}:#{hub.ports.client}")},
        {"nats.nkey_seed_file", Path.join(hub.set, "hub/gateway.nk")},
        {"nats.tls.ca_file", Path.join(hub.set, "ca.pem")},
        {"nats.streams.events_per_vehicle", true},
        {"nats.streams.event_max_mb", 64},
        {"nats.streams.replicas", if(length(hub.hosts) >= 3, do: 3, else: 1)},
        {"nats.retry_min_ms", 20},
        {"nats.retry_max_ms", 200},
        {"outbox.dir", Path.join(hub.dir, "hub-outbox")}
      ] ++ overrides
    )
  end

  @doc "Waits until a bridge's hub is there."
  def await_hub(gateway), do: BridgeCase.await(gateway, :hub, &(&1[:status] == :up))

  @doc "A port that is free on all loopback addresses, and none that the system gives to others meanwhile (32,768 and above)."
  def free_port do
    port = Enum.random(12_000..32_000)

    case :gen_tcp.listen(port, []) do
      {:ok, socket} ->
        :gen_tcp.close(socket)
        port

      {:error, :eaddrinuse} ->
        free_port()
    end
  end
end
