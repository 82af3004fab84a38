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

    Aerie.GatewayCase.eventually(fn ->
      PortOwner.holders(Path.join(dir, "by-id")) == [{"cat", pid}]
    end)

    assert PortOwner.ours?(pid)
    refute PortOwner.ours?(1)
    Port.close(port)
    assert PortOwner.holders("/nowhere") == []
  end
end
