defmodule MavRouter.Link.Transport.TcpClient do
  @moduledoc "A TCP client. Tries all addresses of a name in turn, 5 s each; the error is that of the last one."
  @behaviour MavRouter.Link.Transport

  alias MavRouter.Link.Transport.Form
  alias Aerie.Base.Net.Address
  alias MavRouter.Link.Transport.Net

  @connect_ms 5_000

  @impl MavRouter.Link.Transport
  def traits, do: %{kind: :tcp_client, framing: :stream, protocol: :tcp, client: :remote}

  @impl MavRouter.Link.Transport
  def forms, do: [Form.address("tcp:", "127.0.0.1:5760", "connect, e.g. to a SITL: tcp:127.0.0.1:5760")]

  @impl MavRouter.Link.Transport
  def parse(_prefix, rest), do: Form.parse_address(rest, false)

  @impl MavRouter.Link.Transport
  def open(spec) do
    with {:ok, addresses} <- Net.resolve(spec.host) do
      Enum.reduce_while(addresses, {:error, :nxdomain}, fn address, _last ->
        case Net.connect(address, spec.port, Net.tcp_options(spec), @connect_ms * Net.patience(spec)) do
          {:ok, socket} -> {:halt, {:ok, socket}}
          {:error, reason} -> {:cont, {:error, reason}}
        end
      end)
    end
  end

  @impl MavRouter.Link.Transport
  def give(socket, link), do: :gen_tcp.controlling_process(socket, link)

  @impl MavRouter.Link.Transport
  def activate(socket) do
    with {:ok, {address, port}} <- :inet.peername(socket),
         :ok <- :inet.setopts(socket, active: Net.active()) do
      {:ok, socket, Map.put(Net.local(socket), :peer, Address.format(address, port))}
    end
  end

  @impl MavRouter.Link.Transport
  def handle(socket, {:tcp, socket, bytes}), do: {[{:read, [{:remote, bytes}]}], socket}

  def handle(socket, {:tcp_passive, socket}) do
    # If the socket closed meanwhile, its next message says so.
    _ = :inet.setopts(socket, active: Net.active())
    {[], socket}
  end

  def handle(socket, {:tcp_closed, socket}), do: {[{:closed, :closed}], socket}
  # `:tcp_closed` follows, but without the reason.
  def handle(socket, {:tcp_error, socket, reason}), do: {[{:closed, reason}], socket}
  def handle(_socket, _message), do: :unknown

  @impl MavRouter.Link.Transport
  def write(socket, _peer, bytes) do
    case Net.tcp_write(socket, bytes) do
      :ok -> {:ok, socket}
      :busy -> {:busy, socket}
      {:error, reason} -> {:error, reason, socket}
    end
  end

  @impl MavRouter.Link.Transport
  def close(socket), do: Net.tcp_close(socket)
end
