defmodule MavRouter.Link.Transport.SerialTest do
  use ExUnit.Case, async: true
  use Aerie.LinkCase

  alias MavRouter.Link
  alias Aerie.Base.Names
  alias Aerie.PythonPeer

  @moduletag :python
  @patience Aerie.Patience.ms()

  setup do
    gateway = start_parts()
    be_session(gateway, 1)
    pty = PythonPeer.start("pty_peer.py", [], packet: 2)
    {:ok, gateway: gateway, pty: pty, device: await(pty, ?n)}
  end

  defp await(pty, letter) do
    receive do
      {^pty, {:data, <<^letter, rest::binary>>}} -> rest
    after
      @patience -> flunk("the cable's other end did not say #{<<letter>>}")
    end
  end

  defp write(pty, bytes), do: Port.command(pty, ["w", bytes])
  defp up(c, id), do: eventually(fn -> snapshot(c.gateway, id).status in [:up, :idle] end)

  test "frames both ways, cut anywhere, behind boot text", c do
    {id, _} = add_link(c.gateway, "#{c.device},57600")
    up(c, id)
    <<a::binary-size(9), b::binary>> = attitude(1, 1) <> attitude(1, 2)

    pieces =
      for piece <- ["Init ArduCopter V4.6.3\r\n" <> a, b],
          do: {byte_size(piece), fn -> write(c.pty, piece) end}

    in_pieces(c.gateway, id, pieces)
    assert [1, 2] = Enum.map(frames(2), &number/1)
    assert :ok = MavRouter.Router.send(c.gateway, {"main", 1}, "to the vehicle")
    assert await(c.pty, ?d) == "to the vehicle"

    assert %{local: device, text: "connected to " <> device, counters: %{resync_bytes: 24}} =
             snapshot(c.gateway, id)

    assert device == c.device
  end

  test "a pulled cable is reported, and found again when it is back", c do
    listen(c.gateway, [:up, :down])
    link = Path.join(System.tmp_dir!(), "aerie-serial-#{System.unique_integer([:positive])}")
    File.ln_s!(c.device, link)
    on_exit(fn -> File.rm(link) end)
    {id, _} = add_link(c.gateway, link)
    assert_receive {:up, _, _}, @patience
    # The name goes with it: its number may be another terminal's at once.
    File.rm!(link)
    Port.command(c.pty, "x")
    assert_receive {:down, _, %{reason: reason}}, @patience
    assert reason == "#{link} was unplugged"

    # It comes back as another device node, to which the name points.
    Port.command(c.pty, "o")
    File.ln_s!(await(c.pty, ?n), link)
    assert_receive {:up, %{reconnects: 1}, _}, @patience
    write(c.pty, attitude(1, 3))
    assert [3] = Enum.map(frames(1), &number/1)
    assert snapshot(c.gateway, id).counters.reconnects == 1
  end

  test "a device that does not exist, and one that is not a serial port", c do
    {none, _} = add_link(c.gateway, "/dev/ttyNOWHERE7")
    {file, _} = add_link(c.gateway, "/etc/hostname")
    eventually(fn -> Link.get(c.gateway, none).reason == "there is no /dev/ttyNOWHERE7" end)
    eventually(fn -> (Link.get(c.gateway, file).reason || "") =~ "not a serial port" end)
  end

  @tag :capture_log
  test "a killed link frees its port and opens it again", c do
    {id, _} = add_link(c.gateway, c.device)
    up(c, id)

    for n <- 1..10 do
      Process.exit(Names.whereis(c.gateway, :link, id), :kill)

      eventually(fn ->
        match?(%{status: up, counters: %{restarts: ^n}} when up in [:up, :idle], snapshot(c.gateway, id))
      end)
    end

    write(c.pty, attitude(1, 1))
    frames(1)
    # Writes that exceed the line's rate are bounded and counted.
    MavRouter.Router.send(c.gateway, {"main", 1}, :binary.copy("x", 9000))
    for _ <- 1..100, do: MavRouter.Router.send(c.gateway, {"main", 1}, :binary.copy("x", 9000))
    eventually(fn -> snapshot(c.gateway, id).counters.dropped_out > 0 end)
  end
end
