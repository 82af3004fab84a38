defmodule Aerie.Link.PortOwnerTest do
  use ExUnit.Case, async: true

  alias Aerie.Link.PortOwner

  @tag :tmp_dir
  test "the program that has a device open, by any of its names", %{tmp_dir: dir} do
    file = Path.join(dir, "device")
    File.write!(file, "")
    File.ln_s!("device", Path.join(dir, "by-id"))
    assert PortOwner.holders(file) == []

    port =
      Port.open({:spawn_executable, System.find_executable("sh")}, [
        :binary,
        args: ["-c", "exec cat 3<\"$1\"", "sh", file]
      ])

    {:os_pid, pid} = Port.info(port, :os_pid)

    Aerie.Patience.eventually(fn ->
      PortOwner.holders(Path.join(dir, "by-id")) == [{"cat", pid}]
    end)

    assert PortOwner.ours?(pid)
    refute PortOwner.ours?(1)
    Port.close(port)
    assert PortOwner.holders("/nowhere") == []
  end

  test "a port's owner is found although sockets come and go meanwhile" do
    {:ok, socket} = :gen_udp.open(0, ip: {127, 0, 0, 1})
    {:ok, port} = :inet.port(socket)
    # More than a page of the kernel's table.
    for _ <- 1..200, do: {:ok, _} = :gen_udp.open(0)

    churn = fn ->
      sockets = for _ <- 1..20, {:ok, socket} <- [:gen_udp.open(0)], do: socket
      Enum.each(sockets, &:gen_udp.close/1)
    end

    for n <- 1..3,
        do: start_supervised!({Task, fn -> churn |> Stream.repeatedly() |> Stream.run() end}, id: n)

    own = String.to_integer(System.pid())
    for _ <- 1..10, do: assert({:ok, _name, ^own} = PortOwner.find(:udp, port))
  end
end
