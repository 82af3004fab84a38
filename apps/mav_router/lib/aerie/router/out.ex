defmodule Aerie.Router.Out do
  @moduledoc """
  Hands frames to one endpoint, without waiting for anybody: straight to the socket of a UDP peer, by whichever process
  has them, or as one message to the process of any other endpoint. What does not fit is dropped and counted.
  """

  alias Aerie.Router.Batch
  alias Aerie.Router.Endpoint
  alias Aerie.Router.Tally

  # So many frames of one component at once means that we are behind: then a write for each is what there is no time for.
  # Below that every frame has a datagram of its own, because there are routers (gomavlib's, XMAVLink) that read no further
  # than the first; and a vehicle that packs its own datagrams (PX4) says fewer in one.
  @many 64

  @typedoc "What is needed of an endpoint: `Aerie.Router.Plan.Way` or `Endpoint` with `coalesce`."
  @type way :: %{
          :out => Endpoint.out(),
          :tally => Tally.t(),
          :waiting => :atomics.atomics_ref(),
          optional(any) => any
        }

  @doc "Sends a batch; gives it back with the forms that were made for it."
  @spec emit(way, Batch.t()) :: Batch.t()
  def emit(%{recorded: gateway, owner: owner, networks: [network | _]} = way, batch) when gateway != nil do
    Aerie.Recorder.sent_frames(gateway, owner, network, batch.frames)
    write_out(way, batch)
  end

  def emit(way, batch), do: write_out(way, batch)

  defp write_out(%{out: {:udp, socket, to}} = way, %Batch{n: 1, datagrams: [bytes]} = batch) do
    datagram(socket, to, bytes, 1, way.tally)
    batch
  end

  defp write_out(%{out: {:udp, socket, to}, coalesce: true} = way, %{n: n} = batch)
       when n > @many do
    batch = Batch.packed(batch)

    {good, bytes} =
      Enum.reduce(batch.datagrams, {true, 0}, fn bytes, {good, sum} ->
        if write(socket, to, bytes), do: {good, sum + byte_size(bytes)}, else: {false, sum}
      end)

    # A datagram that failed is not taken apart again to count its frames: all of the batch are said to be lost.
    if good do
      Tally.add(way.tally, :frames_out, batch.n)
      Tally.add(way.tally, :bytes_out, bytes)
    else
      Tally.add(way.tally, :failed, batch.n)
    end

    batch
  end

  defp write_out(%{out: {:udp, socket, to}} = way, batch) do
    Enum.each(batch.frames, &datagram(socket, to, &1.bytes, 1, way.tally))
    batch
  end

  defp write_out(%{out: {:pid, pid, tag}} = way, batch) do
    batch = Batch.classed(batch)
    Enum.each(batch.runs, fn {class, bytes, n} -> message(way, pid, tag, class, bytes, n) end)
    batch
  end

  defp write_out(_nowhere, batch), do: batch

  @doc """
  Sends a batch by the link's process, which signs what is unsigned (`Aerie.Signing.Seal.placeholder/1`) when it writes it,
  because time stamps must go out in their order.
  """
  @spec to_be_signed(way, Batch.t()) :: Batch.t()
  def to_be_signed(%{out: out, pid: pid, key: {_owner, peer}} = way, batch)
      when is_pid(pid) and peer != :self and out != nil do
    batch = Batch.classed(batch)

    Enum.each(batch.runs, fn {class, frames, n} ->
      message(way, pid, peer, class, Enum.map(frames, &Aerie.Signing.placeholder/1), n)
    end)

    batch
  end

  def to_be_signed(way, batch), do: emit(way, batch)

  @doc "Sends bytes of so many whole frames and of one class."
  @spec bytes(way, iodata, Aerie.Router.Classify.class(), pos_integer) :: :ok
  def bytes(%{out: {:udp, socket, to}} = way, bytes, _class, n),
    do: datagram(socket, to, IO.iodata_to_binary(bytes), n, way.tally)

  def bytes(%{out: {:pid, pid, tag}} = way, bytes, class, n),
    do: message(way, pid, tag, class, [IO.iodata_to_binary(bytes)], n)

  def bytes(_nowhere, _bytes, _class, _n), do: :ok

  defp datagram(socket, to, bytes, n, tally) do
    if write(socket, to, bytes) do
      Tally.add(tally, :frames_out, n)
      Tally.add(tally, :bytes_out, byte_size(bytes))
    else
      Tally.add(tally, :failed, n)
    end
  end

  # Time-out 0: a kernel without room says so at once.
  defp write(socket, to, bytes) do
    case :socket.sendto(socket, bytes, to, [], 0) do
      :ok -> true
      # Nobody listens there just now; whether it will is not ours to judge.
      {:error, :econnrefused} -> true
      _no_room -> false
    end
  end

  defp message(way, pid, tag, class, bytes, n) do
    if not Endpoint.room?(way.waiting, class, :atomics.add_get(way.waiting, 1, n)) do
      :atomics.sub(way.waiting, 1, n)
      Tally.dropped(way.tally, class, n)
    else
      send(pid, if(tag == nil, do: {:forward, bytes, class}, else: {:forward, tag, bytes, class}))
      Tally.add(way.tally, :frames_out, n)
      Tally.add(way.tally, :bytes_out, IO.iodata_length(bytes))
    end

    :ok
  end
end
