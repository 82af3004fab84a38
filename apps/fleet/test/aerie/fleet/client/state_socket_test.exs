defmodule Aerie.Fleet.Client.StateSocketTest do
  use ExUnit.Case, async: true

  import Aerie.ClientCase
  import Aerie.LinkCase, only: [eventually: 1]
  import Bitwise

  alias Aerie.Base.Net.UnixSocket
  alias Aerie.Base.Store
  alias Aerie.Base.Names

  defp lines(socket), do: receive_line(socket)

  defp receive_line(socket) do
    {:ok, line} = :gen_tcp.recv(socket, 0, Aerie.Patience.ms())
    JSON.decode!(line)
  end

  test "a reader gets one line for each vehicle, again and again, with the newest state" do
    dir = short_dir()
    gateway = start_clients(dir)
    put_vehicle(gateway, vehicle())
    put_vehicle(gateway, vehicle(%{id: "VID-002", key: {"main", 2}, system_id: 2}))
    socket = connect(Path.join(dir, "state.sock"), packet: :line)

    assert [%{"vehicle" => "VID-001"}, %{"vehicle" => "VID-002"}] = [lines(socket), lines(socket)]
    put_vehicle(gateway, vehicle(%{status: :stale}))

    assert Enum.find(
             Stream.repeatedly(fn -> lines(socket) end),
             &(&1["vehicle"] == "VID-001" and &1["status"] == "stale")
           )
  end

  test "the socket's file can be used by owner and group only, its folder by its owner, and both sides of its life are clean" do
    dir = Path.join(short_dir(), "new")
    gateway = start_clients(dir)
    path = Path.join(dir, "state.sock")
    eventually(fn -> UnixSocket.Listener.info(gateway, :state) end)
    assert %{path: ^path, status: :up} = UnixSocket.Listener.info(gateway, :state)
    assert (File.stat!(dir).mode &&& 0o777) == 0o700
    assert (File.lstat!(path).mode &&& 0o777) == 0o660
    assert File.ls!(dir) |> Enum.filter(&String.ends_with?(&1, ".sock")) |> Enum.member?("state.sock")
    refute Enum.any?(File.ls!(dir), &String.starts_with?(&1, "."))

    stop_supervised!({Aerie.Fleet.Client.Supervisor, gateway})
    refute File.exists?(path)
  end

  test "clients beyond the limit are refused and counted, and have room when others leave" do
    dir = short_dir()
    gateway = start_clients(dir, %{max_clients: 2})
    put_vehicle(gateway, vehicle())
    path = Path.join(dir, "state.sock")
    [first, _second] = for _ <- 1..2, do: path |> connect(packet: :line) |> tap(&lines/1)

    assert {:error, :closed} = path |> connect() |> :gen_tcp.recv(0, Aerie.Patience.ms())
    assert Store.counter(gateway, {:clients, :state, :refused}) == 1

    :gen_tcp.close(first)

    assert eventually(fn ->
             match?({:ok, _line}, path |> connect(packet: :line) |> :gen_tcp.recv(0, Aerie.Patience.ms()))
           end)
  end

  test "a reader that does not read holds nothing up and has nothing queued; a reader that reads gets every text" do
    dir = short_dir()
    gateway = start_clients(dir)
    for n <- 1..100, do: put_vehicle(gateway, vehicle(%{id: "VID-#{n}", key: {"main", n}, system_id: n}))
    path = Path.join(dir, "state.sock")
    _deaf = connect(path, recbuf: 4096)
    clients = Names.whereis(gateway, :socket_clients, :state)
    [{_, deaf, _, _}] = eventually(fn -> with [] <- DynamicSupervisor.which_children(clients), do: nil end)
    reader = connect(path, packet: :line)

    # More than the socket's buffers hold: the deaf one's process waits in its write meanwhile, half a minute at most.
    for _ <- 1..1_000, do: lines(reader)
    assert Process.info(deaf, :message_queue_len) |> elem(1) <= 2
    assert Process.alive?(deaf)
  end

  test "what a reader says is not listened to, and much of it ends the connection" do
    dir = short_dir()
    gateway = start_clients(dir)
    socket = connect(Path.join(dir, "state.sock"))
    :ok = :gen_tcp.send(socket, String.duplicate("x", 1000))
    _ = :gen_tcp.send(socket, String.duplicate("x", 100_000))
    # Lines that were written before are read first.
    recv = fn -> :gen_tcp.recv(socket, 0, Aerie.Patience.ms()) end
    assert {:error, reason} = recv |> Stream.repeatedly() |> Enum.find(&match?({:error, _}, &1))
    assert reason in [:closed, :econnreset]
    assert Store.counter(gateway, {:clients, :state, :chatter}) == 1
  end

  test "readers stay when the feed, which makes the text, is killed" do
    dir = short_dir()
    gateway = start_clients(dir)
    put_vehicle(gateway, vehicle())
    socket = connect(Path.join(dir, "state.sock"), packet: :line)
    lines(socket)
    feed = Names.whereis(gateway, :state_feed)
    ref = Process.monitor(feed)
    Process.exit(feed, :kill)
    assert_receive {:DOWN, ^ref, :process, _pid, :killed}
    put_vehicle(gateway, vehicle(%{status: :lost}))
    assert Enum.find(Stream.repeatedly(fn -> lines(socket) end), &(&1["status"] == "lost"))
  end

  test "a killed listener serves again at the same place, and its clients stay" do
    dir = short_dir()
    gateway = start_clients(dir)
    put_vehicle(gateway, vehicle())
    path = Path.join(dir, "state.sock")
    socket = connect(path, packet: :line)
    lines(socket)
    Process.exit(Names.whereis(gateway, :unix_listener, :state), :kill)
    # Who was waiting to be let in when it died has to knock again.
    assert eventually(fn ->
             match?({:ok, _line}, path |> connect(packet: :line) |> :gen_tcp.recv(0, Aerie.Patience.ms()))
           end)

    for _ <- 1..3, do: lines(socket)
  end
end
