defmodule MavRouter.Link.Transport.Net do
  @moduledoc "What the UDP and TCP transports share: names, address families, batches of datagrams, bounded writes."

  alias MavRouter.Link.Transport.Net.Backlog
  alias Aerie.Base.Net.Address

  # Messages between two renewals of `active`: enough that a busy socket rarely waits, few enough to bound the mailbox.
  @active 256
  # Datagrams handled at one wake-up, and in an overload.
  @batch 128
  @many 8_192
  @buffer 65_536
  # Datagrams that the socket reads from the kernel at a time; the default of 5 costs almost twice the time per datagram.
  @read_packets 64
  # For the time in which the link's process waits to be scheduled: about 5,000 small datagrams (Linux counts 832 bytes for
  # each, and doubles the requested size), half a second at 10,000 a second. More would only be older.
  @recbuf 2 * 1024 * 1024
  @datagram_bytes 832
  # SO_MEMINFO of Linux: nine numbers; the first is how many bytes wait, the last how many datagrams were dropped.
  @meminfo {1, 55}
  @meminfo_bytes 36
  @send_limit 128 * 1024
  @slow_patience 10

  @doc "How many messages a socket delivers before it has to be asked again (`{:active, n}`)."
  @spec active() :: pos_integer
  def active, do: @active

  @doc "The addresses of a host, IPv4 first. A name is resolved with every call."
  @spec resolve(:inet.ip_address() | String.t()) :: {:ok, [:inet.ip_address()]} | {:error, term}
  def resolve(address) when is_tuple(address), do: {:ok, [address]}

  def resolve(name) do
    if name =~ "%",
      do: with({:ok, address} <- Address.scoped(name), do: {:ok, [address]}),
      else: resolve_name(name)
  end

  defp resolve_name(name) do
    name = String.to_charlist(name)

    case Enum.flat_map([:inet, :inet6], &addresses(name, &1)) do
      [] -> {:error, :nxdomain}
      addresses -> {:ok, Enum.uniq(addresses)}
    end
  end

  defp addresses(name, family) do
    case :inet.getaddrs(name, family) do
      {:ok, addresses} -> addresses
      {:error, _reason} -> []
    end
  end

  @doc "The socket option for the family of an address."
  @spec family(:inet.ip_address()) :: :inet | :inet6
  def family(address) when tuple_size(address) == 8, do: :inet6
  def family(_address), do: :inet

  @doc "Opens a passive UDP socket at a local address. Never shares a port (no reuseaddr)."
  @spec udp(:inet.ip_address(), :inet.port_number(), keyword) :: {:ok, :gen_udp.socket()} | {:error, term}
  def udp(address, port, more \\ []) do
    # `buffer` comes after `recbuf`, which would otherwise make every read allocate as much.
    options = [
      :binary,
      family(address),
      bind(address, port),
      active: false,
      recbuf: @recbuf,
      buffer: @buffer,
      read_packets: @read_packets
    ]

    :gen_udp.open(port, options ++ more)
  end

  @doc "The socket option for a local address."
  @spec bind(:inet.ip_address(), :inet.port_number()) :: {:ip, :inet.ip_address()} | {:ifaddr, map}
  def bind(address, port) do
    case Address.scope(address) do
      {^address, 0} -> {:ip, address}
      _link_local -> {:ifaddr, sockaddr(address, port)}
    end
  end

  @doc "Connects by TCP to an address of a host."
  @spec connect(:inet.ip_address(), :inet.port_number(), keyword, timeout) ::
          {:ok, :gen_tcp.socket()} | {:error, term}
  def connect(address, port, options, timeout) do
    options = [family(address) | options]

    case Address.scope(address) do
      {^address, 0} -> :gen_tcp.connect(address, port, options, timeout)
      _link_local -> :gen_tcp.connect(sockaddr(address, port), options, timeout)
    end
  end

  @doc """
  What to say of a UDP socket's receive buffer if the system gave less than was asked for, otherwise nil. Linux gives at most
  `net.core.rmem_max` without a word.
  """
  @spec short_buffer(:gen_udp.socket()) :: String.t() | nil
  def short_buffer(socket) do
    case :inet.getopts(socket, [:recbuf]) do
      {:ok, [recbuf: bytes]} -> short(bytes, :os.type())
      _unknown -> nil
    end
  end

  @doc "The same for the bytes that the system says it gave, and the system (`:os.type/0`). Pure."
  @spec short(non_neg_integer, {atom, atom}) :: String.t() | nil
  # Linux says twice what it gave, because it counts its own book-keeping.
  def short(bytes, {:unix, :linux}) when bytes < 2 * @recbuf do
    "the kernel keeps only #{kib(div(bytes, 2))} KiB of unread datagrams in place of #{kib(@recbuf)} (about " <>
      "#{div(bytes, @datagram_bytes)} small ones), so a burst is lost sooner. Allow more before the start: " <>
      "sysctl -w net.core.rmem_max=#{@recbuf}"
  end

  def short(bytes, os) when bytes < @recbuf and os != {:unix, :linux} do
    "the system keeps only #{kib(bytes)} KiB of unread datagrams in place of #{kib(@recbuf)}, so a burst is lost sooner"
  end

  def short(_bytes, _os), do: nil

  defp kib(bytes), do: div(bytes, 1024)

  @doc "Handles what a UDP socket sends besides datagrams, as `c:MavRouter.Link.Transport.handle/2`."
  @spec udp_message(conn, term) :: {[{:closed, :closed}], conn} | :unknown
        when conn: %{socket: :gen_udp.socket()}
  def udp_message(%{socket: socket} = conn, {:udp_passive, socket}) do
    _ = :inet.setopts(socket, active: active())
    {[], conn}
  end

  # The network's answer to something sent before (no such port): says nothing about other peers.
  def udp_message(%{socket: socket} = conn, {:udp_error, socket, _reason}), do: {[], conn}
  def udp_message(%{socket: socket} = conn, {:udp_closed, socket}), do: {[{:closed, :closed}], conn}
  def udp_message(_conn, _message), do: :unknown

  @doc """
  The datagrams that wait in the mailbox, in order, with their senders; at most #{@batch}. Reactivates the socket if it had
  stopped.
  """
  @spec drain(:gen_udp.socket()) :: [{{:inet.ip_address(), :inet.port_number()}, binary}]
  def drain(socket), do: drain(socket, @batch, [])

  defp drain(_socket, 0, reads), do: Enum.reverse(reads)

  defp drain(socket, room, reads) do
    receive do
      {:udp, ^socket, address, port, bytes} -> drain(socket, room - 1, [{{address, port}, bytes} | reads])
      {:udp_passive, ^socket} -> reactivate(socket, room, reads)
    after
      0 -> Enum.reverse(reads)
    end
  end

  @doc """
  The same by the second handle (`sender/1`), with the interface by which each came: the driver leaves it out, and
  nobody at a link-local address can be answered without. `look/1` begins; then a message of the handle says when there
  is more.
  """
  @spec drain_scoped(:socket.socket()) :: [{{:inet.ip_address(), :inet.port_number()}, binary}]
  def drain_scoped(handle), do: drain_scoped(handle, @batch, [])

  defp drain_scoped(handle, 0, reads) do
    look(handle)
    Enum.reverse(reads)
  end

  defp drain_scoped(handle, room, reads) do
    case :socket.recvfrom(handle, @buffer, [], :nowait) do
      {:ok, {source, bytes}} ->
        drain_scoped(handle, room - 1, [{from(source), bytes} | reads])

      # The network's answer to something sent before.
      {:error, :econnrefused} ->
        drain_scoped(handle, room - 1, reads)

      _nothing_more ->
        Enum.reverse(reads)
    end
  end

  @doc """
  What waits in the kernel, by the second handle, in order; in an overload all of it (up to #{@many}), so that what is
  discarded is chosen of all. Then the calling process has a higher priority until what it read is passed on
  (`passed_on/2`): with hundreds of sessions that want to run, it would get the turn of one for each few datagrams.
  """
  @spec read(:socket.socket() | nil, Backlog.t()) :: [{{:inet.ip_address(), :inet.port_number()}, binary}]
  def read(nil, _backlog), do: []

  def read(handle, backlog) do
    if Backlog.strained?(backlog) do
      _ = Process.flag(:priority, :high)
      reads = read(handle, all(handle), [])
      if reads == [], do: Process.flag(:priority, :normal)
      reads
    else
      read(handle, @batch, [])
    end
  end

  # What arrives during the read waits for the next one: otherwise the link could read and discard for ever.
  defp all(handle) do
    case kernel(handle) do
      {0, _dropped} -> @many
      {bytes, _dropped} -> min(div(bytes, @datagram_bytes) + 1, @many)
    end
  end

  defp read(_handle, 0, reads), do: Enum.reverse(reads)

  defp read(handle, room, reads) do
    case :socket.recvfrom(handle, @buffer, [], 0) do
      {:ok, {source, bytes}} -> read(handle, room - 1, [{from(source), bytes} | reads])
      {:error, :econnrefused} -> read(handle, room - 1, reads)
      {:error, _nothing_more} -> Enum.reverse(reads)
    end
  end

  defp from(%{addr: address, port: port, scope_id: scope}), do: {Address.with_scope(address, scope), port}
  defp from(%{addr: address, port: port}), do: {address, port}

  @doc "Has the calling process look for datagrams by the second handle."
  @spec look(:socket.socket()) :: :ok
  def look(handle) do
    send(self(), {:"$socket", handle, :select, :look})
    :ok
  end

  defp reactivate(socket, room, reads) do
    _ = :inet.setopts(socket, active: @active)
    drain(socket, room, reads)
  end

  @doc """
  The datagrams without those that are too many (`MavRouter.Link.Transport.Net.Backlog`), and how many those were. They
  were all that waited in the mailbox at `now` (monotonic ms). `sender` is the socket's second handle (`sender/1`).
  """
  @spec take(:socket.socket() | nil, Backlog.t(), [datagram], integer) ::
          {[datagram], Backlog.discarded(), Backlog.t()}
        when datagram: {{:inet.ip_address(), :inet.port_number()}, binary}
  def take(sender, backlog, datagrams, now) do
    backlog =
      if Backlog.due?(backlog, now),
        do: Backlog.measure(backlog, waiting(sender) + length(datagrams), now),
        else: backlog

    Backlog.take(backlog, datagrams)
  end

  @doc "Datagrams, and how many were discarded, as events of a transport."
  @spec events([{term, binary}], Backlog.discarded(), Backlog.t()) :: [MavRouter.Link.Transport.event()]
  def events(reads, discarded, backlog) do
    reads = if reads == [], do: [], else: [{:read, reads}]
    counts(discarded) ++ reads ++ if(Backlog.timed?(backlog), do: [:passed_on], else: [])
  end

  defp counts(%{shed: 0, shed_new: 0}), do: []
  defp counts(discarded), do: for({name, n} when n > 0 <- Map.to_list(discarded), do: {:count, name, n})

  @doc "What was read last has been passed on by `now`, as `c:MavRouter.Link.Transport.passed_on/2`."
  @spec passed_on(conn, integer) :: conn when conn: %{:backlog => Backlog.t(), optional(atom) => term}
  def passed_on(conn, now) do
    _ = Process.flag(:priority, :normal)
    %{conn | backlog: Backlog.passed(conn.backlog, now)}
  end

  @doc "Has the kernel hold as many unread datagrams as `Backlog.room/1` says, if it said another number before."
  @spec fit(:socket.socket() | nil, Backlog.t(), Backlog.t()) :: :ok
  def fit(nil, _before, _now), do: :ok

  def fit(handle, before, now) do
    bytes = recbuf(Backlog.room(now))
    _ = if bytes != recbuf(Backlog.room(before)), do: :socket.setopt(handle, {:socket, :rcvbuf}, bytes)
    :ok
  end

  # Linux takes twice what it is asked for.
  defp recbuf(:most), do: @recbuf
  defp recbuf(room), do: min(div(room * @datagram_bytes, 2), @recbuf)

  defp waiting(sender) do
    {:message_queue_len, messages} = Process.info(self(), :message_queue_len)
    {bytes, _dropped} = kernel(sender)
    messages + div(bytes, @datagram_bytes)
  end

  @doc """
  How many datagrams of a socket the kernel has dropped because its buffer was full, by its second handle; 0 where that
  is not known.
  """
  @spec kernel_dropped(:socket.socket() | nil) :: non_neg_integer
  def kernel_dropped(sender), do: sender |> kernel() |> elem(1)

  # By the second handle: the driver takes twenty times as many steps, and each link asks up to 24 times a second.
  defp kernel(sender) do
    with {:unix, :linux} when sender != nil <- :os.type(),
         {:ok, <<bytes::32-native, _::28-binary, dropped::32-native>>} <-
           :socket.getopt_native(sender, @meminfo, @meminfo_bytes) do
      {bytes, dropped}
    else
      _unknown -> {0, 0}
    end
  end

  @doc """
  A second handle of a UDP socket for writing: any process may use it past the port's queue, at a third of the cost. It ends
  with the calling process; close it only by `udp_close/2`. nil if the system does not allow one.
  """
  @spec sender(:gen_udp.socket()) :: :socket.socket() | nil
  def sender(socket) do
    with {:ok, fd} <- :inet.getfd(socket),
         {:ok, {address, _port}} <- :inet.sockname(socket),
         options = %{dup: true, domain: family(address), type: :dgram, protocol: :udp},
         {:ok, sender} <- :socket.open(fd, options) do
      sender
    else
      {:error, _reason} -> nil
    end
  end

  @doc "An address as `:socket` wants it."
  @spec sockaddr(:inet.ip_address(), :inet.port_number()) :: map
  def sockaddr(address, port) when tuple_size(address) == 8 do
    {address, scope} = Address.scope(address)
    %{family: :inet6, addr: address, port: port, flowinfo: 0, scope_id: scope}
  end

  def sockaddr(address, port), do: %{family: :inet, addr: address, port: port}

  @doc "The same in the form of the system's own structure for IPv4, which `:socket` need not encode for each datagram."
  @spec encoded(:inet.ip_address(), :inet.port_number()) :: map
  def encoded({a, b, c, d}, port), do: %{family: 2, addr: <<port::16, a, b, c, d, 0::64>>}
  def encoded(address, port), do: sockaddr(address, port)

  @doc "Writes one datagram, by the second handle if there is one. It is not an error if nobody listens there."
  @spec udp_write(:gen_udp.socket(), :socket.socket() | nil, :inet.ip_address(), :inet.port_number(), iodata) ::
          :ok | :busy | {:error, term}
  def udp_write(socket, nil, address, port, bytes),
    do: socket |> :gen_udp.send(sockaddr(address, port), bytes) |> written()

  def udp_write(_socket, sender, address, port, bytes) do
    written(:socket.sendto(sender, IO.iodata_to_binary(bytes), sockaddr(address, port), [], 0))
  end

  defp written(:ok), do: :ok
  defp written({:error, :econnrefused}), do: :ok
  defp written({:error, reason}) when reason in [:eagain, :enobufs, :timeout], do: :busy
  defp written({:error, reason}), do: {:error, reason}

  @doc "Closes a UDP socket and its second handle."
  @spec udp_close(:gen_udp.socket(), :socket.socket() | nil) :: :ok
  def udp_close(socket, sender) do
    # What was read last (`read/2`) may not have been passed on.
    _ = Process.flag(:priority, :normal)

    # Only in this order: `:socket.close/1` makes the shared descriptor blocking, and a driver that still reads from it
    # would block a scheduler, and with it the whole VM, until the next datagram.
    :ok = :gen_udp.close(socket)
    _ = if sender, do: :socket.close(sender)
    :ok
  end

  @doc "The facts of a UDP socket and its second handle for the link's snapshot."
  @spec udp_info(:gen_udp.socket(), :socket.socket() | nil) :: MavRouter.Link.Transport.info()
  def udp_info(socket, sender) do
    warnings = Enum.reject([short_buffer(socket), uncounted(sender)], &is_nil/1)
    Map.put(local(socket), :warning, if(warnings != [], do: Enum.join(warnings, "; ")))
  end

  defp uncounted(nil), do: "what the kernel drops is not counted: the socket cannot be opened twice"
  defp uncounted(_sender), do: nil

  @doc """
  The options of a link's TCP sockets; a half-open connection is noticed within half a minute, on a link of high latency
  within #{@slow_patience} times that.
  """
  @spec tcp_options(MavRouter.Link.Spec.t()) :: keyword
  def tcp_options(spec) do
    [
      :binary,
      active: false,
      nodelay: true,
      buffer: @buffer,
      keepalive: true,
      # Less than the kernel's default, which for a slow reader is minutes of old telemetry.
      sndbuf: @send_limit,
      high_watermark: 2 * @send_limit,
      send_timeout: 1000,
      send_timeout_close: true
    ] ++ keepalive_options(patience(spec))
  end

  @doc "How many times as long as on other links an answer of the other end may take."
  @spec patience(MavRouter.Link.Spec.t()) :: pos_integer
  def patience(%{options: %{high_latency: true}}), do: @slow_patience
  def patience(_spec), do: 1

  # Seconds, seconds, attempts; milliseconds for unacknowledged data.
  defp keepalive_options(patience) do
    case :os.type() do
      {:unix, :linux} ->
        [keepidle: 10 * patience, keepintvl: 5 * patience, keepcnt: 4, user_timeout: 30_000 * patience]

      _other ->
        []
    end
  end

  @doc """
  Writes to a TCP socket unless #{div(@send_limit, 1024)} KiB already wait: nobody waits for a peer that stops reading; it misses
  frames.
  """
  @spec tcp_write(:gen_tcp.socket(), iodata) :: :ok | :busy | {:error, term}
  def tcp_write(socket, bytes) do
    case :inet.getstat(socket, [:send_pend]) do
      {:ok, [send_pend: waiting]} -> if room?(waiting), do: :gen_tcp.send(socket, bytes), else: :busy
      {:error, reason} -> {:error, reason}
    end
  end

  @doc "Whether a connection in which so many bytes wait accepts more."
  @spec room?(non_neg_integer) :: boolean
  def room?(waiting), do: waiting <= @send_limit

  @doc """
  Closes a TCP socket at once. Bytes that wait for a peer that does not read are discarded, for which closing would wait.
  """
  @spec tcp_close(:gen_tcp.socket()) :: :ok
  def tcp_close(socket) do
    _ =
      with {:ok, [send_pend: waiting]} when waiting > 0 <- :inet.getstat(socket, [:send_pend]) do
        :inet.setopts(socket, linger: {true, 0})
      end

    :gen_tcp.close(socket)
  end

  @doc """
  The same by a process of its own: closing scans the caller's mailbox, which in a link's process is the path of frames.
  """
  @spec tcp_discard(:gen_tcp.socket()) :: :ok
  def tcp_discard(socket) do
    _pid = spawn(fn -> tcp_close(socket) end)
    :ok
  end

  @doc "The address of our end, for people, and its port."
  @spec local(port) :: %{local: String.t(), port: :inet.port_number()}
  def local(socket) do
    case :inet.sockname(socket) do
      {:ok, {address, port}} -> %{local: Address.format(address, port), port: port}
      {:error, _closed} -> %{local: "closed", port: 0}
    end
  end
end
