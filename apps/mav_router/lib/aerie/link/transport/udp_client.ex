defmodule Aerie.Link.Transport.UdpClient do
  @moduledoc """
  UDP, calling: sends to one address and hears only that host. Replies may come from another port of the host (a server
  behind a router answers from where it likes); from then on that port is written to.

  Towards a broadcast address (`udpbcast:`) the first that answers, whoever it is, becomes the one that is written to and
  heard. In both cases the peer's name stays `:remote`.

  The name is resolved when the link connects. When nothing was heard for 30 s the link is opened again, and with it the
  name is resolved again and the reply's port forgotten: a server that moved is found.
  """
  @behaviour Aerie.Link.Transport

  alias Aerie.Link.Backlog
  alias Aerie.Address
  alias Aerie.Link.Transport.Net

  @enforce_keys [:socket, :to, :broadcast]
  defstruct [:socket, :to, :broadcast, :sender, latched: false, backlog: Backlog.new()]

  @impl Aerie.Link.Transport
  def framing, do: :datagram

  @impl Aerie.Link.Transport
  def open(spec) do
    with {:ok, [address | _]} <- Net.resolve(spec.host),
         {:ok, socket} <- Net.udp(any(address), 0, broadcast: spec.broadcast) do
      {:ok, %__MODULE__{socket: socket, to: {address, spec.port}, broadcast: spec.broadcast}}
    end
  end

  defp any(address) when tuple_size(address) == 8, do: {0, 0, 0, 0, 0, 0, 0, 0}
  defp any(_address), do: {0, 0, 0, 0}

  @impl Aerie.Link.Transport
  def give(conn, link), do: :gen_udp.controlling_process(conn.socket, link)

  @impl Aerie.Link.Transport
  def activate(conn) do
    {address, port} = conn.to

    with :ok <- :inet.setopts(conn.socket, active: Net.active()) do
      conn = %{conn | sender: Net.sender(conn.socket)}
      {:ok, conn, Map.put(Net.local(conn.socket), :peer, Address.format(address, port))}
    end
  end

  @impl Aerie.Link.Transport
  def handle(%{socket: socket} = conn, {:udp, socket, address, port, bytes}) do
    {datagrams, shed, backlog} = Net.take(socket, conn.backlog, {{address, port}, bytes})
    {reads, conn} = Enum.flat_map_reduce(datagrams, %{conn | backlog: backlog}, &hear/2)
    {Net.events(reads, shed), conn}
  end

  def handle(conn, message), do: Net.udp_message(conn, message)

  defp hear({from, bytes}, %{to: from} = conn), do: {[{:remote, bytes}], conn}

  defp hear({{address, _} = from, bytes}, %{to: {address, _}} = conn) do
    {[{:remote, bytes}], %{conn | to: from, latched: true}}
  end

  defp hear({from, bytes}, %{broadcast: true, latched: false} = conn) do
    {[{:remote, bytes}], %{conn | to: from, latched: true}}
  end

  defp hear(_stranger, conn), do: {[], conn}

  @impl Aerie.Link.Transport
  def write(%{to: {address, port}} = conn, _peer, bytes) do
    case Net.udp_write(conn.socket, conn.sender, address, port, bytes) do
      :ok -> {:ok, conn}
      :busy -> {:busy, conn}
      {:error, reason} -> {:error, reason, conn}
    end
  end

  @impl Aerie.Link.Transport
  def direct(%{sender: nil}, _peer), do: nil
  def direct(%{sender: sender, to: {address, port}}, :remote), do: {:udp, sender, Net.sockaddr(address, port)}

  @impl Aerie.Link.Transport
  def kernel_dropped(conn), do: Net.kernel_dropped(conn.socket)

  @impl Aerie.Link.Transport
  def close(conn), do: Net.udp_close(conn.socket, conn.sender)
end
