defmodule MavRouter.Link.Transport.TcpServer do
  @moduledoc """
  A TCP server: every connection is a peer of its own, numbered from 1.

  `MavRouter.Link.Transport.TcpAcceptor` accepts and limits them. The link's process reads the connections.
  """
  @behaviour MavRouter.Link.Transport

  alias MavRouter.Link.Transport.Form
  alias Aerie.Base.Address
  alias MavRouter.Link.Transport.Net
  alias MavRouter.Link.Transport.TcpAcceptor

  @enforce_keys [:listener]
  defstruct [:listener, :acceptor, next: 1, sockets: %{}, peers: %{}]

  @impl MavRouter.Link.Transport
  def traits, do: %{kind: :tcp_server, framing: :stream, protocol: :tcp, server: true, client: :remote}

  @impl MavRouter.Link.Transport
  def forms, do: [Form.address("tcpin:", "0.0.0.0:5760", "listen for TCP connections")]

  @impl MavRouter.Link.Transport
  def parse(_prefix, rest), do: Form.parse_address(rest, true)

  @impl MavRouter.Link.Transport
  def open(spec) do
    with {:ok, [address | _]} <- Net.resolve(spec.host) do
      options = [Net.family(address), ip: address, reuseaddr: true, backlog: 128] ++ Net.tcp_options(spec)
      with {:ok, listener} <- :gen_tcp.listen(spec.port, options), do: {:ok, %__MODULE__{listener: listener}}
    end
  end

  @impl MavRouter.Link.Transport
  def give(conn, link), do: :gen_tcp.controlling_process(conn.listener, link)

  @impl MavRouter.Link.Transport
  def activate(conn) do
    listener = conn.listener
    {:ok, %{conn | acceptor: TcpAcceptor.start(listener)}, Net.local(listener)}
  end

  @impl MavRouter.Link.Transport
  def handle(conn, {:tcp, socket, bytes}) when is_map_key(conn.sockets, socket) do
    {[{:read, [{conn.sockets[socket], bytes}]}], conn}
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
      conn = %{conn | next: peer + 1, sockets: Map.put(conn.sockets, socket, peer)}
      {[{:peer_up, peer, Address.format(address, port)}], put_in(conn.peers[peer], {socket, address})}
    else
      {:error, _already_closed} ->
        Net.tcp_discard(socket)
        TcpAcceptor.gone(conn.acceptor, address)
        {[], conn}
    end
  end

  def handle(%{listener: listener} = conn, {:refused, listener, n, text}), do: {[{:refused, n, text}], conn}
  def handle(%{acceptor: acceptor} = conn, {:EXIT, acceptor, reason}), do: {[{:closed, reason}], conn}
  def handle(_conn, _message), do: :unknown

  defp gone(conn, socket, reason) do
    {peer, sockets} = Map.pop!(conn.sockets, socket)
    {{_socket, address}, peers} = Map.pop!(conn.peers, peer)
    TcpAcceptor.gone(conn.acceptor, address)
    {[{:peer_down, peer, reason}], %{conn | sockets: sockets, peers: peers}}
  end

  @impl MavRouter.Link.Transport
  def write(conn, peer, bytes) do
    with {:ok, {socket, _address}} <- Map.fetch(conn.peers, peer),
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
    case Map.pop(conn.peers, peer) do
      {nil, _peers} ->
        conn

      {{socket, address}, peers} ->
        Net.tcp_discard(socket)
        TcpAcceptor.gone(conn.acceptor, address)
        %{conn | peers: peers, sockets: Map.delete(conn.sockets, socket)}
    end
  end

  @impl MavRouter.Link.Transport
  def close(conn) do
    if conn.acceptor do
      Process.unlink(conn.acceptor)
      Process.exit(conn.acceptor, :kill)
    end

    for {_peer, {socket, _address}} <- conn.peers, do: Net.tcp_discard(socket)
    :gen_tcp.close(conn.listener)
  end
end
