defmodule Aerie.Vehicle.CableTest do
  # Counts what the whole node has, so nothing else may run meanwhile.
  use ExUnit.Case, async: false
  use Aerie.VehicleCase

  alias Aerie.Base.Store
  alias MavRouter.Link
  alias Aerie.Base.Names
  alias Aerie.SerialPeer

  @moduletag :pty
  @patience Aerie.Patience.ms()

  setup do
    gateway = start_parts()
    dev = Path.join(System.tmp_dir!(), "aerie-cable-#{System.unique_integer([:positive])}")
    File.mkdir_p!(dev)
    on_exit(fn -> File.rm_rf(dev) end)
    listen(gateway, [:up, :down])
    {:ok, gateway: gateway, dev: dev}
  end

  # A vehicle that sends all the time, by USB, and is another device every other time.
  defp vehicle(c, options \\ []) do
    says = fn turn -> heartbeat(1) <> attitude(1, turn) end
    SerialPeer.start([baud: :any, every: 20, says: says, name_in: {c.dev, "ttyACM0"}, to: self()] ++ options)
  end

  defp pull_and_put_back(c, vehicle, n) do
    SerialPeer.unplug(vehicle)
    assert_receive {:down, _, _}, @patience
    SerialPeer.plug_in(vehicle, name_in: {c.dev, "ttyACM#{rem(n, 2)}"})
    assert_receive {:up, _, _}, @patience
    drop_messages()
  end

  defp drop_messages do
    receive do
      {letter, _, _} when letter in [:down, :heard] -> drop_messages()
    after
      0 -> :ok
    end
  end

  defp usage do
    %{
      files: length(File.ls!("/proc/#{System.pid()}/fd")),
      ports: length(Port.list()),
      processes: length(Process.list()),
      programs: length(Aerie.Programs.running())
    }
  end

  # A module that is loaded when it is needed brings its atoms.
  defp load_all do
    for app <- [
          :vehicle,
          :mav_router,
          :base,
          :mav_codec,
          :circuits_uart,
          :telemetry,
          :logger,
          :elixir,
          :ex_unit
        ],
        module <- Application.spec(app, :modules) do
      Code.ensure_loaded!(module)
    end
  end

  defp cable_test(c, times) do
    load_all()
    vehicle = vehicle(c)
    {id, _} = add_link(c.gateway, "serial:auto", options: [serial_dev: c.dev])
    assert_receive {:up, _, _}, @patience
    session = Aerie.Patience.eventually(fn -> Names.whereis(c.gateway, :session, {"main", 1}) end)
    # Until everything has happened once.
    for n <- 1..3, do: pull_and_put_back(c, vehicle, n)
    heard = fn -> Link.snapshot(c.gateway, id).counters.messages[30] end
    before = usage()
    atoms = :erlang.system_info(:atom_count)
    link = Names.whereis(c.gateway, :link, id)
    memory = memory(link)

    for n <- 1..times do
      count = heard.()
      pull_and_put_back(c, vehicle, n + 3)
      Aerie.Patience.eventually(fn -> heard.() > count end)
      # To the vehicle as well: what is under way when the cable goes is lost, and nothing else.
      :ok = Link.send_bytes(c.gateway, id, attitude(1, n))
    end

    assert :erlang.system_info(:atom_count) == atoms
    Aerie.Patience.eventually(fn -> Enum.all?(usage(), fn {what, n} -> n <= before[what] end) end)
    assert memory(link) < memory + 2_000_000
    # The link and the vehicle are who they were; who watches the vehicle saw a gap and no more.
    assert Names.whereis(c.gateway, :link, id) == link
    assert Names.whereis(c.gateway, :session, {"main", 1}) == session
    assert Link.snapshot(c.gateway, id).counters.reconnects == times + 3
    assert %{status: :online} = Aerie.Patience.eventually(fn -> online(c.gateway) end)
  end

  defp online(gateway), do: Enum.find(Store.vehicles(gateway), &(&1.status == :online))

  defp memory(pid) do
    :erlang.garbage_collect(pid)
    {:memory, bytes} = Process.info(pid, :memory)
    bytes
  end

  test("a cable pulled and put back 10 times under traffic leaks nothing", c, do: cable_test(c, 10))

  @tag :long
  test("a cable pulled and put back 200 times under traffic leaks nothing", c, do: cable_test(c, 200))

  test "streams are asked for again when the cable is back", c do
    vehicle = vehicle(c)
    {_id, _} = add_link(c.gateway, "serial:auto", options: [serial_dev: c.dev])
    assert_receive {:up, _, _}, @patience
    asked()
    pull_and_put_back(c, vehicle, 1)
    asked()
  end

  # SET_MESSAGE_INTERVAL has come to the vehicle.
  defp asked(parser \\ MavCodec.Parser.new()) do
    assert_receive {:heard, _, bytes}, @patience
    {frames, parser} = MavCodec.Parser.push(parser, bytes)
    unless Enum.any?(frames, &interval?/1), do: asked(parser)
  end

  defp interval?(frame),
    do: match?({:ok, %MavCodec.Messages.CommandLong{command: 511}}, MavCodec.decode(frame))
end
