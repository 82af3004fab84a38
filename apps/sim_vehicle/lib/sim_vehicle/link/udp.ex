defmodule SimVehicle.Link.Udp do
  @moduledoc false

  @behaviour SimVehicle.Link

  # Datagrams taken before the socket has to be opened for more: a flood cannot fill the mailbox.
  @active 100

  # On a machine that is busy for seconds the kernel keeps what comes meanwhile; it grants less if it may not give as much.
  @receive_buffer 1_048_576

  defstruct [:socket, :peer, :role]

  @impl SimVehicle.Link
  def open(role, ip, port) do
    local = if role == :server, do: [ip: ip], else: []

    with {:ok, socket} <-
           :gen_udp.open(if(role == :server, do: port, else: 0), [
             :binary,
             {:active, @active},
             {:recbuf, @receive_buffer},
             # Or each datagram gets memory for as much.
             {:buffer, 9_216} | local
           ]) do
      {:ok, %__MODULE__{socket: socket, role: role, peer: if(role == :client, do: {ip, port})}}
    end
  end

  @impl SimVehicle.Link
  def handle(%{socket: socket, role: :server} = link, {:udp, socket, ip, port, bytes}) do
    {:data, bytes, %{link | peer: {ip, port}}}
  end

  def handle(%{socket: socket} = link, {:udp, socket, _ip, _port, bytes}), do: {:data, bytes, link}

  def handle(%{socket: socket} = link, {:udp_passive, socket}) do
    :ok = :inet.setopts(socket, active: @active)
    {:ok, link}
  end

  # "Connection refused" of an earlier datagram: the next may arrive.
  def handle(%{socket: socket} = link, {:udp_error, socket, _reason}), do: {:ok, link}
  def handle(_link, _message), do: :unknown

  @impl SimVehicle.Link
  def send_bytes(%{peer: nil} = link, _bytes), do: {:dropped, link}

  def send_bytes(%{peer: {ip, port}} = link, bytes) do
    case :gen_udp.send(link.socket, ip, port, bytes) do
      :ok -> {:sent, link}
      {:error, _reason} -> {:dropped, link}
    end
  end

  @impl SimVehicle.Link
  def port(link) do
    {:ok, port} = :inet.port(link.socket)
    port
  end

  @impl SimVehicle.Link
  def drop(%{role: :server} = link), do: %{link | peer: nil}
  def drop(link), do: link

  @impl SimVehicle.Link
  def close(link), do: :gen_udp.close(link.socket)
end
