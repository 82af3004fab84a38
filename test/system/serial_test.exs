defmodule Aerie.System.SerialTest do
  @moduledoc "A simulated vehicle behind a serial cable that is unplugged; its clients see only a gap."

  use Aerie.SystemCase, async: true

  alias Aerie.SerialPeer

  @moduletag :tmp_dir

  defmodule Shovel do
    @moduledoc "Connects the vehicle's UDP link with the end of the cable."
    use GenServer

    def start_link(peer_options), do: GenServer.start_link(__MODULE__, peer_options)
    def port(shovel), do: GenServer.call(shovel, :port, Aerie.Patience.ms())
    def peer(shovel), do: GenServer.call(shovel, :peer, Aerie.Patience.ms())

    @impl GenServer
    def init(peer_options) do
      {:ok, socket} = :gen_udp.open(0, [:binary, active: true, ip: {127, 0, 0, 1}])
      {:ok, peer} = GenServer.start_link(SerialPeer, [to: self()] ++ peer_options)
      {:ok, %{socket: socket, peer: peer, vehicle: nil}}
    end

    @impl GenServer
    def handle_call(:port, _from, state), do: {:reply, elem(:inet.port(state.socket), 1), state}
    def handle_call(:peer, _from, state), do: {:reply, state.peer, state}

    @impl GenServer
    # All that has come, at once: the other end asks the line for its rate each time, and a busy machine has few turns for that.
    def handle_info({:udp, socket, ip, port, bytes}, state) do
      :ok = SerialPeer.say(state.peer, IO.iodata_to_binary([bytes | waiting(socket)]))
      {:noreply, %{state | vehicle: {ip, port}}}
    end

    def handle_info({:heard, _peer, bytes}, state) do
      if state.vehicle, do: :gen_udp.send(state.socket, state.vehicle, bytes)
      {:noreply, state}
    end

    defp waiting(socket) do
      receive do
        {:udp, ^socket, _ip, _port, bytes} -> [bytes | waiting(socket)]
      after
        0 -> []
      end
    end
  end

  test "found at its port and rate; the cable is unplugged, and comes back as another device", %{
    tmp_dir: folder
  } do
    if SerialPeer.build(), do: cable(folder), else: IO.puts(:stderr, "no C compiler: no serial cable to pull")
  end

  defp cable(folder) do
    dev = short_dir()
    shovel = start_supervised!({Shovel, baud: 115_200, name_in: {dev, "ttyUSB0"}})
    sockets = short_dir()

    %{gateway: gateway} =
      start_gateway(folder,
        links: ["serial:auto?ports=#{dev}/ttyACM0,#{dev}/ttyUSB0&only=true"],
        overrides: %{"sockets" => %{"dir" => sockets}}
      )

    start_supervised!(
      {SimVehicle.Fleet, count: 1, link: "udpout:127.0.0.1:#{Shovel.port(shovel)}", ready_s: 1.0, fly: false}
    )

    # Found, and its streams requested through the cable.
    eventually(
      fn -> match?(%{groups: %{attitude: _}}, Store.vehicle(gateway, "VID-001")) end,
      fn ->
        "attitude comes: #{inspect({MavRouter.Link.get(gateway, "link-1"), Store.vehicle(gateway, "VID-001")})}"
      end
    )

    assert %{baud: 115_200, local: local} = MavRouter.Link.get(gateway, "link-1")
    assert Path.basename(local) == "ttyUSB0"

    {:ok, client} =
      :gen_tcp.connect({:local, Path.join(sockets, "state.sock")}, 0, [
        :binary,
        packet: :line,
        buffer: 65_536,
        active: false
      ])

    assert {:ok, _line} = :gen_tcp.recv(client, 0, Aerie.Patience.ms())

    {:ok, gcs} = :gen_tcp.connect({:local, Path.join(sockets, "mavlink.sock")}, 0, [:binary, active: false])
    assert frame(gcs, 30)

    peer = Shovel.peer(shovel)
    session = Aerie.Base.Names.whereis(gateway, :session, {"main", 1})
    :ok = SerialPeer.unplug(peer)
    # It is lost two seconds later, and a busy machine may see only that.
    eventually(fn -> Store.vehicle(gateway, "VID-001").status in [:stale, :lost] end, "it is stale or lost")
    assert {:ok, _line} = :gen_tcp.recv(client, 0, Aerie.Patience.ms())

    SerialPeer.plug_in(peer, name_in: {dev, "ttyACM0"})
    eventually(fn -> match?(%{status: :online}, Store.vehicle(gateway, "VID-001")) end, "it is back")
    assert %{counters: %{reconnects: again}, local: back} = MavRouter.Link.snapshot(gateway, "link-1")
    assert again in 1..3
    assert Path.basename(back) == "ttyACM0"
    assert Aerie.Base.Names.whereis(gateway, :session, {"main", 1}) == session
    # Neither client was disconnected: the frames before the gap have been read, so the next ones are new.
    assert {:ok, _line} = :gen_tcp.recv(client, 0, Aerie.Patience.ms())
    boot = Store.vehicle(gateway, "VID-001").groups.attitude.time_boot_ms
    assert eventually(fn -> frame(gcs, 30).time_boot_ms > boot end, "the ground station hears it again")
  end

  # The ground station's next message with an id: four bytes of length, then the frame.
  defp frame(gcs, id) do
    {:ok, <<size::32-little>>} = :gen_tcp.recv(gcs, 4, Aerie.Patience.ms())
    {:ok, bytes} = :gen_tcp.recv(gcs, size, Aerie.Patience.ms())
    {frames, _parser} = MavCodec.Parser.push_datagram(MavCodec.Parser.new(), bytes)

    case frames do
      [%{id: ^id} = frame] -> frame |> MavCodec.decode() |> elem(1)
      _another -> frame(gcs, id)
    end
  end
end
