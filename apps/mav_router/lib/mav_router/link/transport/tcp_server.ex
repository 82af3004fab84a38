defmodule MavRouter.Link.Transport.TcpServer do
  @moduledoc """
  A TCP server: every connection is a peer of its own, numbered from 1.

  `MavRouter.Link.Transport.TcpAcceptor` accepts and limits them. The link's process reads the connections.
  """
  @behaviour MavRouter.Link.Transport

  alias MavRouter.Link.Transport.Form
  alias Aerie.Base.Net.Address
  alias MavRouter.Link.Transport.Net
  alias MavRouter.Link.Transport.TcpAcceptor

  # Connections that the kernel keeps until they are accepted: those beyond it would try again after seconds.
  @backlog 4_096

  @enforce_keys [:listener, :options]
  defstruct [:listener, :options, :acceptor, next: 1, sockets: %{}, peers: %{}, silent: MapSet.new()]

  @impl MavRouter.Link.Transport
  def traits, do: %{kind: :tcp_server, framing: :stream, protocol: :tcp, server: true, client: :remote}

  @impl MavRouter.Link.Transport
  def forms, do: [Form.address("tcpin:", "0.0.0.0:5760", "listen for TCP connections")]

  @impl MavRouter.Link.Transport
  def parse(_prefix, rest), do: Form.parse_address(rest, true)

  @impl MavRouter.Link.Transport
  def open(spec) do
    with {:ok, [address | _]} <- Net.resolve(spec.host) do
      bound = Net.bind(address, spec.port)
      options = [:binary, Net.family(address), bound, reuseaddr: true, active: false, backlog: @backlog]

      with {:ok, listener} <- :gen_tcp.listen(spec.port, options),
           do: {:ok, %__MODULE__{listener: listener, options: Net.tcp_options(spec)}}
    end
  end

  @impl MavRouter.Link.Transport
  def give(conn, link), do: :gen_tcp.controlling_process(conn.listener, link)

  @impl MavRouter.Link.Transport
  def activate(conn) do
    listener = conn.listener
    {:ok, %{conn | acceptor: TcpAcceptor.start(listener, conn.options)}, Net.local(listener)}
  end

  @impl MavRouter.Link.Transport
  def handle(conn, {:tcp, socket, bytes}) when is_map_key(conn.sockets, socket) do
    {[{:read, [{conn.sockets[socket], bytes}]}], heard(conn, socket)}
  end

  def handle(conn, {:tcp_passive, socket}) when is_map_key(conn.sockets, socket) do
    _ = :inet.setopts(socket, active: Net.active())
    {[], conn}
  end

  def handle(conn, {:tcp_closed, socket}) when is_map_key(conn.sockets, socket),
    do: gone(conn, socket, :closed)

  def handle(conn, {:tcp_error, socket, reason}) when is_map_key(conn.sockets, socket) do
    Net.tcp_discard(socket)
    gone(conn, socket, reason)
  end

  def handle(%{listener: listener} = conn, {:accepted, listener, socket, address}) do
    with {:ok, {_address, port}} <- :inet.peername(socket),
         :ok <- :inet.setopts(socket, active: Net.active()) do
      peer = conn.next

      conn = %{
        conn
        | next: peer + 1,
          sockets: Map.put(conn.sockets, socket, peer),
          peers: Map.put(conn.peers, peer, socket),
          silent: MapSet.put(conn.silent, socket)
      }

      {[{:peer_up, peer, Address.format(address, port)}], conn}
    else
      {:error, _already_closed} ->
        Net.tcp_discard(socket)
        TcpAcceptor.gone(conn.acceptor, socket)
        {[], conn}
    end
  end

  def handle(%{listener: listener} = conn, {:yield, listener, socket})
      when is_map_key(conn.sockets, socket) do
    Net.tcp_discard(socket)
    gone(conn, socket, "it sent nothing, and its place was needed")
  end

  def handle(%{listener: listener} = conn, {:refused, listener, n, text}), do: {[{:refused, n, text}], conn}
  def handle(%{acceptor: acceptor} = conn, {:EXIT, acceptor, reason}), do: {[{:closed, reason}], conn}
  def handle(_conn, _message), do: :unknown

  defp gone(conn, socket, reason) do
    {[{:peer_down, conn.sockets[socket], reason}], remove(conn, socket)}
  end

  defp remove(conn, socket) do
    TcpAcceptor.gone(conn.acceptor, socket)
    {peer, sockets} = Map.pop!(conn.sockets, socket)

    %{
      conn
      | sockets: sockets,
        peers: Map.delete(conn.peers, peer),
        silent: MapSet.delete(conn.silent, socket)
    }
  end

  defp heard(%{silent: silent} = conn, socket) do
    if MapSet.member?(silent, socket) do
      TcpAcceptor.heard(conn.acceptor, socket)
      %{conn | silent: MapSet.delete(silent, socket)}
    else
      conn
    end
  end

  @impl MavRouter.Link.Transport
  def write(conn, peer, bytes) do
    with {:ok, socket} <- Map.fetch(conn.peers, peer),
         :ok <- Net.tcp_write(socket, bytes) do
      {:ok, conn}
    else
      :error -> {:error, :enotconn, conn}
      :busy -> {:busy, conn}
      # The message that the peer closed follows.
      {:error, reason} -> {:error, reason, conn}
    end
  end

  @impl MavRouter.Link.Transport
  def drop(conn, peer) do
    case conn.peers do
      %{^peer => socket} ->
        Net.tcp_discard(socket)
        remove(conn, socket)

      _gone ->
        conn
    end
  end

  @impl MavRouter.Link.Transport
  def close(conn) do
    if conn.acceptor do
      Process.unlink(conn.acceptor)
      Process.exit(conn.acceptor, :kill)
    end

    for {_peer, socket} <- conn.peers, do: Net.tcp_discard(socket)
    :gen_tcp.close(conn.listener)
  end
end
