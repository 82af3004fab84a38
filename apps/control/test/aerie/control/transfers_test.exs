defmodule Aerie.Control.TransfersTest do
  @moduledoc "Parameters and plans of simulated vehicles through a gateway, with frames lost in both directions."
  use Aerie.TransferCase, async: true

  alias Aerie.Base.Names
  alias Aerie.Control.{Commands, Files, Logs, Missions, Params}
  alias Aerie.CommandCase
  alias Protocols.Mission.{Item, Plan}

  @moduletag :tmp_dir
  @moduletag :capture_log

  @viewer %{name: "eve", role: :viewer, permissions: []}

  defp plan(count, height \\ 20.0) do
    items =
      for n <- 1..count//1 do
        place = %{x: -353_632_610 + 100 * n, y: 1_491_652_300, z: height}
        struct!(%Item{command: if(n == 1, do: 22, else: 16), frame: 3, params: {0.0, 0.0, 0.0, nil}}, place)
      end

    %Plan{items: items, rally: [{{-353_632_000, 1_491_652_000}, 30.0}]}
  end

  # With such a loss one request in a great many goes unanswered for all its repetitions: then it is asked again.
  defp answered(ask) do
    eventually(fn ->
      answer = ask.()
      not match?({_kind, %Result{status: :timeout}}, answer) && answer
    end)
  end

  for firmware <- [:ardupilot, :px4] do
    test "#{firmware}: parameters are listed, read, set and compared", %{tmp_dir: dir} do
      {gateway, port} = start(dir)
      sim = fly(gateway, port, firmware: unquote(firmware), loss: 0.05, duplicate: 0.05)
      assert {:ok, table} = Params.list(gateway, "VID-001", progress: {self(), :list})
      assert map_size(table.params) > 150
      assert_received {:command_progress, :list, _id, %{"phase" => "reading", "progress" => _share}}
      # It is known later whether the list is still right: then it is not read again.
      assert table.hash || table.file_crc
      snapshot = Store.vehicle(gateway, "VID-001")
      marked = put_in(table.params["MARKED"], %Params.Param{name: "MARKED", value: 1, type: 6})
      marked = %{marked | order: marked.order ++ ["MARKED"]}
      Params.Cache.Writer.keep(gateway, snapshot, marked)
      eventually(fn -> Params.Cache.Writer.stored(gateway, snapshot) == marked end)
      assert {:ok, ^marked} = Params.list(gateway, "VID-001")
      assert {:ok, ^table} = Params.list(gateway, "VID-001", refresh: true)

      {name, value} =
        if unquote(firmware) == :px4, do: {"MIS_TAKEOFF_ALT", 7.5}, else: {"PILOT_TKOFF_ALT", 150}

      assert {:ok, %Result{status: :completed, details: %{"name" => ^name}}} =
               Params.set(gateway, "VID-001", name, value)

      assert {:ok, %{value: shown}} = Params.get(gateway, "VID-001", name)
      assert shown == value
      assert {:ok, now} = Params.list(gateway, "VID-001")
      assert [^name] = for({name, param} <- now.params, param.value != table.params[name].value, do: name)

      # Neither firmware answers for a parameter that it does not have; the list is known.
      assert {:error, [%{key: "NO_SUCH"}]} = Params.set(gateway, "VID-001", "NO_SUCH", 1)

      assert {:error, [%{key: "NO_SUCH"}, %{key: "NOR_THIS"}]} =
               Params.set_all(gateway, "VID-001", for(n <- ["NO_SUCH", name, "NOR_THIS"], do: {n, 9}))

      assert {:ok, %{value: ^shown}} = Params.get(gateway, "VID-001", name)

      # What was saved before is loaded again.
      old = table.params[name].value
      text = Params.File.format(table, :params, {1, 1})

      assert {:ok, %Result{status: :completed, details: %{"set" => 1}}} =
               Params.load(gateway, "VID-001", text)

      assert {:ok, %{value: ^old}} = Params.get(gateway, "VID-001", name)
      assert Process.alive?(sim)
    end

    test "#{firmware}: a camera's own parameters, with a quarter of the frames lost (P8)", %{tmp_dir: dir} do
      {gateway, port} = start(dir)
      fly(gateway, port, firmware: unquote(firmware), camera: 100, loss: 0.25)
      camera = [component: 100]
      assert {:ok, table} = answered(fn -> Params.list(gateway, "VID-001", camera) end)
      assert Enum.map(table.order, &{&1, table.params[&1].type}) == SimVehicle.Vehicle.Camera.params()
      assert %{value: 0xFFFF_FFFF_FFFF_FFFF} = table.params["CAM_FREE"]

      eventually(fn ->
        assert {:ok, %Result{status: status, details: details}} =
                 answered(fn -> Params.set(gateway, "VID-001", "CAM_NAME", "Front", camera) end)

        assert status in [:completed, :accepted]
        status == :completed and match?(%{"name" => "CAM_NAME", "value" => "Front"}, details)
      end)

      # It works on this for three seconds. On a busy machine the time for showing it may be over before it is shown.
      eventually(fn ->
        assert {:ok, %Result{status: status}} =
                 answered(fn -> Params.set(gateway, "VID-001", "CAM_FORMAT", 513, camera) end)

        assert status in [:completed, :accepted]
        status == :completed
      end)

      assert {:ok, %{value: 513, type: 3}} =
               answered(fn -> Params.get(gateway, "VID-001", "CAM_FORMAT", camera) end)

      assert {:ok, %Result{status: :rejected, reason: "the component does not support this value" <> _}} =
               answered(fn -> Params.set(gateway, "VID-001", "CAM_MODE", 3, camera) end)

      assert {:ok, %Result{status: :denied, details: %{"rule" => "role"}}} =
               Params.set(gateway, "VID-001", "CAM_MODE", 2, [as: @viewer] ++ camera)

      # The autopilot has parameters of its own, also if it is named.
      assert {:error, %Result{status: :timeout}} =
               Params.get(gateway, "VID-001", "CAM_MODE", timeout_ms: 3_000)

      name = if unquote(firmware) == :px4, do: "MIS_TAKEOFF_ALT", else: "PILOT_TKOFF_ALT"

      assert {:ok, %{name: ^name}} =
               answered(fn -> Params.get(gateway, "VID-001", name, component: 1) end)

      assert {:ok, %Result{status: :rejected}} = Params.set(gateway, "VID-001", name, "high", component: 1)
    end

    test "#{firmware}: a mission and rally points are sent, read back, verified and cleared", %{tmp_dir: dir} do
      {gateway, port} = start(dir)
      fly(gateway, port, firmware: unquote(firmware), loss: 0.05, duplicate: 0.05)
      plan = plan(12)

      assert {:ok, %Result{status: status, details: %{"on_board" => "new"}}} =
               Missions.upload(gateway, "VID-001", :mission, plan, id: "m1", progress: {self(), :up})

      # Whether it can be flown PX4 says within a second or so; for a busy machine that may be too late.
      assert status in if(unquote(firmware) == :px4, do: [:completed, :accepted], else: [:completed])
      assert_received {:command_progress, :up, "m1", %{"phase" => "sending"}}
      assert {:ok, %Result{status: ^status}} = Commands.state(gateway, "VID-001", "m1")
      assert {:ok, %Result{status: :completed}} = Missions.upload(gateway, "VID-001", :rally, plan)
      assert {:ok, %{plan: %{items: [_, _ | _] = items}}} = Missions.download(gateway, "VID-001", :mission)
      assert Enum.map(items, & &1.x) == Enum.map(plan.items, & &1.x)
      assert {:ok, :same} = Missions.verify(gateway, "VID-001", :mission, plan)
      assert {:ok, {:differs, _seq, _how}} = Missions.verify(gateway, "VID-001", :mission, plan(11))
      assert {:ok, %{items: [_ | _], rally: rally, fence: []}} = Missions.download_all(gateway, "VID-001")
      assert rally == plan.rally
      assert {:ok, %Result{status: :completed}} = Missions.clear(gateway, "VID-001", :mission)
      assert {:ok, %{plan: %{items: []}}} = Missions.download(gateway, "VID-001", :mission)
    end
  end

  @plans Path.expand("../../../../vehicle/test/fixtures/plans", __DIR__)

  test "plans as ground stations write them are completed and the same, under a policy", %{tmp_dir: dir} do
    {gateway, port} = start(dir, %{max_altitude: 100})
    fly(gateway, port, firmware: :ardupilot)

    for name <- Enum.sort(File.ls!(@plans)) do
      format = if Path.extname(name) == ".plan", do: :plan, else: :waypoints
      {:ok, plan} = @plans |> Path.join(name) |> File.read!() |> Missions.import(format)
      assert {:ok, %Result{} = result} = Missions.upload(gateway, "VID-001", :mission, plan)

      assert %{status: :completed, details: %{"on_board" => "new", "mismatch" => nil, "remarks" => remarks}} =
               result,
             name

      assert is_list(remarks) and Enum.all?(remarks, &is_binary/1)
      assert {:ok, :same} = Missions.verify(gateway, "VID-001", :mission, plan), name
    end
  end

  test "what a plan file has no place for is named, and the same aboard when it is sent back", %{tmp_dir: dir} do
    {gateway, port} = start(dir)
    fly(gateway, port, firmware: :ardupilot)
    around_home = %Item{command: 5005, frame: 0, params: {300.0, 0.0, 0.0, 0.0}}
    zone = {:exclusion, {:circle, {-353_600_000, 1_491_600_000}, 25.0}}
    [place, other, third] = for n <- 1..3, do: {-353_632_000 + n, 1_491_652_000}
    rally = [{place, {560.0, 0}}, {other, 40.0}, {third, {30.0, 10}}]
    plan = %Plan{fence: [zone], fence_others: [around_home], rally: rally}

    for {kind, n} <- [fence: 1, rally: 2] do
      assert {:ok, %Result{status: :completed}} = Missions.upload(gateway, "VID-001", kind, plan)
      assert {:ok, stored} = Missions.download(gateway, "VID-001", kind)
      assert %{remarks: remarks, plan: file} = Missions.plain(stored, kind)
      assert length(remarks) == n
      {:ok, read} = file |> JSON.encode!() |> Missions.import(:plan)
      assert read == stored.plan
      assert {:ok, %Result{status: :completed}} = Missions.upload(gateway, "VID-001", kind, read)
      assert {:ok, ^stored} = Missions.download(gateway, "VID-001", kind)
    end

    assert {:ok, %{rally: ^rally, fence: [^zone], fence_others: [_]}} =
             Missions.download_all(gateway, "VID-001")

    assert {:ok, %Result{status: :completed, details: %{"removed" => removed}}} =
             Missions.clear(gateway, "VID-001", :fence)

    assert removed == "1 circle and 1 other item"
  end

  test "a place without a height is refused before anything is sent, by whichever file or firmware", %{
    tmp_dir: dir
  } do
    {gateway, port} = start(dir)
    for {firmware, n} <- [ardupilot: 1, px4: 2], do: fly(gateway, port, firmware: firmware, system: n)
    file = File.read!(Path.join(@plans, "../heightless/terrain-null.plan"))
    {:ok, from_plan} = Missions.import(file, :plan)
    line = "1\t0\t3\t16\t0\t0\t0\t0\t47.1\t8.5\tnan\t1\n"

    {:ok, from_waypoints} =
      Missions.import("QGC WPL 110\n0\t1\t0\t16\t0\t0\t0\t0\t47\t8\t500\t1\n" <> line, :any)

    for {plan, number} <- [{from_plan, 2}, {from_waypoints, 1}], vehicle <- ["VID-001", "VID-002"] do
      assert {:error, [error]} = Missions.upload(gateway, vehicle, :mission, plan)
      assert Exception.message(error) =~ "mission: expected a height in item #{number} (NAV_WAYPOINT)"
      assert {:ok, %{items: []}} = Missions.download(gateway, vehicle, :mission)
    end

    beside = %Plan{rally_others: [%Item{command: 5100, frame: 3, x: 1, y: 1, z: nil}]}
    assert {:error, [%{key: "rally"}]} = Missions.upload(gateway, "VID-001", :rally, beside)
  end

  test "a component without parameters, and what is not a component", %{tmp_dir: dir} do
    {gateway, port} = start(dir)
    fly(gateway, port, firmware: :px4)

    assert {:error, %Result{status: :timeout, reason: "component 154 does not answer" <> _}} =
             Params.get(gateway, "VID-001", "GIMBAL", component: 154)

    for wrong <- [0, 256, "100"] do
      assert {:error, %Result{status: :rejected}} = Params.list(gateway, "VID-001", component: wrong)
      assert {:error, [%{key: "component"}]} = Params.set(gateway, "VID-001", "A", 1, component: wrong)
    end

    for wrong <- [[1], nil, String.duplicate("x", 181), 0x1_0000_0000_0000_0000],
        do: assert({:error, [%{key: "value"}]} = Params.set(gateway, "VID-001", "A", wrong, component: 100))

    assert_raise ArgumentError, fn -> Params.set_all(gateway, "VID-001", %{"A" => 1}, component: 100) end
  end

  test "a sender without the permission is refused before anything is sent, and it is on record", %{
    tmp_dir: dir
  } do
    {gateway, port} = start(dir, %{max_altitude: 100})
    sim = fly(gateway, port, firmware: :ardupilot)

    assert {:ok, %Result{status: :denied, details: %{"rule" => "role"}}} =
             Params.set(gateway, "VID-001", "WPNAV_SPEED", 400, as: @viewer)

    assert {:ok, %Result{status: :denied, details: %{"rule" => "altitude"}, reason: reason}} =
             Missions.upload(gateway, "VID-001", :mission, plan(3, 150.0), id: "high")

    assert reason =~ "150 m"
    assert {:ok, %{plan: %{items: []}}} = Missions.download(gateway, "VID-001", :mission)
    # The id has its result, and is not used for anything else.
    assert {:ok, %Result{status: :denied}} =
             Missions.upload(gateway, "VID-001", :mission, plan(3, 150.0), id: "high")

    assert {:ok, %Result{status: :rejected, details: %{"rule" => "id"}}} =
             Missions.clear(gateway, "VID-001", :mission, id: "high")

    assert [
             %{
               "decision" => "deny",
               "command" => "mission_upload",
               "params" => %{"items" => _n, "digest" => _digest}
             }
             | _
           ] =
             Aerie.Patience.eventually(fn ->
               with [] <- for(%{"id" => "high"} = record <- CommandCase.audit(dir), do: record), do: nil
             end)

    assert {:error, [%{key: "name"}]} = Params.set(gateway, "VID-001", "A NAME", 1)

    assert {:ok, %Result{status: :rejected, details: %{"rule" => "vehicle"}}} =
             Params.set(gateway, "VID-009", "A", 1)

    assert {:error, %Result{details: %{"rule" => "vehicle"}}} = Params.list(gateway, "VID-009")
    assert Process.alive?(sim)
  end

  test "equal readings at once are one; the end of its process ends a transfer and nothing else", %{
    tmp_dir: dir
  } do
    {gateway, port} = start(dir)
    sim = fly(gateway, port, firmware: :ardupilot)
    key = {"main", 1}
    session = Names.whereis(gateway, :session, key)
    :ok = SimVehicle.fault(sim, :deaf, true)
    tasks = for _n <- 1..20, do: Task.async(fn -> Params.list(gateway, "VID-001", progress: nil) end)
    write = Task.async(fn -> Params.set(gateway, "VID-001", "WPNAV_SPEED", 400) end)
    transfers = Names.whereis(gateway, :transfers, key)

    eventually(fn ->
      :sys.get_state(transfers, Aerie.Patience.ms()).watchers
      |> Map.values()
      |> Enum.map(&map_size/1)
      |> Enum.sort() == [1, 20]
    end)

    Process.exit(transfers, :kill)

    for {:error, result} <- Task.await_many(tasks, Aerie.Patience.ms()),
        do: assert(%Result{status: :unknown} = result)

    assert {:ok, %Result{status: :unknown}} = Task.await(write, Aerie.Patience.ms())
    assert Names.whereis(gateway, :session, key) == session
    :ok = SimVehicle.fault(sim, :deaf, false)
    assert {:ok, _table} = eventually(fn -> match_ok(Params.list(gateway, "VID-001")) end)
  end

  test "the time limit of a transfer follows from its length, unless it is given", %{tmp_dir: dir} do
    {gateway, port} = start(dir)
    sim = fly(gateway, port, firmware: :ardupilot)
    :ok = SimVehicle.fault(sim, :deaf, true)
    values = Map.new(1..500, &{"P#{&1}", &1})
    # With home, which is ArduPilot's first item.
    upload = fn count, options -> Missions.upload(gateway, "VID-001", :mission, plan(count), options) end
    bytes = :binary.copy("x", 1_000_000)

    for {ask, seconds} <- [
          {&upload.(10, &1), 300},
          {&upload.(720, &1), 7_270},
          {&upload.(720, [timeout_ms: 50_000] ++ &1), 50},
          {&Params.set_all(gateway, "VID-001", values, &1), 2_560},
          {&Files.write(gateway, "VID-001", "/a", bytes, &1), 4_060},
          {&Logs.fold(gateway, "VID-001", %{id: 1, size: 10_000_000, time: nil}, 0, [], fn b, _ -> b end, &1),
           40_060}
        ] do
      before = System.monotonic_time(:microsecond)
      task = Task.async(fn -> ask.([]) end)
      transfers = eventually(fn -> Names.whereis(gateway, :transfers, {"main", 1}) end)
      [job] = eventually(fn -> with [] <- Map.values(:sys.get_state(transfers).core.jobs), do: nil end)

      now = System.monotonic_time(:microsecond)
      assert job.until in (before + seconds * 1_000_000)..(now + seconds * 1_000_000)
      Process.exit(transfers, :kill)
      Task.await(task, Aerie.Patience.ms())
    end
  end

  defp match_ok({:ok, _value} = ok), do: ok
  defp match_ok(_other), do: nil

  test "a transfer is cancelled by a sender with the permission", %{tmp_dir: dir} do
    {gateway, port} = start(dir)
    sim = fly(gateway, port, firmware: :px4)
    :ok = SimVehicle.fault(sim, :deaf, true)
    task = Task.async(fn -> Missions.upload(gateway, "VID-001", :mission, plan(3), id: "m") end)
    admin = Commands.inside()
    assert :ok = eventually(fn -> if Commands.cancel(gateway, "VID-001", "m", admin) == :ok, do: :ok end)
    :ok = SimVehicle.fault(sim, :deaf, false)
    assert {:ok, %Result{status: :cancelled}} = Task.await(task, Aerie.Patience.ms())
    assert {:error, :unknown, _text} = Commands.cancel(gateway, "VID-001", "m", @viewer)
  end

  defp flush_progress do
    receive do
      {:command_progress, :into, _id, _progress} -> flush_progress()
    after
      0 -> :ok
    end
  end

  @log for(n <- 0..20_000, into: <<>>, do: <<rem(n * 7, 251)>>)

  for firmware <- [:ardupilot, :px4] do
    test "#{firmware}: files are listed, read, written and removed; logs are brought into files, and continued",
         %{tmp_dir: dir} do
      {gateway, port} = start(dir)
      files = %{"/log.bin" => @log}
      fly(gateway, port, firmware: unquote(firmware), files: files, logs: [@log], loss: 0.02)
      assert {:ok, entries} = Files.list(gateway, "VID-001", "/")
      assert %{kind: :file, size: 20_001} = Enum.find(entries, &(&1.name == "log.bin"))
      assert {:ok, @log} = Files.read(gateway, "VID-001", "/log.bin", progress: self())
      assert_received {:command_progress, nil, _id, %{"phase" => "reading"}}
      assert {:ok, crc} = Files.crc(gateway, "VID-001", "/log.bin")
      assert crc == MavCodec.CRC.crc32(@log)

      # The first half was there, of this file, of another one, and damaged.
      into = Path.join(dir, "copy.bin")

      part = fn bytes, crc ->
        for {end_, b} <- [{".part", bytes}, {".part.crc", crc}], do: File.write!(into <> end_, b)
      end

      read = fn -> Files.read(gateway, "VID-001", "/log.bin", into: into, progress: {self(), :into}) end
      part.(binary_part(@log, 0, 10_000), Base.encode16(<<crc::32>>))
      assert {:ok, 20_001} = read.()
      assert_received {:command_progress, :into, _id, %{"done" => done}}
      assert done > 10_000
      assert File.read!(into) == @log
      refute File.exists?(into <> ".part.crc")
      flush_progress()

      part.(:binary.copy("x", 10_000), "00000000")
      assert {:ok, 20_001} = read.()
      assert_received {:command_progress, :into, _id, %{"done" => done}}
      assert done < 10_000
      assert File.read!(into) == @log

      part.(:binary.copy("x", 10_000), Base.encode16(<<crc::32>>))
      assert {:error, %Result{status: :failed, reason: "its checksum" <> _}} = read.()
      assert {:ok, 20_001} = read.()
      assert File.read!(into) == @log

      assert {:ok, %Result{status: :completed}} = Files.write(gateway, "VID-001", "/new.txt", "some text")
      assert {:ok, "some text"} = Files.read(gateway, "VID-001", "/new.txt")
      assert {:ok, %Result{status: :denied}} = Files.remove(gateway, "VID-001", "/new.txt", as: @viewer)
      assert {:ok, %Result{status: :completed}} = Files.remove(gateway, "VID-001", "/new.txt")

      assert {:error, %Result{status: :rejected, details: %{"rule" => "file"}}} =
               Files.read(gateway, "VID-001", "/new.txt")

      assert {:ok, [%{size: 20_001} = entry]} = Logs.list(gateway, "VID-001")
      path = Path.join(dir, "flight.bin")
      File.write!(path <> ".part", binary_part(@log, 0, 5_000))
      assert {:ok, 20_001} = Logs.download(gateway, "VID-001", entry, path)
      assert File.read!(path) == @log
      refute File.exists?(path <> ".part")

      # What is not the same log is not continued.
      File.write!(path <> ".part", binary_part(@log, 0, 5_000))

      for other <- [%{entry | size: 20_002}, %{entry | time: entry.time + 1}, %{entry | id: entry.id + 1}] do
        assert {:error, %Result{status: :rejected, details: %{"rule" => "log"}}} =
                 Logs.download(gateway, "VID-001", other, path)
      end
    end
  end
end
