defmodule Aerie.Link.Transport.NetTest do
  use ExUnit.Case, async: true

  alias Aerie.Link.Transport.Net

  @loopback {127, 0, 0, 1}

  test "a UDP socket with a second handle is closed in the middle of its traffic" do
    {:ok, out} = :gen_udp.open(0)

    # If the second handle were closed first, the VM would stand still after some of these.
    for _ <- 1..300 do
      {:ok, socket} = Net.udp(@loopback, 0)
      {:ok, port} = :inet.port(socket)
      :ok = :inet.setopts(socket, active: Net.active())
      sender = Net.sender(socket)
      assert :ok = Net.udp_write(socket, sender, @loopback, port, "hello")
      feeder = Task.async(fn -> feed(out, port) end)
      assert_receive {:udp, ^socket, @loopback, ^port, "hello"}
      assert :ok = Net.udp_close(socket, sender)
      send(feeder.pid, :enough)
      assert :ok = Task.await(feeder, Aerie.Patience.ms())
      assert {:error, _closed} = Net.udp_write(socket, sender, @loopback, port, "hello")
      forget()
    end
  end

  test "a UDP socket with a second handle whose process is killed" do
    {:ok, out} = :gen_udp.open(0)
    test = self()

    for _ <- 1..200 do
      owner = spawn(fn -> own(test) end)
      assert_receive {:port, port}
      feeder = Task.async(fn -> feed(out, port) end)
      assert_receive :heard
      Process.exit(owner, :kill)
      send(feeder.pid, :enough)
      assert :ok = Task.await(feeder, Aerie.Patience.ms())
    end
  end

  # A process that reads and writes a socket.
  defp own(test) do
    {:ok, socket} = Net.udp(@loopback, 0)
    {:ok, port} = :inet.port(socket)
    :ok = :inet.setopts(socket, active: Net.active())
    sender = Net.sender(socket)
    send(test, {:port, port})
    hear(test, socket, sender, port)
  end

  defp hear(test, socket, sender, port) do
    receive do
      {:udp, ^socket, _address, _port, "x"} -> Net.udp_write(socket, sender, @loopback, port, "back")
      {:udp, ^socket, _address, _port, "back"} -> send(test, :heard)
      {:udp_passive, ^socket} -> :inet.setopts(socket, active: Net.active())
    end

    hear(test, socket, sender, port)
  end

  defp feed(out, port) do
    _ = :gen_udp.send(out, @loopback, port, "x")

    receive do
      :enough -> :ok
    after
      0 -> feed(out, port)
    end
  end

  defp forget do
    receive do
      {:udp, _socket, _address, _port, _bytes} -> forget()
      {:udp_passive, _socket} -> forget()
    after
      0 -> :ok
    end
  end
end
