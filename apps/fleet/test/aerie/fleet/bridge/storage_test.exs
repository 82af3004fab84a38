defmodule Aerie.Fleet.Bridge.StorageTest do
  @moduledoc "Servers that are there and connected, and store nothing: a full disk, a quota that is too small."
  use Aerie.BridgeCase, async: true

  @moduletag :tmp_dir
  @moduletag :capture_log

  @tag skip:
         System.cmd("unshare", ["-rm", "true"], stderr_to_stdout: true) |> elem(1) != 0 &&
           "no namespaces here"
  test "after a full disk the server stores again as soon as there is room, and nothing is lost", %{
    tmp_dir: dir
  } do
    disk = Path.join(dir, "disk")
    File.mkdir_p!(disk)

    script = """
    Application.ensure_all_started(:fleet)
    alias Aerie.Base.PubSub
    alias Aerie.Vehicle.Event
    alias Aerie.Vehicle.Events.Journal
    disk = #{inspect(disk)}
    config = Aerie.BridgeCase.settings([{"nats.port", 0}, {"nats.store_dir", Path.join(disk, "nats")},
                             {"outbox.dir", #{inspect(Path.join(dir, "outbox"))}}])
    {:ok, _} = Aerie.Base.Store.start_link([gateway: :g] ++ Aerie.GatewayCase.plugs(%{}))
    {:ok, _} = PubSub.start_link(gateway: :g)
    {:ok, _} = Aerie.Fleet.Bridge.Supervisor.start_link(gateway: :g, settings: config)
    await = fn await, fun -> fun.() || (Process.sleep(20); await.(await, fun)) end
    problem = fn -> Aerie.Fleet.Bridge.info(:g).problem end
    stored = fn -> Journal.pending_size(:g) == 0 and Aerie.Fleet.Bridge.info(:g).outbox[:events] == 0 end
    commit = fn seqs ->
      for seq <- seqs do
        event = Event.new("A", "statustext", seq, seq, nil, %{"text" => String.duplicate("x", 4000)})
        Journal.commit(:g, "A", :state, [event])
      end
    end

    await.(await, fn -> problem.() == nil end)
    commit.(1..10)
    await.(await, stored)
    fill = fn fill, file -> case :file.write(file, :binary.copy("x", 4096)) do
      :ok -> fill.(fill, file)
      {:error, :enospc} -> :ok
    end end
    {:ok, file} = :file.open(Path.join(disk, "filler"), [:write, :raw])
    fill.(fill, file)
    commit.(11..40)
    IO.puts("told " <> await.(await, fn -> text = problem.(); text && text =~ "cannot store" && text end))
    File.rm!(Path.join(disk, "filler"))
    :file.close(file)
    await.(await, fn -> problem.() == nil end)
    # The server may be restarted under a connection.
    Process.flag(:trap_exit, true)
    messages = fn ->
      url = URI.parse(Aerie.Fleet.Bridge.login_url(:g))
      login = %{host: url.host, port: url.port, token: url.userinfo, connection_timeout: 60_000}
      try do
        with {:ok, conn} <- Gnat.start_link(login) do
          info = Gnat.Jetstream.API.Stream.info(conn, "FLEET_EVENTS")
          :ok = Gnat.stop(conn)
          with {:ok, %{state: state}} <- info, do: state.messages
        end
      catch
        :exit, _gone -> nil
      end
    end
    await.(await, fn -> stored.() and messages.() == 40 end)
    IO.puts("restarts \#{Aerie.Fleet.Bridge.info(:g).server.restarts} \#{System.pid()}")
    Process.sleep(:infinity)
    """

    small = ["unshare", "-rm", "sh", "-c", "mount -t tmpfs -o size=8m tmpfs \"$0\" && exec \"$@\"", disk]
    {port, problem} = other_vm(script, "told ", small)
    assert problem == "the NATS server cannot store: no space left on device"
    # All 40 are in the stream.
    assert ["1", pid] = String.split(marked(port, "restarts "))
    kill9(pid)
  end

  test "a quota that has no room for a stream: not ready, with the key that wants it; events wait and then go",
       %{
         tmp_dir: dir
       } do
    {server, url} = start_server(dir, "max_file_store: 100MB")
    gateway = start_bridge(config(dir, [{"nats.url", url}]))
    commit(gateway, "A", 1..5)
    await(gateway, :streams, &match?(%{"FLEET_EVENTS" => {:error, _}}, &1[:report]))
    await(gateway, :outbox, &(&1[:events] == 5))

    refused =
      "stream FLEET_EVENTS: insufficient storage resources available for 512 MB (nats.streams.event_max_mb)"

    eventually(fn -> match?(%{connected: true, problem: ^refused}, Bridge.info(gateway)) end)

    assert metric(gateway, "gateway_nats_ready") == 0
    stop_bridge(gateway)
    start_bridge_again(gateway, config(dir, [{"nats.url", url}, {"nats.streams.event_max_mb", 20}]))
    await_up(gateway)
    await_empty(gateway)
    eventually(fn -> Bridge.info(gateway).problem == nil end)
    eventually(fn -> metric(gateway, "gateway_nats_ready") == 1 end)
    Bridge.NatsServer.OsProcess.stop(server)
    assert_receive {^server, {:exit_status, _}}
  end

  # Silence as after a full disk, from a server that was up: it is stopped, and its connections stay.
  test "a server that answers no event is detected although the connection stands", %{tmp_dir: dir} do
    gateway = start_bridge(config(dir))
    await_up(gateway)
    pid = server_pid(dir)
    # Its keeper would restart it before a busy machine has read the metric.
    server = Aerie.Base.Names.whereis(gateway, :bridge_server)
    :sys.suspend(server, Aerie.Patience.ms())
    stall(gateway, pid, 1)
    :sys.resume(server, Aerie.Patience.ms())
    await(gateway, :server, &(&1[:restarts] == 1 and &1[:status] == :up))
    await_empty(gateway)
    eventually(fn -> Bridge.info(gateway).problem == nil end)
    assert server_pid(dir) != pid
  end

  test "a server that hangs is restarted although no event waits and the connection is lost", %{tmp_dir: dir} do
    gateway = start_bridge(config(dir))
    await_up(gateway)
    pid = server_pid(dir)
    {_, 0} = System.cmd("kill", ["-STOP", pid])
    Process.exit(connection(gateway), :kill)
    await(gateway, :connection, &(&1[:status] == :down))
    await(gateway, :server, &(&1[:restarts] == 1 and &1[:status] == :up))
    await(gateway, :connection, &(&1[:status] == :up))
    assert server_pid(dir) != pid
  end

  # Events are a problem after ten seconds without a confirmation. A connection whose server has stopped is given up
  # after ten to twenty; one that has just begun lasts the twenty. If a busy machine loses it before, the server goes
  # on, and it is tried again.
  defp stall(gateway, pid, seq) do
    former = connection(gateway)
    Process.exit(former, :kill)
    conn = eventually(fn -> with ^former <- connection(gateway), do: nil end)
    # Events go over the new one.
    commit(gateway, "A", seq..seq)
    await_empty(gateway)
    {_, 0} = System.cmd("kill", ["-STOP", pid])
    commit(gateway, "A", (seq + 1)..(seq + 3))
    outcome = eventually(fn -> if connection(gateway) == conn, do: stalled(gateway), else: :lost end)

    if outcome == :lost do
      {_, 0} = System.cmd("kill", ["-CONT", pid])
      eventually(fn -> connection(gateway) not in [nil, conn] end)
      stall(gateway, pid, seq + 4)
    end
  end

  defp stalled(gateway) do
    outbox = Bridge.info(gateway).outbox
    seconds = metric(gateway, "gateway_events_stalled_seconds")
    if outbox[:stalled] == "NATS does not confirm events" and seconds >= 10, do: :stalled
  end

  defp connection(gateway),
    do: with(%{conn: conn} <- gateway |> Bridge.Status.Tables.get() |> Bridge.Connection.current(), do: conn)

  defp start_server(dir, limits) do
    conf = Path.join(dir, "server.conf")

    File.write!(
      conf,
      "host: 127.0.0.1\nport: -1\njetstream { store_dir: #{inspect(Path.join(dir, "data"))}, #{limits} }"
    )

    port = Bridge.NatsServer.OsProcess.start(System.find_executable("nats-server"), ["-c", conf])
    {port, "nats://127.0.0.1:#{listening(port)}"}
  end

  defp marked(port, mark) do
    assert_receive {^port, {:data, {:eol, line}}}

    if String.starts_with?(line, mark),
      do: String.replace_prefix(line, mark, ""),
      else: marked(port, mark)
  end
end
