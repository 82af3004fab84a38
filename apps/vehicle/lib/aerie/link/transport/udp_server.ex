defmodule Aerie.Link.Transport.UdpServer do
  @moduledoc """
  UDP, listening: every sender is a peer of its own, `{address, port}`. Which senders become peers, and for how long, is
  the link's business; this module answers to any address it is told.
  """
  @behaviour Aerie.Link.Transport

  alias Aerie.Link.Transport.Net

  @impl Aerie.Link.Transport
  def framing, do: :datagram

  @impl Aerie.Link.Transport
  def open(spec) do
    with {:ok, [address | _]} <- Net.resolve(spec.host), do: Net.udp(address, spec.port)
  end

  @impl Aerie.Link.Transport
  def give(socket, link), do: :gen_udp.controlling_process(socket, link)

  @impl Aerie.Link.Transport
  def activate(socket) do
    with :ok <- :inet.setopts(socket, active: Net.active()), do: {:ok, socket, Net.local(socket)}
  end

  @impl Aerie.Link.Transport
  def handle(socket, {:udp, socket, address, port, bytes}) do
    {[{:read, [{{address, port}, bytes} | Net.drain(socket)]}], socket}
  end

  def handle(socket, {:udp_passive, socket}) do
    _ = :inet.setopts(socket, active: Net.active())
    {[], socket}
  end

  # An answer of the network to something sent before (no such port there): says nothing about the other peers.
  def handle(socket, {:udp_error, socket, _reason}), do: {[], socket}
  def handle(socket, {:udp_closed, socket}), do: {[{:closed, :closed}], socket}
  def handle(_socket, _message), do: :unknown

  @impl Aerie.Link.Transport
  def write(socket, {address, port}, bytes) do
    case :gen_udp.send(socket, address, port, bytes) do
      :ok -> {:ok, socket}
      {:error, reason} when reason in [:eagain, :enobufs] -> {:busy, socket}
      {:error, reason} -> {:error, reason, socket}
    end
  end

  def write(socket, _peer, _bytes), do: {:error, :enotconn, socket}

  @impl Aerie.Link.Transport
  def drop(socket, _peer), do: socket

  @impl Aerie.Link.Transport
  def close(socket), do: :gen_udp.close(socket)
end
