defmodule SimVehicle.Link.Tcp do
  @moduledoc false
  # Accepting and connecting block, so a linked helper process does them and hands the socket over.

  @behaviour SimVehicle.Link

  @options [:binary, active: false, nodelay: true, send_timeout: 200, send_timeout_close: true]
  @active 100
  @retry_ms 500

  defstruct [:listener, :helper, :socket, :port]

  @impl SimVehicle.Link
  def open(:server, ip, port) do
    with {:ok, listener} <- :gen_tcp.listen(port, [{:ip, ip}, {:reuseaddr, true} | @options]),
         {:ok, port} <- :inet.port(listener) do
      owner = self()

      {:ok,
       %__MODULE__{listener: listener, port: port, helper: spawn_link(fn -> accept(owner, listener) end)}}
    end
  end

  def open(:client, ip, port) do
    owner = self()
    {:ok, %__MODULE__{port: port, helper: spawn_link(fn -> connect(owner, ip, port) end)}}
  end

  @impl SimVehicle.Link
  def handle(%{helper: helper} = link, {:connection, helper, socket}) do
    if link.socket, do: :gen_tcp.close(link.socket)
    activate(socket)
    {:up, %{link | socket: socket}}
  end

  def handle(%{socket: socket} = link, {:tcp, socket, bytes}), do: {:data, bytes, link}

  def handle(%{socket: socket} = link, {:tcp_passive, socket}) do
    activate(socket)
    {:ok, link}
  end

  def handle(%{socket: socket} = link, {:tcp_closed, socket}), do: {:down, lost(link)}
  def handle(%{socket: socket} = link, {:tcp_error, socket, _reason}), do: {:down, lost(link)}
  def handle(link, {closed, _former_socket}) when closed in [:tcp_closed, :tcp_passive], do: {:ok, link}
  def handle(_link, _message), do: :unknown

  @impl SimVehicle.Link
  def send_bytes(%{socket: nil} = link, _bytes), do: {:dropped, link}

  def send_bytes(link, bytes) do
    case :gen_tcp.send(link.socket, bytes) do
      :ok -> {:sent, link}
      {:error, _reason} -> {:dropped, lost(link)}
    end
  end

  @impl SimVehicle.Link
  def port(link), do: link.port

  @impl SimVehicle.Link
  def drop(%{socket: nil} = link), do: link
  def drop(link), do: lost(link)

  @impl SimVehicle.Link
  def close(link) do
    Process.unlink(link.helper)
    Process.exit(link.helper, :kill)
    if link.listener, do: :gen_tcp.close(link.listener)
    if link.socket, do: :gen_tcp.close(link.socket)
    :ok
  end

  # A connection that is over already says so itself, with `:tcp_closed`.
  defp activate(socket) do
    _ = :inet.setopts(socket, active: @active)
    :ok
  end

  # The helper waits until this connection is over before it makes the next.
  defp lost(link) do
    :gen_tcp.close(link.socket)
    send(link.helper, {:over, link.socket})
    %{link | socket: nil}
  end

  defp accept(owner, listener) do
    case :gen_tcp.accept(listener) do
      {:ok, socket} ->
        hand_over(owner, socket)
        accept(owner, listener)

      {:error, _closed} ->
        :ok
    end
  end

  defp connect(owner, ip, port) do
    case :gen_tcp.connect(ip, port, @options, 2_000) do
      {:ok, socket} -> hand_over(owner, socket)
      {:error, _reason} -> :ok
    end

    pause()
    connect(owner, ip, port)
  end

  defp hand_over(owner, socket) do
    :ok = :gen_tcp.controlling_process(socket, owner)
    send(owner, {:connection, self(), socket})

    receive do
      {:over, ^socket} -> :ok
    end
  end

  defp pause do
    receive do
    after
      @retry_ms -> :ok
    end
  end
end
