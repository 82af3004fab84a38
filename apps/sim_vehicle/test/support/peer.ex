defmodule SimVehicle.Peer do
  @moduledoc """
  A ground station in the test's process: a socket, a parser, and waiting for messages instead of sleeping.
  """

  alias MavCodec.Parser

  @dialect MavCodec.Dialects.Upstream

  defstruct [:socket, :kind, :to, :parser, seq: 0, frames: [], raw: []]

  @doc "A UDP socket on a free port of the loopback; `to` is where it sends (learned when it hears something)."
  def udp(to \\ nil) do
    {:ok, socket} = :gen_udp.open(0, [:binary, active: true, ip: {127, 0, 0, 1}, recbuf: 1_000_000])
    %__MODULE__{socket: socket, kind: :udp, to: to && {{127, 0, 0, 1}, to}, parser: parser()}
  end

  def tcp(port) do
    {:ok, socket} = :gen_tcp.connect({127, 0, 0, 1}, port, [:binary, active: true])
    %__MODULE__{socket: socket, kind: :tcp, parser: parser()}
  end

  def tcp_listen do
    {:ok, listener} = :gen_tcp.listen(0, [:binary, active: true, ip: {127, 0, 0, 1}])
    {:ok, port} = :inet.port(listener)
    {listener, port}
  end

  def tcp_accept(listener) do
    {:ok, socket} = :gen_tcp.accept(listener, patience())
    %__MODULE__{socket: socket, kind: :tcp, parser: parser()}
  end

  def port(peer) do
    {:ok, port} = :inet.port(peer.socket)
    port
  end

  def close(%{kind: :udp} = peer), do: :gen_udp.close(peer.socket)
  def close(peer), do: :gen_tcp.close(peer.socket)

  def say(peer, message), do: transmit(%{peer | seq: rem(peer.seq + 1, 256)}, encode(message, peer.seq))

  def transmit(%{kind: :udp, to: {ip, port}} = peer, bytes) do
    :ok = :gen_udp.send(peer.socket, ip, port, bytes)
    peer
  end

  def transmit(peer, bytes) do
    :ok = :gen_tcp.send(peer.socket, bytes)
    peer
  end

  def encode(message, seq \\ 0),
    do: MavCodec.encode(message, system: 255, component: 190, seq: seq, dialect: @dialect)

  @doc "Waits for a message of a kind of which `fun` is true; `{message, peer}`."
  def await(peer, module, fun \\ fn _message -> true end, deadline \\ deadline()) do
    {found, rest} = search(peer.frames, [module], fun)

    if found do
      {found, %{peer | frames: rest}}
    else
      peer |> receive_bytes(deadline) |> await(module, fun, deadline)
    end
  end

  @doc "The same for messages of some kinds until a time, in milliseconds of the monotonic clock; `{nil, peer}` if nothing comes."
  def within(peer, modules, fun, until) do
    {found, rest} = search(peer.frames, List.wrap(modules), fun)
    peer = %{peer | frames: rest}

    with nil <- found, %{} = more <- receive_until(%{peer | frames: []}, until) do
      within(more, modules, fun, until)
    else
      :late -> {nil, %{peer | frames: []}}
      found -> {found, peer}
    end
  end

  @doc "All messages of a kind that come until one of which `last?` is true, or a time."
  def collect(peer, module, last?, until, got \\ []) do
    {taken, peer} = take(peer, module)
    got = got ++ taken

    with false <- Enum.any?(taken, last?), %{} = peer <- receive_until(peer, until) do
      collect(peer, module, last?, until, got)
    else
      _over -> {got, peer}
    end
  end

  defp receive_until(%{socket: socket} = peer, until) do
    receive do
      {:udp, ^socket, ip, port, bytes} -> took(peer, bytes, {ip, port})
      {:tcp, ^socket, bytes} -> took(peer, bytes, nil)
    after
      max(until - System.monotonic_time(:millisecond), 0) -> :late
    end
  end

  @doc "Forgets the messages of a kind that have come."
  def forget(peer, module), do: elem(take(peer, module), 1)

  @doc "Takes the messages of a kind that have come."
  def take(peer, module) do
    peer = drain(peer)
    {taken, left} = Enum.split_with(peer.frames, &(&1.__struct__ == module))
    {taken, %{peer | frames: left}}
  end

  @doc "Waits until bytes contain `text`."
  def await_bytes(peer, text, deadline \\ deadline()) do
    if peer.raw |> Enum.reverse() |> IO.iodata_to_binary() =~ text,
      do: peer,
      else: peer |> receive_bytes(deadline) |> await_bytes(text, deadline)
  end

  @doc "Takes what has arrived without waiting."
  def drain(peer) do
    # First out of the mailbox and then read: a vehicle whose time goes fast sends more than is read on a busy machine.
    {frames, last} =
      peer.socket
      |> arrived([])
      |> Enum.map_reduce(peer, fn {bytes, from}, peer ->
        peer = took(%{peer | frames: []}, bytes, from)
        {peer.frames, peer}
      end)

    %{last | frames: Enum.concat([peer.frames | frames])}
  end

  defp arrived(socket, reads) do
    receive do
      {:udp, ^socket, ip, port, bytes} -> arrived(socket, [{bytes, {ip, port}} | reads])
      {:tcp, ^socket, bytes} -> arrived(socket, [{bytes, nil} | reads])
    after
      0 -> Enum.reverse(reads)
    end
  end

  @doc "All messages that were heard and not awaited."
  def messages(peer), do: peer.frames

  defp search(frames, modules, fun) do
    case Enum.split_while(frames, fn message -> not (message.__struct__ in modules and fun.(message)) end) do
      {all, []} -> {nil, all}
      {_before, [found | rest]} -> {found, rest}
    end
  end

  defp receive_bytes(peer, deadline) do
    socket = peer.socket

    receive do
      {:udp, ^socket, ip, port, bytes} -> took(peer, bytes, {ip, port})
      {:tcp, ^socket, bytes} -> took(peer, bytes, nil)
      {:tcp_closed, ^socket} -> raise "the vehicle closed the connection"
    after
      max(deadline - System.monotonic_time(:millisecond), 0) -> raise "nothing came in time"
    end
  end

  defp took(peer, bytes, from) do
    push = if peer.kind == :udp, do: &Parser.push_datagram/3, else: &Parser.push/3
    {frames, parser} = push.(peer.parser, bytes, nil)
    messages = for frame <- frames, {:ok, message} <- [MavCodec.decode(frame, @dialect)], do: message
    %{peer | parser: parser, to: from || peer.to, frames: peer.frames ++ messages, raw: [bytes | peer.raw]}
  end

  defp parser, do: Parser.new(dialects: [@dialect, MavCodec.Dialects.Ardupilot])
  defp patience, do: Application.fetch_env!(:ex_unit, :assert_receive_timeout)
  defp deadline, do: System.monotonic_time(:millisecond) + patience()
end
