defmodule Aerie.Control.Policy.Clients.TrialTest do
  @moduledoc "What a trial carries from command to command; that it decides as the gate does is in `MavlinkPolicyTest`."
  use ExUnit.Case, async: true

  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.Roles
  alias Aerie.Control.Policy.Clients.Trial
  alias Aerie.Vehicle.Command
  alias MavCodec.Enums.MavCmd
  alias MavCodec.Messages, as: M

  @moduletag :tmp_dir
  @start 1_795_000_000_000_000
  @second 1_000_000

  # A field with a tower between two places of a mission.
  @fence """
  {"type": "FeatureCollection", "features": [
    {"type": "Feature", "properties": {"name": "field"},
     "geometry": {"type": "Polygon", "coordinates": [[[8.0, 47.0], [8.02, 47.0], [8.02, 47.02], [8.0, 47.02], [8.0, 47.0]]]}},
    {"type": "Feature", "properties": {"name": "tower", "fence": "exclusion", "radius": 100},
     "geometry": {"type": "Point", "coordinates": [8.01, 47.01]}}]}
  """

  defp trial(section) do
    {:ok, policy} = Policy.compile(section)
    Trial.new(policy)
  end

  defp snapshot(groups \\ %{}) do
    known = %{
      position: %{lat: 47.001, lon: 8.001, alt_rel: 20.0, alt_msl: 520.0},
      home: %{lat: 47.001, lon: 8.001, alt_msl: 500.0},
      mode: %{mode: "GUIDED", armed: true, in_air: true}
    }

    %Aerie.Vehicle.Snapshot{
      id: "VID-001",
      key: {"main", 1},
      autopilot: :ardupilot,
      vehicle_type: "copter",
      groups: Map.merge(known, groups)
    }
  end

  defp asked(second, changes \\ []) do
    Map.merge(
      %{
        snapshot: snapshot(),
        at: @start + round(second * @second),
        source: Roles.principal(:client, "255/190", :operator),
        sender: "255/190",
        via: "mavlink"
      },
      Map.new(changes)
    )
  end

  defp message(trial, message, asked) do
    case Trial.message(trial, message, asked) do
      {:free, trial} -> {:free, trial}
      {judgement, trial} -> {judgement.decision, trial}
    end
  end

  defp long(name, params \\ []),
    do: struct!(%M.CommandLong{command: MavCmd.value(:"MAV_CMD_#{name}")}, params)

  test "rates count in the time of the recording, each source and vehicle for itself" do
    trial = trial(%{rates: [%{types: ["takeoff"], per_minute: 1, burst: 1}]})
    takeoff = long("NAV_TAKEOFF", param7: 10.0)

    {:allow, trial} = message(trial, takeoff, asked(0))
    {{:deny, :rate, reason}, trial} = message(trial, takeoff, asked(40))
    assert reason =~ "the next one is allowed in 20 s"

    other = Roles.principal(:client, "254/190", :operator)
    assert {:allow, trial} = message(trial, takeoff, asked(41, source: other))
    assert {:allow, trial} = message(trial, takeoff, asked(42, snapshot: %{snapshot() | id: "VID-002"}))
    assert {:allow, trial} = message(trial, takeoff, asked(61))
    assert {{:deny, :rate, _reason}, trial} = message(trial, takeoff, asked(62))

    # What brings the vehicle down is never counted.
    for _n <- 1..200, reduce: trial do
      trial -> trial |> message(long("NAV_LAND"), asked(63)) |> then(fn {:allow, trial} -> trial end)
    end

    assert {:allow, _trial} = trial |> Trial.again() |> message(takeoff, asked(64))
  end

  test "a refused command has taken its token" do
    trial = trial(%{max_altitude: 30, rates: [%{types: ["takeoff"], per_minute: 1, burst: 1}]})
    {{:deny, :altitude, _reason}, trial} = message(trial, long("NAV_TAKEOFF", param7: 50.0), asked(0))
    assert {{:deny, :rate, _reason}, _trial} = message(trial, long("NAV_TAKEOFF", param7: 20.0), asked(1))
  end

  test "the way from item to item of an upload is judged, for each sender by itself", %{tmp_dir: dir} do
    file = Path.join(dir, "fence.geojson")
    File.write!(file, @fence)
    trial = trial(%{geofence_file: file})

    item = fn seq, lat, lon ->
      %M.MissionItemInt{
        seq: seq,
        frame: 6,
        command: 16,
        x: round(lat * 1.0e7),
        y: round(lon * 1.0e7),
        z: 20.0
      }
    end

    {:allow, trial} = message(trial, %M.MissionCount{count: 3}, asked(0))
    {:allow, trial} = message(trial, item.(1, 47.01, 8.005), asked(1))
    assert {:allow, _trial} = message(trial, item.(2, 47.01, 8.015), asked(2, sender: "254/190"))
    assert {{:deny, :geofence, reason}, trial} = message(trial, item.(2, 47.01, 8.015), asked(2))
    assert reason =~ "tower"

    {:allow, trial} = message(trial, %M.MissionCount{count: 3}, asked(3))
    assert {:allow, _trial} = message(trial, item.(2, 47.01, 8.015), asked(4))
  end

  test "taking charge keeps others from it until it is released" do
    trial = trial(%{lease: %{required: true}})
    ann = Roles.principal(:key, "ann", :operator)

    command = fn trial, source, type, params ->
      {:ok, command} =
        Command.new([vehicle: "VID-001", type: type, params: params, source: source.name], @start)

      {judgement, trial} = Trial.command(trial, command, asked(0, source: source, via: "ledger"))
      {judgement.decision, trial}
    end

    {{:deny, :lease, _reason}, trial} = command.(trial, ann, "takeoff", altitude: 10)
    {:allow, trial} = command.(trial, ann, "take_control", [])
    {:allow, trial} = command.(trial, ann, "takeoff", altitude: 10)
    {{:deny, :lease, reason}, trial} = message(trial, long("NAV_TAKEOFF", param7: 10.0), asked(1))
    assert reason =~ "ann is in charge"
    {:allow, trial} = command.(trial, ann, "release_control", [])
    assert {{:deny, :lease, reason}, _trial} = message(trial, long("NAV_TAKEOFF", param7: 10.0), asked(2))
    assert reason =~ "nobody is in charge"
  end

  test "it says what the vehicle had not told; a message that only reads is free" do
    trial = trial(%{max_altitude: 30, conditions: [%{types: ["gripper"], in_air: false}]})
    silent = snapshot(%{position: %{}, home: %{}, mode: %{}})
    goto = %M.CommandInt{command: 192, frame: 5, x: 470_010_000, y: 80_010_000, z: 510.0}

    {judgement, trial} = Trial.message(trial, goto, asked(0, snapshot: silent))
    assert %{command: "goto", decision: {:deny, :altitude, _reason}, lacking: [:position, :home]} = judgement
    {judgement, trial} = Trial.message(trial, long("DO_GRIPPER", param2: 0.0), asked(0, snapshot: silent))
    assert %{decision: {:deny, :condition, _reason}, lacking: [:armed, :in_air]} = judgement
    {judgement, trial} = Trial.message(trial, %{goto | z: 600.0}, asked(0))
    assert %{decision: {:deny, :altitude, _reason}, lacking: []} = judgement

    read = %M.FileTransferProtocol{payload: <<0::16, 0, 4, 0::64, "/fs">>}
    assert {:free, _trial} = Trial.message(trial, read, asked(0))
  end
end
