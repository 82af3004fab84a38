defmodule MavRouter.Link.Transport.NetTest do
  use ExUnit.Case, async: true

  alias MavRouter.Link.Transport.Net
  alias MavRouter.Link.Transport.Net.Backlog

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

  test "in an overload the kernel has room for less, and afterwards for as much as before" do
    {:ok, socket} = Net.udp(@loopback, 0)
    sender = Net.sender(socket)
    bytes = fn -> socket |> :inet.getopts([:recbuf]) |> elem(1) |> Keyword.fetch!(:recbuf) end
    usual = bytes.()
    strained = %{Backlog.new() | strained: 0}

    for {keep, factor} <- [{1, 1}, {512, 2}] do
      :ok = Net.fit(sender, Backlog.new(), %{strained | keep: {keep, 5_000}})
      assert bytes.() == min(factor * 1_024 * 832, usual)
    end

    :ok = Net.fit(sender, strained, Backlog.new())
    assert bytes.() == usual
    Net.udp_close(socket, sender)
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

  test "a receive buffer that the system made smaller is reported, with what to do about it" do
    text = Net.short(2 * 212_992, {:unix, :linux})
    assert text =~ "only 208 KiB of unread datagrams in place of 2048 (about 512 small ones)"
    assert text =~ "sysctl -w net.core.rmem_max=2097152"
    assert Net.short(2 * 2 * 1024 * 1024, {:unix, :linux}) == nil
    assert Net.short(786_896, {:unix, :darwin}) =~ "only 768 KiB"
    assert Net.short(2 * 1024 * 1024, {:unix, :darwin}) == nil

    {:ok, small} = Net.udp(@loopback, 0, recbuf: 8_192)
    assert %{local: "127.0.0.1:" <> _, warning: "the " <> _ = short} = Net.udp_info(small, Net.sender(small))
    assert %{warning: both} = Net.udp_info(small, nil)
    assert both == short <> "; what the kernel drops is not counted: the socket cannot be opened twice"
    :gen_udp.close(small)
    assert Net.short_buffer(small) == nil
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
