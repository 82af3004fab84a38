defmodule Aerie.Fleet.Tracks.ServerTest do
  @moduledoc "The tracks of a gateway: written from the store, read again, with limits, damage, a full disk and kills."
  use Aerie.ClientCase, async: true

  import ExUnit.CaptureLog
  import Aerie.LinkCase, only: [eventually: 1]

  alias Aerie.Base.{Names, Store}
  alias Aerie.Fleet
  alias Aerie.Fleet.Remote
  alias Aerie.Fleet.Tracks.{Block, Core, Files, Metrics, Sample, Server, Settings}

  @moduletag :tmp_dir
  @hour 3_600_000
  @day 24 * @hour
  # A full hour.
  @at 1_699_999_200_000

  defp gateway do
    gateway = make_ref()
    tables = [Files.table(), Remote.Table.table()]
    start_supervised!(Supervisor.child_spec({Store, gateway: gateway, tables: tables}, id: gateway))
    gateway
  end

  defp settings(dir, more \\ %{}) do
    {:ok, settings} = Settings.new(%{"tracks" => Map.merge(%{"dir" => dir}, more)})
    settings
  end

  defp server(gateway, dir, more \\ %{}) do
    options = [gateway: gateway, settings: settings(dir, more), tick_ms: :never]
    start_supervised!(Supervisor.child_spec({Server, options}, id: {Server, gateway}))
  end

  defp tick(pid) do
    send(pid, :tick)
    :sys.get_state(pid)
  end

  defp open(gateway, dir, options \\ []) do
    limits = Keyword.merge([max_bytes: 100_000_000, keep_ms: @day], options)
    {:ok, files, damaged} = Files.open(gateway, dir, limits)
    Metrics.status(gateway, %{dir: dir, bytes: 0, problem: nil})
    {files, damaged}
  end

  # Vehicles that fly, a sample each second, as the server would write them.
  defp fly(files, seconds, names, from \\ @at) do
    {files, _core, early} =
      for second <- seconds, reduce: {files, Core.new(), 0} do
        {files, core, early} ->
          at = from + second * 1000
          samples = for {name, n} <- Enum.with_index(names), do: {name, flying(second, n)}
          core = if Files.full?(files, at), do: elem(Core.handle(core, :not_written), 0), else: core
          {core, [{:write, ^at, begins?, block, _count}]} = Core.handle(core, {:tick, at, samples})
          {:ok, files, more} = Files.write(files, at, begins?, block)
          {files, core, early + more}
      end

    {files, early}
  end

  defp flying(second, n),
    do: %Sample{
      lat: 480_000_000 + second * 900,
      lon: 110_000_000 + n,
      height: 500,
      flags: 3,
      battery: 80,
      mode: "AUTO"
    }

  defp read(gateway, ids, from_s, to_s, step \\ 1, options \\ []) do
    {:ok, answer} =
      Fleet.tracks(gateway, ids, (@at + from_s * 1000) * 1000, (@at + to_s * 1000) * 1000, step, options)

    answer
  end

  defp seconds(samples), do: for(%{at: at} <- samples, do: div(div(at, 1000) - @at, 1000))

  defp only(dir), do: dir |> Path.join("*.tracks") |> Path.wildcard() |> List.last()

  test "what the store has of a vehicle is there again, in the units of people", %{tmp_dir: dir} do
    gateway = gateway()
    server = server(gateway, dir)
    put_vehicle(gateway, vehicle())
    tick(server)
    put_vehicle(gateway, vehicle(%{status: :lost}))
    tick(server)
    now = System.os_time(:microsecond)

    {:ok, %{vehicles: %{"VID-001" => [first, second]}, next: nil}} =
      Fleet.tracks(gateway, :all, now - 60_000_000, now, 1)

    assert %{height: 10.3, heading: 179, speed: 3.2, battery: 0.98, mode: "GUIDED", armed: true, in_air: true} =
             first

    assert_in_delta first.lat, 12.97161234567, 1.0e-7
    assert first.lon == 77.5946 and first.status == :online
    # In whole seconds, which a busy machine lets pass.
    assert first.age in 0..60
    assert second.status == :lost
    assert Store.counter(gateway, {:tracks, :samples}) == 2
    assert %{bytes: bytes, problem: nil} = Metrics.status(gateway)
    assert bytes == File.stat!(only(dir)).size and bytes == Store.counter(gateway, {:tracks, :bytes})
    assert Bitwise.band(File.stat!(only(dir)).mode, 0o777) == 0o600
  end

  test "a vehicle of another gateway, and one of which nothing is known", %{tmp_dir: dir} do
    gateway = gateway()
    server = server(gateway, dir)
    now = System.os_time(:microsecond)
    Remote.Table.configure(gateway, %{stale_us: 5_000_000, lost_us: 10_000_000})
    Remote.Table.put_gateway(gateway, "far", "ridge", %{vehicle() | id: "far"}, now)

    Remote.Table.put(gateway, "far", :position, %{
      at: now,
      time_boot_ms: 1,
      via: "ridge",
      data: %{lat: 1.5, lon: 2.5}
    })

    put_vehicle(gateway, %{vehicle() | id: "dumb", key: {"main", 2}, groups: %{}, last_heard: nil, links: []})
    tick(server)

    {:ok, %{vehicles: found}} = Fleet.tracks(gateway, :all, now - 60_000_000, now + 60_000_000, 1)
    assert [%{lat: 1.5, lon: 2.5}] = found["far"]

    assert [%{lat: nil, height: nil, age: nil, mode: nil, armed: false, in_air: false, battery: nil}] =
             found["dumb"]
  end

  test "a span, a step, some vehicles, and the next page", %{tmp_dir: dir} do
    gateway = gateway()
    {files, 0} = open(gateway, dir)
    {_files, 0} = fly(files, 0..150, ["a", "b"])

    assert %{vehicles: found, next: nil, since: since} = read(gateway, :all, 0, 1000)
    assert since == @at * 1000
    assert seconds(found["a"]) == Enum.to_list(0..150) and seconds(found["b"]) == Enum.to_list(0..150)
    assert List.last(found["a"]).lat == (480_000_000 + 150 * 900) / 1.0e7

    assert %{vehicles: %{"b" => samples} = found} = read(gateway, ["b", "nobody"], 58, 63)
    assert map_size(found) == 1 and seconds(samples) == [58, 59, 60, 61, 62, 63]
    assert read(gateway, ["a"], 3, 25, 10).vehicles["a"] |> seconds() == [3, 10, 20]
    assert read(gateway, ["a"], 0, 1000, 60).vehicles["a"] |> seconds() == [0, 60, 120]
    assert read(gateway, :all, 151, 1000).vehicles == %{}

    assert %{vehicles: %{"a" => a, "b" => b}, next: next} = read(gateway, :all, 0, 1000, 1, limit: 9)
    assert seconds(a) == [0, 1, 2, 3, 4] and seconds(b) == seconds(a) and next == (@at + 5_000) * 1000
  end

  test "a restart goes on in the same file, and what a kill left half written is cut off", %{tmp_dir: dir} do
    gateway = gateway()
    {files, 0} = open(gateway, dir)
    {files, 0} = fly(files, 0..30, ["a"])
    Files.close(files)
    {torn, _group} = Block.encode(Block.new(), @at + 31_000, [{"a", flying(31, 0)}])
    File.write!(only(dir), binary_part(IO.iodata_to_binary(torn), 0, 20), [:append])

    other = gateway()
    {files, 0} = open(other, dir)
    {_files, 0} = fly(files, 40..50, ["a"])
    assert [_one] = Path.wildcard(Path.join(dir, "*.tracks"))
    assert read(other, :all, 0, 100).vehicles["a"] |> seconds() == Enum.to_list(0..30) ++ Enum.to_list(40..50)
  end

  test "damage costs the rest of its file, and while the gateway runs only its minute", %{tmp_dir: dir} do
    gateway = gateway()
    {files, 0} = open(gateway, dir)
    {files, 0} = fly(files, 0..150, ["a"])
    {files, 0} = fly(files, 3600..3610, ["a"])
    Files.close(files)
    [first, _second] = Path.wildcard(Path.join(dir, "*.tracks"))

    [{_key, _path, offset, _bytes}] =
      :ets.lookup(Store.table!(gateway, :tracks), {div(@at, 1000), @at + 60_000})

    {:ok, file} = :file.open(first, [:read, :write, :binary])
    :ok = :file.pwrite(file, offset + 10, <<255, 255, 255>>)
    :ok = :file.close(file)

    kept = Enum.to_list(0..59)
    last = Enum.to_list(3600..3610)
    assert read(gateway, :all, 0, 7000).vehicles["a"] |> seconds() == kept ++ Enum.to_list(120..150) ++ last

    other = gateway()
    {files, 1} = open(other, dir)
    assert read(other, :all, 0, 7000).vehicles["a"] |> seconds() == kept ++ last
    # It is not written any more, though its hour is not over.
    {_files, 0} = fly(files, 3611..3612, ["a"])
    assert File.stat!(first).size > offset
  end

  test "a file that is gone or foreign costs only itself", %{tmp_dir: dir} do
    gateway = gateway()
    File.write!(Path.join(dir, "0000000000000007.tracks"), :binary.copy("nothing of ours", 100))
    File.mkdir_p!(Path.join(dir, "0000000000000008.tracks"))
    {files, 2} = open(gateway, dir)
    {files, 0} = fly(files, 0..10, ["a"])
    Files.close(files)
    assert read(gateway, :all, 0, 100).vehicles["a"] |> length() == 11
    File.rm!(only(dir))
    assert read(gateway, :all, 0, 100).vehicles == %{}
  end

  test "the oldest hours go by age, and before their time when all together are too large", %{tmp_dir: dir} do
    gateway = gateway()
    {files, 0} = open(gateway, dir, keep_ms: 2 * @hour)
    {files, early} = fly(files, for(hour <- 0..5, second <- 0..2, do: hour * 3600 + second), ["a"])
    assert early == 0

    assert read(gateway, :all, 0, 30_000).vehicles["a"]
           |> seconds()
           |> Enum.map(&div(&1, 3600))
           |> Enum.uniq() == [3, 4, 5]

    Files.close(files)

    full = Path.join(dir, "full")
    {files, 0} = open(gateway, full, max_bytes: 40_000)
    {files, early} = fly(files, 0..4000, ["a"])
    assert early > 0 and Files.bytes(files) <= 40_000
    assert length(Path.wildcard(Path.join(full, "*.tracks"))) in 7..9
    %{vehicles: %{"a" => samples}, since: since} = read(gateway, :all, 0, 30_000)
    assert hd(samples).at == since and List.last(samples).at == (@at + 4_000_000) * 1000
  end

  test "a clock that was set back loses nothing", %{tmp_dir: dir} do
    gateway = gateway()
    {files, 0} = open(gateway, dir)
    {files, 0} = fly(files, 0..5, ["a"], @at + 10 * @hour)
    {_files, 0} = fly(files, 0..5, ["a"])
    assert read(gateway, :all, 0, 10).vehicles["a"] |> seconds() == [0, 1, 2, 3, 4, 5]
    assert read(gateway, :all, 36_000, 36_010).vehicles["a"] |> length() == 6
  end

  test "a full disk stops the tracks and says so; when there is room they go on", %{tmp_dir: dir} do
    gateway = gateway()
    now = System.os_time(:second)
    server = server(gateway, dir)
    put_vehicle(gateway, vehicle())
    tick(server)
    %{files: %{store: %{segments: [segment]}}} = :sys.get_state(server)
    # A write to it fails as on a full disk; so does one to each file that could come after it.
    full = Path.join(dir, "full")

    links = [
      full
      | for(n <- 1..120, do: Path.join(dir, String.pad_leading("#{segment.first + n}", 16, "0") <> ".tracks"))
    ]

    Enum.each(links, &File.ln_s!("/dev/full", &1))

    # A file belongs to the process that opens it.
    broken = fn state ->
      {:ok, fd} = :file.open(full, [:read, :write, :raw, :binary])
      put_in(state.files.store.segments, [%{segment | file: fd}])
    end

    :sys.replace_state(server, broken)

    log = capture_log(fn -> for _n <- 1..3, do: tick(server) end)
    assert log |> String.split("no space left on device") |> length() == 2
    assert %{problem: problem} = Metrics.status(gateway)
    assert problem =~ "no space left"
    assert Store.counter(gateway, {:tracks, :lost}) == 3

    Enum.each(links, &File.rm!/1)
    :sys.replace_state(server, &put_in(&1.files.store.segments, [segment]))
    tick(server)
    assert %{problem: nil} = Metrics.status(gateway)
    now = max(now, System.os_time(:second)) * 1_000_000

    assert {:ok, %{vehicles: %{"VID-001" => [_, _]}}} =
             Fleet.tracks(gateway, :all, now - 60_000_000, now + 60_000_000, 1)
  end

  test "a folder that cannot be used is said, and used as soon as it can be", %{tmp_dir: dir} do
    gateway = gateway()
    folder = Path.join(dir, "tracks")
    File.write!(folder, "a file")
    assert capture_log(fn -> server(gateway, folder) |> tick() end) =~ "tracks: cannot make folder"
    File.rm!(folder)
    put_vehicle(gateway, vehicle())
    tick(Names.whereis(gateway, :tracks))
    assert %{problem: nil, bytes: bytes} = Metrics.status(gateway)
    assert bytes > 0

    # Two gateways do not share a folder.
    other = gateway()
    assert capture_log(fn -> server(other, folder) |> tick() end) =~ "in use by another gateway"
    assert %{problem: problem} = Metrics.status(other)
    assert problem =~ "in use"
  end

  test "off: by the setting, and aboard a vehicle unless it is switched on", %{tmp_dir: dir} do
    gateway = gateway()
    options = [gateway: gateway, settings: settings(dir, %{"enabled" => "off"})]
    assert :ignore = Server.start_link(options)
    assert {:error, text} = Fleet.tracks(gateway, :all, 0, 1, 1)
    assert text =~ "tracks.enabled"

    aboard = fn enabled ->
      {:ok, settings} = Settings.new(%{"vehicle_id" => "eagle", "tracks" => %{"enabled" => enabled}})
      Settings.on?(settings)
    end

    refute aboard.("auto")
    assert aboard.("on")
    refute aboard.("off")
    assert Settings.on?(settings(dir))
  end

  test "a killed process goes on, and the death of another one does not matter", %{tmp_dir: dir} do
    gateway = gateway()
    put_vehicle(gateway, vehicle())
    first = server(gateway, dir)
    tick(first)
    ref = Process.monitor(first)
    Process.exit(first, :kill)
    assert_receive {:DOWN, ^ref, _, _, :killed}
    second = eventually(fn -> with pid when pid != first <- Names.whereis(gateway, :tracks), do: pid end)
    tick(second)
    now = System.os_time(:microsecond)
    {:ok, %{vehicles: %{"VID-001" => [_, _]}}} = Fleet.tracks(gateway, :all, now - 60_000_000, now, 1)
  end
end
