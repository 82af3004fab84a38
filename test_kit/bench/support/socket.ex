defmodule Bench.Socket do
  @moduledoc """
  Connections as clients have them, which benchmarks must not spend much on. It stands alone, because other VMs have
  it as well.
  """

  @options [:binary, active: false, nodelay: true, buffer: 65_536, recbuf: 1_048_576]

  @doc "A connection to a port of this machine, or to a socket of its file system."
  def open({:unix, path}), do: connect({:local, path}, 0)
  def open({:tcp, port}), do: connect({127, 0, 0, 1}, port)

  defp connect(address, port) do
    {:ok, socket} = :gen_tcp.connect(address, port, @options)
    socket
  end

  @doc "A WebSocket: the connection, and what came after the answer's head."
  def upgrade(port, path, headers \\ "") do
    socket = open({:tcp, port})

    :ok =
      :gen_tcp.send(socket, [
        "GET #{path} HTTP/1.1\r\nhost: 127.0.0.1:#{port}\r\nupgrade: websocket\r\nconnection: Upgrade\r\n",
        "sec-websocket-version: 13\r\nsec-websocket-key: dGhlIHNhbXBsZSBub25jZQ==\r\n#{headers}\r\n"
      ])

    {socket, head(socket, "")}
  end

  defp head(socket, got) do
    case String.split(got, "\r\n\r\n", parts: 2) do
      ["HTTP/1.1 101" <> _head, rest] ->
        rest

      _more ->
        {:ok, bytes} = :gen_tcp.recv(socket, 0, 60_000)
        head(socket, got <> bytes)
    end
  end

  @doc "All that comes until the other side closes."
  def all(socket, got \\ "") do
    case :gen_tcp.recv(socket, 0, 60_000) do
      {:ok, bytes} -> all(socket, got <> bytes)
      {:error, _closed} -> :gen_tcp.close(socket) && got
    end
  end
end
