defmodule MavRouter.Link.Serial.AutoTest do
  use ExUnit.Case, async: true
  use Aerie.LinkCase

  alias MavCodec.Test.BaudModel
  alias MavRouter.Link
  alias Aerie.SerialPeer

  @moduletag :pty
  @patience Aerie.Patience.ms()

  setup do
    gateway = start_parts()
    be_session(gateway, 1)
    dev = Path.join(System.tmp_dir!(), "aerie-dev-#{System.unique_integer([:positive])}")
    File.mkdir_p!(dev)
    on_exit(fn -> File.rm_rf(dev) end)
    listen(gateway, [:up, :down, :garbled])
    {:ok, gateway: gateway, dev: dev}
  end

  # A vehicle: an attitude ten times a second, a heartbeat every second.
  defp vehicle(options) do
    says = fn turn ->
      if rem(turn, 10) == 0, do: heartbeat(1) <> attitude(1, turn), else: attitude(1, turn)
    end

    SerialPeer.start([every: 100, says: says] ++ options)
  end

  # Only where a test is about them are times shorter than in real life: a busy machine makes pauses of a second.
  defp auto(c, text \\ "serial:auto", times \\ []) do
    {id, _} = add_link(c.gateway, text, options: [serial_dev: c.dev] ++ times)
    id
  end

  defp up(_c), do: assert_receive({:up, _, _}, @patience)

  test "finds the port with a vehicle among silent, noisy and other ones, at its baud rate", c do
    _silent = SerialPeer.start(name_in: {c.dev, "ttyACM0"})

    _gps =
      SerialPeer.start(
        baud: 9_600,
        every: 200,
        says: fn _ -> "$GPGLL,5057.970,N,00146.110,E,142451,A*27\r\n" end,
        name_in: {c.dev, "ttyUSB0"}
      )

    vehicle = vehicle(baud: 921_600, name_in: {c.dev, "ttyUSB1"}, to: self())
    id = auto(c)
    up(c)
    port = Path.join(c.dev, "ttyUSB1")

    assert %{status: :up, local: ^port, baud: 921_600, finding: finding, text: text} =
             snapshot(c.gateway, id)

    assert %{condition: :vehicle, protocol: :mavlink2, evidence: "" <> _} = finding
    assert text == "connected to #{port} at 921600 baud"

    # What was received during the search is not lost, and there is no gap.
    numbers = Enum.map(attitudes(20), &number/1)
    assert numbers == Enum.to_list(hd(numbers)..(hd(numbers) + 19))
    # Nothing was written to any port until now.
    refute_received {:heard, _, _}
    assert :ok = MavRouter.Router.send(c.gateway, {"main", 1}, "to the vehicle")
    assert_receive {:heard, ^vehicle, "to the vehicle"}, @patience
  end

  defp attitudes(n, got \\ []) do
    got = got ++ Enum.filter(frames(1), &(&1.id == 30))
    if length(got) >= n, do: Enum.take(got, n), else: attitudes(n, got)
  end

  test "serial:DEVICE finds the baud rate", c do
    vehicle = vehicle(baud: 230_400)
    id = auto(c, "serial:#{SerialPeer.path(vehicle)}")
    up(c)
    assert %{baud: 230_400} = snapshot(c.gateway, id)
  end

  test "no port, then one: it is noticed", c do
    id = auto(c)
    assert_receive {:down, _, %{reason: "no serial port found" <> _}}, @patience
    assert_receive {:down, %{retry_ms: 5_000}, _}, @patience
    vehicle(name_in: {c.dev, "ttyACM0"})
    up(c)
    assert %{status: :up, diagnosis: []} = snapshot(c.gateway, id)
  end

  test "a port with another protocol: named, with what to do", c do
    SerialPeer.start(every: 100, says: fn _ -> "$M>\x03\x01\x00\x01.-" end, name_in: {c.dev, "ttyUSB0"})
    id = auto(c)

    # A search in which it said nothing in time is followed by the next.
    found =
      eventually(fn ->
        with %{reason: "" <> reason} = link <- Link.get(c.gateway, id),
             true <- reason =~ "MSP v1 at 57600 baud",
             do: link,
             else: (_not_yet -> nil)
      end)

    assert found.reason =~ "its connection string is msp:auto or msp:DEVICE,BAUD"
    assert [%{condition: :other_protocol, protocol: :msp1, baud: 57_600}] = found.diagnosis
  end

  test "pulled and back as another device: found again, beginning with what was known", c do
    vehicle = vehicle(baud: 460_800, name_in: {c.dev, "ttyUSB0"})
    id = auto(c)
    up(c)
    frames(5)
    unplugged = Path.join(c.dev, "ttyUSB0") <> " was unplugged"
    SerialPeer.unplug(vehicle)
    assert_receive {:down, _, %{reason: ^unplugged}}, @patience
    other = SerialPeer.plug_in(vehicle, name_in: {c.dev, "ttyUSB1"})
    assert File.read_link!(Path.join(c.dev, "ttyUSB1")) == other
    assert_receive {:up, %{reconnects: times}, _} when times > 0, @patience
    assert snapshot(c.gateway, id).local == Path.join(c.dev, "ttyUSB1")
    frames(5)
  end

  test "the baud rate changes: the port is searched for again", c do
    vehicle = vehicle(baud: 57_600, name_in: {c.dev, "ttyUSB0"})
    id = auto(c, "serial:auto", garbled_ms: 1_000)
    up(c)
    SerialPeer.change(vehicle, baud: 115_200)
    assert_receive {:down, _, %{reason: "no more MAVLink on " <> what}}, @patience
    assert what =~ "no known protocol"
    assert_receive {:up, _, _}, @patience
    assert snapshot(c.gateway, id).baud == 115_200
  end

  test "a wrong configured baud rate: the port stays open, and the diagnosis says so", c do
    vehicle = vehicle(baud: 57_600)
    {id, _} = add_link(c.gateway, "#{SerialPeer.path(vehicle)},115200", options: [garbled_ms: 1_000])
    up(c)
    assert_receive {:garbled, _, %{finding: %{condition: :noise, baud: 115_200}}}, @patience
    # It is gone while nothing comes for a second, and found again.
    eventually(fn ->
      match?(
        %{diagnosis: [%{condition: :noise}], text: "connected, but no MAVLink on " <> _},
        snapshot(c.gateway, id)
      )
    end)

    SerialPeer.change(vehicle, baud: 115_200)
    eventually(fn -> match?(%{diagnosis: [], status: :up}, snapshot(c.gateway, id)) end)
  end

  test "alternating garbage and good frames: no good frame is lost", c do
    vehicle = vehicle(baud: :any, name_in: {c.dev, "ttyACM0"})
    id = auto(c)
    up(c)

    for n <- 1..20 do
      SerialPeer.say(vehicle, BaudModel.receive(attitude(1, n), 57_600, 115_200))
      SerialPeer.say(vehicle, attitude(1, 1000 + n))
    end

    wanted = Enum.map(1..20, &(1000 + &1))
    got = 1020 |> attitudes_until() |> Enum.filter(&(&1 > 1000))
    assert got == wanted
    assert snapshot(c.gateway, id).status == :up
  end

  defp attitudes_until(last, got \\ []) do
    got = got ++ for(%{id: 30} = frame <- frames(1), do: number(frame))
    if last in got, do: got, else: attitudes_until(last, got)
  end

  test "a flood, of noise and of frames: bounded, and no frame is lost", c do
    vehicle = vehicle(baud: :any, name_in: {c.dev, "ttyACM0"})
    id = auto(c)
    up(c)
    link = Aerie.Base.Names.whereis(c.gateway, :link, id)
    SerialPeer.change(vehicle, every: nil)
    pieces = for n <- 1..400, do: attitude(1, 10_000 + n)
    noise = :binary.copy(<<1, 0xFD, 3, 4>>, 20)
    before = snapshot(c.gateway, id).counters
    flood = for _ <- 1..20, piece <- pieces, into: "", do: noise <> piece
    # The reading process is suspended, as on a busy machine; bytes wait in the kernel and at the sender.
    :erlang.suspend_process(link)
    SerialPeer.say(vehicle, flood)
    :erlang.resume_process(link)

    eventually(fn ->
      {:message_queue_len, waiting} = Process.info(link, :message_queue_len)
      assert waiting < 2_000
      snapshot(c.gateway, id).counters.frames_in - before.frames_in >= 8_000
    end)

    assert snapshot(c.gateway, id).counters.frames_in - before.frames_in >= 8_000
  end

  test "a half-open line: a device that exists but has fallen silent", c do
    vehicle = vehicle(name_in: {c.dev, "ttyUSB0"})
    id = auto(c, "serial:auto", silent_ms: 1_000)
    up(c)
    SerialPeer.change(vehicle, every: nil)
    assert_receive {:down, _, %{reason: "nothing heard from " <> _}}, @patience
    assert_receive {:down, _, %{reason: "no vehicle heard: " <> silent}}, @patience
    assert silent =~ "nothing in"
    SerialPeer.change(vehicle, every: 100)
    up(c)
    eventually(fn -> snapshot(c.gateway, id).status == :up end)
  end

  test "two links that search do not take each other's ports", c do
    vehicle(name_in: {c.dev, "ttyUSB0"})
    vehicle(name_in: {c.dev, "ttyUSB1"})
    a = auto(c, "serial:auto?id=a")
    b = auto(c, "serial:auto?id=b&network=other")
    up(c)
    up(c)
    ports = for id <- [a, b], do: Path.basename(snapshot(c.gateway, id).local)
    assert Enum.sort(ports) == ["ttyUSB0", "ttyUSB1"]
  end

  # On a busy machine a search may end before the port could be looked at; the next one follows.
  defp why_down(id) do
    assert_receive {:down, _, %{link: ^id, reason: reason}}, @patience
    if reason =~ ~r/opening \S+ takes too long/, do: why_down(id), else: reason
  end

  @locker "import fcntl, os, sys; fd = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY); " <>
            "fcntl.flock(fd, fcntl.LOCK_EX); print('locked', flush=True); sys.stdin.read()"

  @tag :python
  test "a port that another program has locked: named, with a fixed rate and with a search", c do
    vehicle = vehicle(name_in: {c.dev, "ttyACM0"})
    device = SerialPeer.path(vehicle)

    program =
      Port.open({:spawn_executable, Aerie.PythonPeer.python()}, [:binary, args: ["-c", @locker, device]])

    assert_receive {^program, {:data, "locked" <> _}}, @patience
    {:os_pid, pid} = Port.info(program, :os_pid)
    {fixed, _} = add_link(c.gateway, "#{device},57600")
    assert why_down(fixed) =~ ~r/^#{device} is in use by .*python\S* \(process #{pid}\)/
    Link.stop(c.gateway, fixed)

    assert c |> auto() |> why_down() =~
             ~r/ttyACM0: in use by .*python\S* \(process #{pid}\).* \(end what has it open/

    Port.close(program)
    up(c)
  end

  test "a device that another program has open without a lock is left alone, with a fixed rate as well", c do
    # Not a PTY, because its creator has it open; nor a serial port, which is not even checked.
    file = Path.join(c.dev, "device")
    File.write!(file, "")
    shell = System.find_executable("sh")
    program = Port.open({:spawn_executable, shell}, [:binary, args: ["-c", "exec cat 3<\"$1\"", "sh", file]])
    {:os_pid, pid} = Port.info(program, :os_pid)
    eventually(fn -> Aerie.Base.Net.PortOwner.holders(file) == [{"cat", pid}] end)
    {fixed, _} = add_link(c.gateway, "#{file},57600")
    eventually(fn -> Link.get(c.gateway, fixed).reason == "#{file} is in use by cat (process #{pid})" end)
  end

  test "a port of another link is reported as such", c do
    vehicle = vehicle(name_in: {c.dev, "ttyACM0"})
    {_first, _} = add_link(c.gateway, "#{SerialPeer.path(vehicle)},57600")
    up(c)
    {again, _} = add_link(c.gateway, "#{c.dev}/ttyACM0,57600")
    assert why_down(again) == "#{c.dev}/ttyACM0 is in use by another link"
    Link.stop(c.gateway, again)
    assert c |> auto() |> why_down() == "no vehicle heard: #{c.dev}/ttyACM0: belongs to another link"
  end

  test "a link that is stopped during its search leaves nothing behind", c do
    before = Circuits.UART.find_pids() |> Enum.map(&elem(&1, 0))
    silent = SerialPeer.start(name_in: {c.dev, "ttyUSB0"})
    id = auto(c)
    eventually(fn -> Enum.any?(Circuits.UART.find_pids(), &(elem(&1, 1) == Path.join(c.dev, "ttyUSB0"))) end)
    Link.stop(c.gateway, id)

    eventually(fn ->
      not Enum.any?(Circuits.UART.find_pids(), &(elem(&1, 1) == Path.join(c.dev, "ttyUSB0")))
    end)

    assert SerialPeer.path(silent) && is_list(before)
  end
end
