defmodule Aerie.Control.Policy.UnknownNumbersTest do
  @moduledoc """
  Numbers that are missing, zero, or a flag, in every command and item: what the firmware then takes in their place is
  not known, so a fence and a limit refuse them; and what `current` and `mission_type` make of an item.
  """
  use ExUnit.Case, async: true

  import MavCodec.Test.Wire, only: [decoded: 1]

  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.{Intent, Mavlink, Roles}
  alias Aerie.Control.Policy.Intent.Context
  alias MavCodec.Dialects.All
  alias MavCodec.Enums.MavCmd
  alias MavCodec.Messages, as: M

  @moduletag :tmp_dir

  @ap %{autopilot: :ardupilot, vehicle_type: "copter"}
  @px4 %{autopilot: :px4, vehicle_type: "copter"}
  @unknown %{autopilot: :generic, vehicle_type: "unknown"}
  @now 1_795_340_000_000_000
  @here [frame: 3, x: 470_000_000, y: 80_000_000, z: 40.0]
  @fence """
  {"type": "Feature", "properties": {"name": "field"},
   "geometry": {"type": "Polygon", "coordinates": [[[7.9, 46.9], [8.1, 46.9], [8.1, 47.1], [7.9, 47.1]]]}}
  """

  setup %{tmp_dir: dir} do
    file = Path.join(dir, "fence.geojson")
    File.write!(file, @fence)

    {:ok,
     fence: %{geofence_file: file}, limits: [%{geofence_file: file}, %{max_altitude: 60}, %{min_altitude: 10}]}
  end

  defp judge(section, message, vehicle, options \\ []) do
    {:ok, policy} = Policy.compile(section)
    may = Keyword.get(options, :permissions, Intent.most() ++ [:protection])
    source = Roles.principal(:client, "olga", Keyword.get(options, :role, :admin), may)

    groups = %{
      position: %{lat: 47.0, lon: 8.0, alt_rel: 40.0, alt_msl: 540.0, heading: 0.0},
      home: %{lat: 47.0, lon: 8.0, alt_msl: 500.0},
      mode: %{mode: "GUIDED", armed: true, in_air: true}
    }

    context = groups |> Context.new(source, @now) |> struct!(vehicle)
    Policy.decide(policy, Mavlink.facts(decoded(message), vehicle), context)
  end

  defp id(name), do: MavCmd.value(:"MAV_CMD_#{name}")

  defp long(name, params),
    do:
      struct!(
        %M.CommandLong{command: id(name)},
        for({p, n} <- Enum.with_index(params, 1), do: {:"param#{n}", p})
      )

  defp int(name, fields), do: struct!(%M.CommandInt{command: id(name)}, Keyword.merge(@here, fields))

  defp item(command, fields),
    do: struct!(%M.MissionItemInt{seq: 3, command: command}, Keyword.merge(@here, fields))

  defp module(name), do: Module.concat(M, name |> String.downcase() |> Macro.camelize())

  defp rows(key, kinds),
    do: for(row <- MavCodec.Meaning.Commands.all(), Map.fetch!(row, key) in kinds, do: row)

  test "a height that is not a number is refused where heights or places are limited, in every command and item",
       c do
    # DO_CHANGE_ALTITUDE has its height in parameter 1.
    flown = for row <- rows(:as_command, [:flown, :height]), row.name != "DO_CHANGE_ALTITUDE", do: row

    for section <- c.limits, vehicle <- [@ap, @unknown], row <- flown do
      params = for n <- 1..4, do: {:"param#{n}", 1.0}
      command = struct!(%M.CommandInt{command: row.id}, params ++ Keyword.put(@here, :z, :nan))
      long = struct!(%M.CommandLong{command: row.id, param5: 47.0, param6: 8.0, param7: :nan}, params)

      for message <- [command, long] do
        assert {row.name, match?({:deny, _, _}, judge(section, message, vehicle))} == {row.name, true}
      end
    end

    for section <- [c.fence, %{max_altitude: 60}],
        vehicle <- [@ap, @px4, @unknown],
        row <- rows(:as_item, [:flown]) do
      for message <- [
            item(row.id, z: :nan),
            %M.MissionItem{seq: 3, command: row.id, frame: 3, x: 47.0, y: 8.0, z: :nan}
          ] do
        assert {row.name, match?({:deny, _, _}, judge(section, message, vehicle))} == {row.name, true}
      end
    end
  end

  test "the refusal says which number is missing", c do
    for {message, vehicle, missing} <- [
          {int("DO_REPOSITION", z: :nan), @ap, "the height (parameter 7)"},
          {long("DO_REPOSITION", [0.0, 0.0, 0.0, 0.0, 47.0, 8.0, :nan]), @ap, "the height (parameter 7)"},
          {long("DO_REPOSITION", [0.0, 0.0, 0.0, 0.0, :nan, :nan, 40.0]), @ap, "the latitude (parameter 5)"},
          {long("DO_CHANGE_ALTITUDE", [:nan, 3.0]), @ap, "the height (parameter 1)"},
          {long("DO_CHANGE_ALTITUDE", [:nan, 3.0]), @px4, "the height (parameter 1)"},
          {long("DO_ORBIT", [:nan, 5.0, 0.0, 0.0, 47.0, 8.0, 540.0]), @px4, "the radius (parameter 1)"},
          {int("DO_ORBIT", param1: :nan, z: 540.0, frame: 0), @px4, "the radius (parameter 1)"},
          {long("DO_ORBIT", [30.0, 5.0, 0.0, 0.0, :nan, :nan, 540.0]), @px4,
           "the latitude of its middle (parameter 5)"},
          {long("DO_GO_AROUND", [:nan]), @px4, "the height (parameter 1)"},
          {int("NAV_SET_YAW_SPEED", param1: :nan), @ap, "the angle (parameter 1)"},
          {int("NAV_SET_YAW_SPEED", param2: :nan), @ap, "the speed (parameter 2)"},
          {item(16, current: 2, z: :nan), @ap, "the height (parameter 7)"},
          {item(16, current: 3, z: :nan), @ap, "the height (parameter 7)"},
          {item(id("DO_CHANGE_ALTITUDE"), param1: :nan), @ap, "the height (parameter 1)"},
          {%M.FollowTarget{lat: 470_000_000, lon: 80_000_000, alt: :nan}, @ap, "its height"}
        ] do
      for section <- c.limits -- [%{min_altitude: 10}] do
        assert {:deny, rule, reason} = judge(section, message, vehicle)
        assert rule in [:geofence, :altitude]
        assert reason =~ "#{missing} is not a number"
      end

      # Without a limit it is the vehicle's matter.
      assert judge(%{}, message, vehicle) == :allow
    end
  end

  test "PX4 keeps a height and a place that are NaN, and that is judged", c do
    for section <- c.limits do
      assert judge(section, int("DO_REPOSITION", z: :nan, frame: 0), @px4) == :allow
      assert judge(section, long("DO_REPOSITION", [-1.0, 1.0, 0.0, :nan, :nan, :nan, :nan]), @px4) == :allow
    end
  end

  test "0, 0 is where ArduPilot is, and a place to PX4 and to what is not known", c do
    for row <- rows(:as_item, [:flown]),
        message <- [item(row.id, x: 0, y: 0), %M.MissionItem{seq: 3, command: row.id, frame: 3, z: 40.0}] do
      for vehicle <- [@px4, @unknown] do
        assert {row.name, match?({:deny, :geofence, _}, judge(c.fence, message, vehicle))} == {row.name, true}
      end

      # How far its pass goes beyond is not told by zeros either.
      assert {row.name, match?({:deny, :geofence, "mission item 3 0" <> _}, judge(c.fence, message, @ap))} ==
               {row.name, false}
    end

    for vehicle <- [@px4, @unknown], name <- ["NAV_TAKEOFF", "NAV_VTOL_TAKEOFF", "DO_REPOSITION"] do
      assert {:deny, :geofence, _} = judge(c.fence, int(name, x: 0, y: 0, frame: 0, z: 540.0), vehicle)
      assert {:deny, :geofence, _} = judge(c.fence, long(name, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 40.0]), vehicle)
    end
  end

  test "`current` 2 and 3: ArduPilot obeys, PX4 stores, and each command in it needs what it needs", c do
    for row <- MavCodec.Meaning.Commands.all(), current <- [2, 3], role <- [:operator, :admin] do
      options = [role: role, permissions: []]
      stored = judge(c.fence, item(row.id, current: 0), @px4, options)
      assert {row.name, judge(c.fence, item(row.id, current: current), @px4, options)} == {row.name, stored}

      # What may not be stored is not passed as a goto either, whatever the firmware.
      for vehicle <- [@ap, @unknown],
          row.name != "NAV_WAYPOINT",
          match?({:deny, _, _}, judge(%{}, item(row.id, []), vehicle, options)) do
        assert {row.name, vehicle,
                match?({:deny, _, _}, judge(%{}, item(row.id, current: current), vehicle, options))} ==
                 {row.name, vehicle, true}
      end
    end

    outside = [x: 475_000_000]

    for vehicle <- [@ap, @px4, @unknown],
        do: assert({:deny, :geofence, _} = judge(c.fence, item(16, [current: 2] ++ outside), vehicle))

    for vehicle <- [@ap, @unknown],
        do: assert({:deny, :altitude, _} = judge(%{max_altitude: 60}, item(16, current: 3, z: 90.0), vehicle))

    # Another command leads ArduPilot's planes and rovers there as well.
    assert {:deny, :geofence, _} = judge(c.fence, item(id("DO_SET_SERVO"), [current: 2] ++ outside), @ap)
    assert judge(c.fence, item(16, current: 2), @ap, role: :operator, permissions: []) == :allow

    # Not as a command that is not known.
    for vehicle <- [@ap, @px4, @unknown],
        current <- [2, 3],
        do: assert({:deny, :unknown, _} = judge(%{}, item(43_999, current: current), vehicle))
  end

  test "what estimators and failsafes are given needs `inputs` where anything is limited", c do
    limited = for id <- All.ids(), MavCodec.Meaning.Messages.row(id).limited, do: module(All.name(id))

    for message <- Enum.map(limited, &struct!(&1, [])), vehicle <- [@ap, @px4, @unknown] do
      for section <- [%{max_altitude_msl: 600} | c.limits] do
        assert {:deny, :role, reason} = judge(section, message, vehicle, role: :operator, permissions: [])
        assert reason =~ "needs the permission inputs"
        assert judge(section, message, vehicle, role: :operator, permissions: [:inputs]) == :allow
        assert judge(section, message, vehicle, role: :admin, permissions: []) == :allow
      end

      assert judge(%{}, message, vehicle, role: :operator, permissions: []) == :allow
    end
  end

  test "a fence and rally points consist of their own commands, whatever `current` says" do
    for row <- MavCodec.Meaning.Commands.all(),
        {type, start} <- [{1, "NAV_FENCE_"}, {2, "NAV_RALLY_"}],
        vehicle <- [@ap, @px4, @unknown],
        current <- [0, 2] do
      decision =
        judge(%{}, item(row.id, mission_type: type, current: current), vehicle,
          role: :operator,
          permissions: []
        )

      belongs? = String.starts_with?(row.name, start)
      assert {row.name, type, decision == :allow} == {row.name, type, belongs?}
      if not belongs?, do: assert({:deny, :number, _} = decision)
    end

    assert {:deny, :number, reason} = judge(%{}, item(id("NAV_LAND"), mission_type: 1), @ap)
    assert reason == "fence item 3: NAV_LAND is not an item of a fence"
    assert {:deny, :number, _} = judge(%{}, item(43_999, mission_type: 2), @ap)
  end

  test "an upload is of one of the three types; clearing all of them counts as clearing each" do
    for type <- Enum.to_list(3..255),
        message <- [
          %M.MissionCount{count: 1, mission_type: type},
          %M.MissionWritePartialList{mission_type: type},
          item(16, mission_type: type),
          item(16, mission_type: type, current: 2),
          %M.MissionItem{seq: 1, command: 16, mission_type: type}
        ],
        vehicle <- [@ap, @px4, @unknown] do
      assert {:deny, :number, _} = judge(%{}, message, vehicle)
    end

    for type <- 3..254,
        do: assert({:deny, :number, _} = judge(%{}, %M.MissionClearAll{mission_type: type}, @ap))

    all = %M.MissionClearAll{mission_type: 255}
    assert {:deny, :role, _} = judge(%{}, all, @ap, role: :operator, permissions: [])
    assert judge(%{}, all, @ap) == :allow

    for type <- ~w(mission_upload fence_upload rally_upload) do
      assert {:deny, :condition, _} = judge(%{conditions: [%{types: [type], in_air: false}]}, all, @ap)
    end
  end
end
