defmodule Aerie.Base.Net.PortOwnerTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.Net.PortOwner

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

  @tag :tmp_dir
  test "of the programs that have a file open, who has the lock", %{tmp_dir: dir} do
    file = Path.join(dir, "device")
    File.write!(file, "")
    open = &Port.open({:spawn_executable, System.find_executable(&1)}, [:binary, args: &2])
    locks = open.("flock", ["--no-fork", file, "cat"])
    has_open = open.("sh", ["-c", "exec cat 3<\"$1\"", "sh", file])
    [locker, other] = for port <- [locks, has_open], do: port |> Port.info(:os_pid) |> elem(1)

    holders =
      Aerie.Patience.eventually(fn ->
        holders = PortOwner.holders(file)
        Enum.sort(holders) == Enum.sort([{"cat", locker}, {"cat", other}]) and holders
      end)

    Aerie.Patience.eventually(fn -> PortOwner.lockers(file, holders) == [{"cat", locker}] end)
    Port.close(locks)
    Aerie.Patience.eventually(fn -> PortOwner.lockers(file, holders) == [] end)
  end

  test "the owner of a port is found although sockets come and go meanwhile" do
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
