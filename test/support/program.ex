defmodule Aerie.Program do
  @moduledoc """
  A program that sends frames to a gateway by one of its ways in, and reads all that comes, so that it is never let go for being slow.
  """

  use GenServer

  alias Aerie.Patience
  alias MavRouter.{Link, Router}
  alias Aerie.WSClient

  @typedoc "How it is connected: UDP (its own address, the gateway's port), TCP, a WebSocket with headers, `mavlink.sock`."
  @type way ::
          {:udp, :inet.ip4_address(), :inet.port_number()}
          | {:tcp, :inet.port_number()}
          | {:websocket, :inet.port_number(), [{String.t(), String.t()}]}
          | {:unix, Path.t()}

  # Frames over UDP that were not read after that are lost: a link that does not keep up discards datagrams.
  @lost_ms 10_000
  # Fewer at once than a link that does not keep up takes for a backlog (`MavRouter.Link.Transport.Net.Backlog`):
  # nothing of them is discarded.
  @batch 50

  @doc "Connects."
  @spec start_link({Aerie.Base.Names.gateway(), way()}) :: GenServer.on_start()
  def start_link({gateway, way}), do: GenServer.start_link(__MODULE__, {gateway, way})

  @doc "Sends frames without waiting for them."
  @spec say(pid(), [binary()]) :: :ok
  def say(program, frames), do: GenServer.call(program, {:say, frames}, Patience.ms())

  @doc "Sends frames, and waits until the gateway has read all of them and is done with them."
  @spec deliver(pid(), [binary()]) :: :ok
  def deliver(program, frames) do
    for batch <- Enum.chunk_every(frames, @batch), do: read(program, batch)
    # The process that reads them is done with a read when it counts the next one.
    read(program, [List.last(frames)])
  end

  @doc "Ends the connection."
  @spec close(pid()) :: :ok
  def close(program), do: GenServer.stop(program)

  defp read(program, frames) do
    %{way: way} = :sys.get_state(program)

    Patience.eventually(
      fn -> read?(program, frames, frames_in(program) + length(frames), way) end,
      fn -> "#{inspect(way)}: #{length(frames)} frames are read; it had read #{frames_in(program)}" end
    )

    :ok
  end

  defp read?(program, frames, expected, way) do
    say(program, frames)
    lost = now() + if(elem(way, 0) == :udp, do: @lost_ms, else: Patience.ms())
    Patience.eventually(fn -> frames_in(program) >= expected or now() > lost end, "they are read, or lost")
    frames_in(program) >= expected
  end

  defp now, do: System.monotonic_time(:millisecond)

  defp frames_in(program) do
    %{gateway: gateway, way: way, port: port} = :sys.get_state(program)

    case Enum.find(Router.endpoints(gateway), &(same?(&1, way, port) and to?(&1, way, gateway))) do
      nil -> 0
      endpoint -> endpoint.counters.frames_in
    end
  end

  defp same?(%{kind: :unix}, {:unix, _path}, _port), do: true
  defp same?(%{peer: peer}, _way, port) when is_binary(peer), do: String.ends_with?(peer, ":#{port}")
  defp same?(_other, _way, _port), do: false

  # A UDP and a TCP program may have the same port at their end.
  defp to?(%{kind: :link, owner: owner}, way, gateway) when elem(way, 0) in [:udp, :tcp],
    do: List.last(Tuple.to_list(way)) == Link.snapshot(gateway, owner).port

  defp to?(%{kind: kind}, way, _gateway), do: kind == elem(way, 0)

  @impl GenServer
  def init({gateway, way}) do
    {socket, send} = open(way)
    {:ok, {_address, port}} = :inet.sockname(socket)
    {:ok, %{gateway: gateway, way: way, socket: socket, send: send, port: port}}
  end

  defp open({:udp, address, port}) do
    {:ok, socket} = :gen_udp.open(0, [:binary, active: true, ip: address, recbuf: 1_048_576])
    {socket, fn frames -> for bytes <- frames, do: :ok = :gen_udp.send(socket, address, port, bytes) end}
  end

  defp open({:tcp, port}) do
    {:ok, socket} = :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: true, nodelay: true])
    {socket, &(:ok = :gen_tcp.send(socket, &1))}
  end

  defp open({:websocket, port, headers}) do
    %WSClient{socket: socket} = client = WSClient.open(port, "/", headers: headers)
    :ok = :inet.setopts(socket, active: true)
    {socket, fn frames -> for bytes <- frames, do: :ok = WSClient.send(client, bytes) end}
  end

  defp open({:unix, path}) do
    {:ok, socket} = :gen_tcp.connect({:local, path}, 0, [:binary, active: true])

    {socket, &(:ok = :gen_tcp.send(socket, for(bytes <- &1, do: [<<byte_size(bytes)::32-little>>, bytes])))}
  end

  @impl GenServer
  def handle_call({:say, frames}, _from, state) do
    state.send.(frames)
    {:reply, :ok, state}
  end

  @impl GenServer
  def handle_info({closed, _socket}, state) when closed in [:tcp_closed, :udp_closed],
    do: {:stop, {:closed, state.way}, state}

  def handle_info(_read, state), do: {:noreply, state}
end
