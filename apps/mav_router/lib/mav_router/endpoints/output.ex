defmodule MavRouter.Endpoints.Output do
  @moduledoc """
  Hands frames to one endpoint without ever waiting: straight to the socket of a UDP peer, from whichever process has them, or as
  one message to the process of any other endpoint. What does not fit is dropped and counted.
  """

  alias MavRouter.Endpoints.Output.Batch
  alias MavRouter.Endpoints.Endpoint
  alias MavRouter.Endpoints.Counters
  alias MavRouter.Endpoints.Owner.Renumber
  alias MavCodec.Frame

  # More frames than this of one component in one read mean that we are behind, and then several share a datagram, to save system
  # calls. Otherwise each has its own, because some routers (gomavlib's, XMAVLink) read only the first frame of a datagram. A vehicle
  # that packs datagrams itself (PX4) puts fewer into one.
  @many 64

  # From so many datagrams of one size on, one write that the kernel cuts up (UDP_SEGMENT of Linux) costs less than one
  # for each: six take less time than two. Receivers see no difference.
  @few 3
  @udp 17
  @segment 103

  @typedoc "What is needed of an endpoint: an `MavRouter.Forward.Table.Path`, or an `Endpoint`."
  @type path :: %{
          :out => Endpoint.out(),
          :counters => Counters.t(),
          :waiting => :atomics.atomics_ref(),
          optional(any) => any
        }

  @doc "Sends a batch; gives it back with the forms that were made for this endpoint."
  @spec emit(path, Batch.t()) :: Batch.t()
  def emit(%{recorded: gateway, owner: owner, networks: [network | _]} = path, batch) when gateway != nil do
    MavRouter.Recorder.sent_frames(gateway, owner, network, batch.frames)
    write_out(path, batch)
  end

  def emit(path, batch), do: write_out(path, batch)

  defp write_out(%{out: {:udp, socket, to}} = path, %Batch{n: 1, datagrams: [bytes]} = batch) do
    datagram(socket, to, bytes, 1, path.counters)
    batch
  end

  defp write_out(%{out: {:udp, socket, to}, coalesce: true} = path, %{n: n} = batch)
       when n > @many do
    batch = Batch.packed(batch)

    {good, bytes} =
      Enum.reduce(batch.datagrams, {true, 0}, fn bytes, {good, sum} ->
        if write(socket, to, bytes), do: {good, sum + byte_size(bytes)}, else: {false, sum}
      end)

    # A datagram that failed is not taken apart to count its frames: the whole batch counts as lost.
    if good, do: sent(path.counters, batch.n, bytes), else: Counters.add(path.counters, :failed, batch.n)
    batch
  end

  defp write_out(%{out: {:udp, socket, to}} = path, batch) do
    batch = Batch.sized(batch)

    Enum.each(batch.sized, fn {size, datagrams, n} ->
      if n >= @few and segments(socket, to, size, datagrams),
        do: sent(path.counters, n, n * size),
        else: Enum.each(datagrams, &datagram(socket, to, &1, 1, path.counters))
    end)

    batch
  end

  defp write_out(%{out: {:pid, pid, tag}} = path, batch) do
    batch = Batch.classed(batch)
    Enum.each(batch.runs, fn {class, bytes, n} -> message(path, pid, tag, class, bytes, n) end)
    batch
  end

  defp write_out(_nowhere, batch), do: batch

  @doc """
  Sends a batch through the link's process, which signs unsigned frames (`MavRouter.Signing.Signer.placeholder/1`) when it writes
  them, because time stamps must go out in their order.
  """
  @spec emit_to_be_signed(path, Batch.t()) :: Batch.t()
  def emit_to_be_signed(%{out: out, pid: pid, key: {_owner, peer}} = path, batch)
      when is_pid(pid) and peer != :self and out != nil do
    batch = Batch.classed(batch)

    Enum.each(batch.runs, fn {class, frames, n} ->
      message(path, pid, peer, class, Enum.map(frames, &MavRouter.Signing.placeholder/1), n)
    end)

    batch
  end

  def emit_to_be_signed(path, batch), do: emit(path, batch)

  @doc "Sends the bytes of `n` whole frames of one class."
  @spec bytes(path, iodata, MavRouter.Endpoints.Queue.TrafficClass.class(), pos_integer) :: :ok
  def bytes(%{out: {:udp, socket, to}} = path, bytes, _class, n),
    do: datagram(socket, to, IO.iodata_to_binary(bytes), n, path.counters)

  def bytes(%{out: {:pid, pid, tag}} = path, bytes, class, n),
    do: message(path, pid, tag, class, [IO.iodata_to_binary(bytes)], n)

  def bytes(_nowhere, _bytes, _class, _n), do: :ok

  @doc "Sends a client a frame in the name of a vehicle of a network, from the id under which it knows the vehicle."
  @spec answer(MavRouter.Forward.Table.Path.t(), network :: String.t(), binary) :: :ok
  def answer(%{renumber: nil} = path, _network, bytes), do: bytes(path, bytes, :ack, 1)

  def answer(path, network, bytes) do
    frame = Frame.from_bytes(bytes, nil)

    case Renumber.outward(path.renumber, %{path | networks: [network]}, frame, fn _system -> true end) do
      {:ok, frame} -> bytes(path, frame.bytes, :ack, 1)
      :refused -> :ok
    end
  end

  defp datagram(socket, to, bytes, n, counters) do
    if write(socket, to, bytes),
      do: sent(counters, n, byte_size(bytes)),
      else: Counters.add(counters, :failed, n)
  end

  defp sent(counters, n, bytes) do
    Counters.add(counters, :frames_out, n)
    Counters.add(counters, :bytes_out, bytes)
  end

  # False when nothing was sent: by a system or an interface that does not cut up datagrams, or for want of room.
  defp segments(socket, to, size, datagrams) do
    cut = %{level: @udp, type: @segment, data: <<size::16-native>>}
    :socket.sendmsg(socket, %{addr: to, iov: datagrams, ctrl: [cut]}, [], 0) == :ok
  end

  # With a time-out of 0 a kernel without room says so at once.
  defp write(socket, to, bytes) do
    case :socket.sendto(socket, bytes, to, [], 0) do
      :ok -> true
      # Nobody listens there now, but somebody may later.
      {:error, :econnrefused} -> true
      _no_room -> false
    end
  end

  defp message(path, pid, tag, class, bytes, n) do
    if not Endpoint.room?(path.waiting, class, :atomics.add_get(path.waiting, 1, n)) do
      :atomics.sub(path.waiting, 1, n)
      Counters.dropped(path.counters, class, n)
    else
      send(pid, if(tag == nil, do: {:forward, bytes, class}, else: {:forward, tag, bytes, class}))
      sent(path.counters, n, IO.iodata_length(bytes))
    end

    :ok
  end
end
