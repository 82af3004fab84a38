defmodule Aerie.Vehicle.Services.GcsTest do
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.Services.Gcs

  @second 1_000_000

  defp station(system, at, options \\ []) do
    Map.merge(
      %{system: system, component: 190, type: 6, via: "radio", last_heard: at * @second},
      Map.new(options)
    )
  end

  # A step a second; `heard` gives the stations of a second.
  defp run(gcs, seconds, heard, answers \\ %{}) do
    {log, gcs} =
      Enum.flat_map_reduce(seconds, gcs, fn second, gcs ->
        gcs = Gcs.stations(gcs, heard.(second), {245, 191})
        {gcs, asked, told} = Gcs.expire(gcs, second * @second, {1, 1}, true)
        names = Enum.map(asked, & &1.param_id)

        gcs =
          for(name <- names, value = answers[name], do: {name, value})
          |> Enum.reduce(gcs, fn {n, v}, g -> Gcs.param(g, n, v) end)

        {Enum.map(names, &{:asked, second, &1}) ++
           Enum.map(told, &{:told, div(elem(&1, 1), @second), elem(&1, 0)}), gcs}
      end)

    {log, gcs}
  end

  defp asked(log), do: for({:asked, _, name} <- log, do: name)
  defp told(log), do: for({:told, at, what} <- log, do: {what, at})
  defp copter, do: Gcs.vehicle(Gcs.new(), :ardupilot, "copter")

  test "H5: setting the clock neither brings a station back nor loses one" do
    hour = 3_600
    gcs = Gcs.param(copter(), "SYSID_MYGCS", 255)

    {[], gcs} =
      run(Map.put(gcs, :asked, %{}) |> Map.put(:next, nil), 0..3, fn at -> [station(255, at)] end) |> quiet()

    for step <- [-hour, hour] do
      # It falls silent when the clock is set: lost five seconds after it was last heard, as without that.
      shifted = Gcs.shifted(gcs, step * @second)
      {log, _gcs} = run(shifted, (4 + step)..(20 + step), fn _ -> [station(255, 3 + step)] end)
      assert told(log) == [lost: 8 + step]
      # Heard all the time: nothing is reported.
      {log, _gcs} = run(shifted, (4 + step)..(20 + step), &[station(255, &1)])
      assert told(log) == []
    end
  end

  defp quiet({log, gcs}), do: {told(log), gcs}

  test "H5: whose heartbeats count is unknown until ArduPilot's parameter is, and goes by the type with PX4" do
    assert Gcs.obeyed(Gcs.new()) == nil
    assert Gcs.obeyed(copter()) == :unknown
    assert copter() |> Gcs.param("SYSID_MYGCS", 200.0) |> Gcs.obeyed() == {200, 200}
    since_4_7 = copter() |> Gcs.param("MAV_GCS_SYSID", 250.0)
    assert Gcs.obeyed(since_4_7) == {250, 250}
    assert since_4_7 |> Gcs.param("MAV_GCS_SYSID_HI", 254.0) |> Gcs.obeyed() == {250, 254}
    assert Gcs.new() |> Gcs.vehicle(:px4, "copter") |> Gcs.obeyed() == nil
  end

  describe "the station that it listens to" do
    test "is read once, one by one, and only as far as it is needed" do
      answers = %{"SYSID_MYGCS" => 255, "FS_GCS_ENABLE" => 1, "FS_GCS_TIMEOUT" => 5.0}
      {log, gcs} = run(copter(), 0..600, fn _ -> [] end, answers)
      assert log == [{:asked, 5, "SYSID_MYGCS"}, {:asked, 7, "FS_GCS_ENABLE"}, {:asked, 9, "FS_GCS_TIMEOUT"}]

      assert %{failsafe_gcs: 255, failsafe_range: {255, 255}, enabled?: true, timeout_s: 5.0} =
               Gcs.show(gcs, 0)

      assert {[], _} = run(%{gcs | asked: %{}}, 601..700, fn _ -> [] end)
    end

    test "newer ArduPilots and planes have other parameter names" do
      answers = %{"MAV_GCS_SYSID" => 250, "MAV_GCS_SYSID_HI" => 254, "FS_GCS_ENABLE" => 0}
      {log, gcs} = run(copter(), 0..600, fn _ -> [] end, answers)

      assert ["SYSID_MYGCS", "SYSID_MYGCS", "MAV_GCS_SYSID", "MAV_GCS_SYSID_HI", "FS_GCS_ENABLE" | _] =
               asked(log)

      assert %{failsafe_gcs: 250, failsafe_range: {250, 254}, enabled?: false} = Gcs.show(gcs, 0)

      assert Gcs.keeps_quiet?(gcs, %{system: 252, type: 18}) and
               not Gcs.keeps_quiet?(gcs, %{system: 255, type: 6})

      plane = Gcs.vehicle(Gcs.new(), :ardupilot, "plane")
      {log, _gcs} = run(plane, 0..600, fn _ -> [] end, %{"SYSID_MYGCS" => 255})
      assert "FS_GCS_ENABL" in asked(log) and "FS_GCS_ENABLE" not in asked(log)
    end

    test "PX4 listens to any ground station" do
      px4 = Gcs.vehicle(Gcs.new(), :px4, "copter")
      {log, gcs} = run(px4, 0..600, fn _ -> [] end, %{"NAV_DLL_ACT" => 2, "COM_DL_LOSS_T" => 10})
      assert asked(log) == ["NAV_DLL_ACT", "COM_DL_LOSS_T"]

      assert Gcs.keeps_quiet?(gcs, %{system: 17, type: 6}) and
               not Gcs.keeps_quiet?(gcs, %{system: 17, type: 18})

      assert %{failsafe_gcs: nil, enabled?: true, timeout_s: 10.0} = Gcs.show(gcs, 0)
    end

    test "a vehicle that does not answer is asked twice for each" do
      {log, gcs} = run(copter(), 0..600, fn _ -> [] end)
      assert log |> asked() |> Enum.frequencies() |> Map.values() |> Enum.uniq() == [2]
      assert Enum.all?(log, fn {:asked, at, _} -> at < 30 end)
      {log, _gcs} = run(Gcs.rebooted(gcs, 600 * @second), 601..700, fn _ -> [] end)
      assert [{:asked, 605, "SYSID_MYGCS"} | _] = log
      assert {[], _} = run(Gcs.new(), 0..100, fn _ -> [] end)
    end

    test "an unrequested value counts, other parameters do not" do
      gcs = copter() |> Gcs.param("SYSID_MYGCS", 252) |> Gcs.param("RTL_ALT", 1500)
      assert Gcs.show(gcs, 0).params == %{"SYSID_MYGCS" => 252}
      assert Gcs.new(Gcs.show(gcs, 0)).params == %{"SYSID_MYGCS" => 252}
    end
  end

  describe "H5: whether the failsafe is kept quiet" do
    defp known,
      do:
        copter()
        |> Gcs.param("SYSID_MYGCS", 255)
        |> Gcs.param("FS_GCS_ENABLE", 1)
        |> Gcs.param("FS_GCS_TIMEOUT", 5)

    test "while its station is heard; gone after the vehicle's own time-out; back with the next heartbeat" do
      {log, gcs} = run(known(), 0..10, fn at -> [station(255, at)] end)
      assert told(log) == []

      assert %{quiet?: true, heard_gcs: 255, known_by: [255], last_heard: 10_000_000} =
               Gcs.show(gcs, 10 * @second)

      {log, gcs} = run(gcs, 11..30, fn _ -> [station(255, 10)] end)
      assert told(log) == [lost: 15]
      assert %{quiet?: false, known_by: [255]} = Gcs.show(gcs, 30 * @second)
      {log, _gcs} = run(gcs, 31..40, fn at -> [station(255, at)] end)
      assert told(log) == [back: 31]
    end

    test "another station is listed and does not keep it quiet" do
      {_log, gcs} = run(known(), 0..10, fn at -> [station(255, at), station(253, at)] end)
      {log, gcs} = run(gcs, 11..30, fn at -> [station(255, 10), station(253, at)] end)
      assert told(log) == [lost: 15]
      assert %{quiet?: false, known_by: [253, 255], stations: stations} = Gcs.show(gcs, 30 * @second)
      assert for(s <- stations, do: {s.system, s.keeps?}) == [{255, true}, {253, false}]
    end

    test "one that was never heard is not lost" do
      {log, gcs} = run(known(), 0..100, fn at -> [station(253, at)] end)
      assert told(log) == []
      assert %{quiet?: nil, heard_gcs: nil} = Gcs.show(gcs, 100 * @second)
    end

    test "for ArduPilot any sender with its id counts; our own heartbeat is not another station's" do
      {_log, gcs} = run(known(), 0..10, fn at -> [station(255, at, type: 18)] end)
      assert Gcs.show(gcs, 10 * @second).quiet?
      own = copter() |> Gcs.param("SYSID_MYGCS", 245)
      {_log, gcs} = run(own, 0..10, fn at -> [station(245, at, component: 191)] end)
      assert %{quiet?: nil, stations: []} = Gcs.show(gcs, 10 * @second)
      # Our system id with another component, as MAVSDK may have.
      {_log, gcs} = run(own, 0..10, fn at -> [station(245, at)] end)
      assert %{quiet?: true, known_by: [245]} = Gcs.show(gcs, 10 * @second)
    end

    test "setting the clock loses no station" do
      {_log, gcs} = run(known(), 0..10, fn at -> [station(255, at)] end)
      {log, _gcs} = gcs |> Gcs.rebased(5_000 * @second) |> run(5_000..5_010, fn at -> [station(255, at)] end)
      assert told(log) == []
    end

    test "a loss before a restart or a break of time ends with the first heartbeat after it" do
      {_log, gcs} = run(known(), 0..30, fn at -> [station(255, min(at, 10))] end)

      for again <- [Gcs.rebased(gcs, 5_000 * @second), Gcs.new(Gcs.show(gcs, 30 * @second))] do
        again = Gcs.vehicle(again, :ardupilot, "copter")
        {log, waiting} = run(again, 5_000..5_010, fn _at -> [] end)
        assert told(log) == []
        {log, _gcs} = run(waiting, 5_011..5_020, fn at -> [station(255, at)] end)
        assert told(log) == [back: 5_011]
      end
    end
  end

  test "lost and back alternate, whichever stations are heard" do
    prop =
      :proper.forall(:proper_types.list(:proper_types.oneof([:nobody, 255, 253])), fn heard ->
        {log, _} =
          heard
          |> Enum.with_index()
          |> Enum.flat_map_reduce({known(), nil}, fn {who, n}, {gcs, last} ->
            last = if who == 255, do: n * 3, else: last
            stations = for {system, at} <- [{255, last}, {253, n * 3}], at != nil, do: station(system, at)
            gcs = Gcs.stations(gcs, stations, {245, 191})
            {gcs, _asked, told} = Gcs.expire(gcs, n * 3 * @second, {1, 1}, false)
            {Enum.map(told, &elem(&1, 0)), {gcs, last}}
          end)

        log == Enum.take(Stream.cycle([:lost, :back]), length(log))
      end)

    assert :proper.quickcheck(prop, [:quiet, numtests: 200]) == true, inspect(:proper.counterexample())
  end
end
