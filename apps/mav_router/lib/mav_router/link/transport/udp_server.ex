defmodule MavRouter.Link.Transport.UdpServer do
  @moduledoc """
  A UDP server: every sender is a peer of its own, `{address, port}`. The link decides which senders become peers and for how
  long (`MavRouter.Link.Peers`); this module writes to any address.
  """
  @behaviour MavRouter.Link.Transport

  alias MavRouter.Link.Transport.Net.Backlog
  alias MavRouter.Link.Transport.Net.Gathering
  alias MavRouter.Link.Transport.{Form, Net}

  @enforce_keys [:socket]
  defstruct [
    :socket,
    :sender,
    backlog: Backlog.new(),
    gathering: Gathering.new(),
    resting?: false,
    scoped?: false
  ]

  @impl MavRouter.Link.Transport
  def traits, do: %{kind: :udp_server, framing: :datagram, protocol: :udp, server: true, client: :remote}

  @impl MavRouter.Link.Transport
  def forms do
    [
      Form.address("udpin:", "0.0.0.0:14550", "listen for UDP, e.g. udpin:0.0.0.0:14550"),
      Form.address("udp:", "0.0.0.0:14550", nil)
    ]
  end

  @impl MavRouter.Link.Transport
  def parse(_prefix, rest), do: Form.parse_address(rest, true)

  @impl MavRouter.Link.Transport
  def open(spec) do
    with {:ok, [address | _]} <- Net.resolve(spec.host),
         {:ok, socket} <- Net.udp(address, spec.port),
         do: {:ok, %__MODULE__{socket: socket}}
  end

  @impl MavRouter.Link.Transport
  def give(conn, link), do: :gen_udp.controlling_process(conn.socket, link)

  @impl MavRouter.Link.Transport
  def activate(%{socket: socket} = conn) do
    sender = Net.sender(socket)

    scoped? =
      sender != nil and match?({:ok, {address, _port}} when tuple_size(address) == 8, :inet.sockname(socket))

    conn = %{conn | sender: sender, scoped?: scoped?}
    with :ok <- listen(conn), do: {:ok, conn, Net.udp_info(socket, sender)}
  end

  defp listen(%{scoped?: true, sender: sender}), do: Net.look(sender)
  defp listen(%{socket: socket}), do: :inet.setopts(socket, active: Net.active())

  @impl MavRouter.Link.Transport
  def handle(%{socket: socket} = conn, {:udp, socket, address, port, bytes}) do
    {events, conn} = received(conn, [{{address, port}, bytes} | Net.drain(socket)])
    {events, rest(conn)}
  end

  def handle(%{sender: sender, scoped?: true} = conn, {:"$socket", sender, :select, _ref}) do
    with %{resting?: false} <- conn, [_ | _] = datagrams <- Net.drain_scoped(sender) do
      {events, conn} = received(conn, datagrams)
      {events, rest(conn)}
    else
      _later_or_nothing -> {[], conn}
    end
  end

  # Past the driver, which takes two calls and a message more for what has waited anyway.
  def handle(%{socket: socket} = conn, {:gathered, socket}) do
    case Net.read(conn.sender, conn.backlog) do
      [] ->
        _ = listen(conn)
        {[], %{conn | resting?: false}}

      datagrams ->
        {events, conn} = received(conn, datagrams)
        {Enum.uniq(events ++ [:passed_on]), rest(conn, listen: true)}
    end
  end

  def handle(%{socket: socket, resting?: true} = conn, {:udp_passive, socket}), do: {[], conn}
  def handle(conn, message), do: Net.udp_message(conn, message)

  defp received(conn, datagrams) do
    now = :erlang.monotonic_time(:millisecond)
    {reads, shed, backlog} = Net.take(conn.sender, conn.backlog, datagrams, now)
    :ok = Net.fit(conn.sender, conn.backlog, backlog)
    gathering = Gathering.read(conn.gathering, datagrams, now)
    {Net.events(reads, shed, backlog), %{conn | backlog: backlog, gathering: gathering}}
  end

  # What comes meanwhile waits in the kernel.
  defp rest(conn, options \\ [])
  defp rest(%{resting?: true} = conn, []), do: conn

  defp rest(%{socket: socket} = conn, options) do
    case if(Backlog.strained?(conn.backlog), do: 1, else: Gathering.wait_ms(conn.gathering)) do
      0 ->
        _ = if options[:listen], do: listen(conn)
        %{conn | resting?: false}

      ms ->
        _ = if not conn.resting?, do: :inet.setopts(socket, active: false)
        _timer = :erlang.send_after(ms, self(), {:gathered, socket})
        %{conn | resting?: true}
    end
  end

  @impl MavRouter.Link.Transport
  defdelegate passed_on(conn, now), to: Net

  @impl MavRouter.Link.Transport
  def write(conn, {address, port}, bytes) do
    case Net.udp_write(conn.socket, conn.sender, address, port, bytes) do
      :ok -> {:ok, conn}
      :busy -> {:busy, conn}
      {:error, reason} -> {:error, reason, conn}
    end
  end

  def write(conn, _peer, _bytes), do: {:error, :enotconn, conn}

  @impl MavRouter.Link.Transport
  def direct(%{sender: nil}, _peer), do: nil
  def direct(%{sender: sender}, {address, port}), do: {:udp, sender, Net.encoded(address, port)}

  @impl MavRouter.Link.Transport
  def kernel_dropped(conn), do: Net.kernel_dropped(conn.sender)

  @impl MavRouter.Link.Transport
  def drop(conn, _peer), do: conn

  @impl MavRouter.Link.Transport
  def close(conn), do: Net.udp_close(conn.socket, conn.sender)
end
