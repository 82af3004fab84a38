defmodule MavRouter.Link.Transport.UdpClient do
  @moduledoc """
  A UDP client: sends to one address and accepts datagrams of that host only. If they come from another port (a server
  behind a NAT), it sends to that port from then on.

  With a broadcast address (`udpbcast:`), it accepts the first host that answers, and sends only to that host from then
  on. In both cases the peer's name stays `:remote`.

  The name is resolved when the link connects. After 30 s of silence the link is opened again, which resolves the name
  again and forgets the port: a server that moved is found.
  """
  @behaviour MavRouter.Link.Transport

  alias MavRouter.Link.Transport.Form
  alias MavRouter.Link.Transport.Net.Backlog
  alias Aerie.Base.Net.Address
  alias MavRouter.Link.Transport.Net

  @broadcast "udpbcast:"

  @enforce_keys [:socket, :to, :broadcast]
  defstruct [:socket, :to, :broadcast, :sender, found: false, backlog: Backlog.new()]

  @impl MavRouter.Link.Transport
  def traits, do: %{kind: :udp_client, framing: :datagram, protocol: :udp, announced: true, client: :remote}

  @impl MavRouter.Link.Transport
  def forms do
    [
      Form.address("udpout:", "192.168.1.10:14550", "send UDP to a vehicle, radio or router"),
      Form.address(@broadcast, "192.168.1.255:14550", "broadcast by UDP until one answers", "ADDRESS:PORT")
    ]
  end

  @impl MavRouter.Link.Transport
  def parse(prefix, rest) do
    with {:ok, fields} <- Form.parse_address(rest, false),
         do: {:ok, Map.put(fields, :broadcast, prefix == @broadcast)}
  end

  @impl MavRouter.Link.Transport
  def open(spec) do
    with {:ok, [address | _]} <- Net.resolve(spec.host),
         {:ok, socket} <- Net.udp(any(address), 0, broadcast: spec.broadcast) do
      {:ok, %__MODULE__{socket: socket, to: {address, spec.port}, broadcast: spec.broadcast}}
    end
  end

  defp any(address) when tuple_size(address) == 8, do: {0, 0, 0, 0, 0, 0, 0, 0}
  defp any(_address), do: {0, 0, 0, 0}

  @impl MavRouter.Link.Transport
  def give(conn, link), do: :gen_udp.controlling_process(conn.socket, link)

  @impl MavRouter.Link.Transport
  def activate(conn) do
    {address, port} = conn.to

    with :ok <- :inet.setopts(conn.socket, active: Net.active()) do
      conn = %{conn | sender: Net.sender(conn.socket)}
      {:ok, conn, Map.put(Net.udp_info(conn.socket, conn.sender), :peer, Address.format(address, port))}
    end
  end

  @impl MavRouter.Link.Transport
  def handle(%{socket: socket} = conn, {:udp, socket, address, port, bytes}) do
    datagrams = Enum.map([{{address, port}, bytes} | Net.drain(socket)], &scoped(&1, conn.to))

    {datagrams, shed, backlog} =
      Net.take(conn.sender, conn.backlog, datagrams, :erlang.monotonic_time(:millisecond))

    {reads, heard} = Enum.flat_map_reduce(datagrams, %{conn | backlog: backlog}, &hear/2)
    events = Net.events(reads, shed, backlog)
    # Before the reads, so that an answer to them goes to the new address.
    {if(heard.to == conn.to, do: events, else: [:redirected | events]), heard}
  end

  def handle(conn, message), do: Net.udp_message(conn, message)

  # The driver leaves out the interface of a link-local address; ours knows it.
  defp scoped({{address, port}, bytes} = datagram, {to, _port}) do
    case Address.scope(to) do
      {^address, number} when number != 0 -> {{to, port}, bytes}
      _other -> datagram
    end
  end

  defp hear({from, bytes}, %{to: from} = conn), do: {[{:remote, bytes}], conn}

  defp hear({{address, _} = from, bytes}, %{to: {address, _}} = conn) do
    {[{:remote, bytes}], %{conn | to: from, found: true}}
  end

  defp hear({from, bytes}, %{broadcast: true, found: false} = conn) do
    {[{:remote, bytes}], %{conn | to: from, found: true}}
  end

  defp hear(_stranger, conn), do: {[], conn}

  @impl MavRouter.Link.Transport
  defdelegate passed_on(conn, now), to: Net

  @impl MavRouter.Link.Transport
  def write(%{to: {address, port}} = conn, _peer, bytes) do
    case Net.udp_write(conn.socket, conn.sender, address, port, bytes) do
      :ok -> {:ok, conn}
      :busy -> {:busy, conn}
      {:error, reason} -> {:error, reason, conn}
    end
  end

  @impl MavRouter.Link.Transport
  def direct(%{sender: nil}, _peer), do: nil
  def direct(%{sender: sender, to: {address, port}}, :remote), do: {:udp, sender, Net.encoded(address, port)}

  @impl MavRouter.Link.Transport
  def kernel_dropped(conn), do: Net.kernel_dropped(conn.sender)

  @impl MavRouter.Link.Transport
  def close(conn), do: Net.udp_close(conn.socket, conn.sender)
end
