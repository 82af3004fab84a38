defmodule Aerie.CommandTrials.Flying do
  @moduledoc "What `Aerie.CommandTrials` tries from arming to the reboot after the flight."

  import Aerie.CommandTrials.Row

  @lat -35.363261
  @lon 149.165230
  @msl 584.0
  @north @lat + 0.0003
  # "Unchanged" in COMMAND_INT.
  @here 2_147_483_647
  # POSITION_TARGET_TYPEMASK: a position, a velocity, and nothing else.
  @position 0xDF8
  @velocity 0xDC7

  @no_method {:no, "no method"}
  @no_gimbal {:no, "its gimbal plugin needs a gimbal that announces itself"}

  @doc "The rows; `by` chooses between ArduPilot's and PX4's."
  @spec rows((term(), term() -> term())) :: [Aerie.CommandTrials.Row.t()]
  def rows(by), do: Enum.concat([flight(by), steering(by), mission(by), ends(by)])

  defp armable(by) do
    position = [
      {"manual_control.set_manual_control_input", [0.0, 0.0, 0.5, 0.0]},
      "manual_control.start_position_control"
    ]

    row(
      "set_mode",
      %{mode: by.("GUIDED", "AUTO_LOITER")},
      by.(long("DO_SET_MODE", [1, 4]), long("DO_SET_MODE", [1, 4, 3])),
      :completed,
      0,
      mavsdk: by.(position, "action.hold"),
      # MAVSDK brakes ArduPilot before it arms unless it has heard the new mode.
      lasts_s: 5,
      does: &(&1.mode in ~w(GUIDED LOITER POSHOLD AUTO_LOITER))
    )
  end

  defp arm,
    do:
      row("arm", %{}, long("COMPONENT_ARM_DISARM", [1]), :completed, 0,
        mavsdk: "action.arm",
        does: & &1.armed
      )

  defp flight(by) do
    [
      armable(by),
      arm(),
      row("disarm", %{}, long("COMPONENT_ARM_DISARM", [0]), :completed, 0,
        mavsdk: "action.disarm",
        does: &(not &1.armed)
      ),
      arm(),
      row(
        "takeoff",
        %{altitude: 10},
        by.(
          long("NAV_TAKEOFF", [0, 0, 0, 0, 0, 0, 10]),
          long("NAV_TAKEOFF", [0, 0, 0, nil, nil, nil, @msl + 10])
        ),
        :completed,
        0,
        mavsdk: [{"action.set_takeoff_altitude", [10.0]}, "action.takeoff"],
        does: &(&1.alt_rel > 8.5)
      ),
      row(
        "goto",
        %{lat: @north, lon: @lon, altitude: 20},
        int("DO_REPOSITION", 6, [-1, 1, 0, nil], {e7(@north), e7(@lon)}, 20),
        :completed,
        0,
        mavsdk: {"action.goto_location", [@north, @lon, @msl + 20, 0.0]},
        does: &(&1.lat > @lat + 0.0002)
      ),
      row("set_speed", %{speed: 4}, long("DO_CHANGE_SPEED", [1, 4, -1]), :accepted, 0,
        mavsdk: {"action.set_current_speed", [4.0]}
      ),
      row("set_altitude", %{altitude: 25}, long("DO_CHANGE_ALTITUDE", [25, 3]), :completed, 3,
        mavsdk: @no_method,
        does: &(&1.alt_rel > 23)
      ),
      row(
        "set_yaw",
        %{yaw: 90},
        by.(
          long("CONDITION_YAW", [90]),
          int("DO_REPOSITION", 5, [-1, 1, 0, :math.pi() / 2], {@here, @here}, nil)
        ),
        by.(:accepted, :completed),
        0,
        mavsdk: @no_method,
        does: &(abs(&1.heading - 90) < 5)
      ),
      row(
        "orbit",
        %{radius: 20, lat: @lat, lon: @lon, altitude: 25},
        int("DO_ORBIT", 5, [20, 5, 0, nil], {e7(@lat), e7(@lon)}, @msl + 25),
        by.(:rejected, :completed),
        by.(3, 0),
        mavsdk: {"action.do_orbit", [20.0, 5.0, 0, @lat, @lon, @msl + 25]},
        result: by.("UNSUPPORTED", "SUCCESS"),
        does: &(&1.mode == "ORBIT")
      ),
      row(
        "set_roi",
        %{lat: @lat, lon: @lon, altitude: 0},
        int("DO_SET_ROI_LOCATION", 6, [0, 0, 0, 0], {e7(@lat), e7(@lon)}, 0),
        :accepted,
        0,
        mavsdk: @no_gimbal
      ),
      row("clear_roi", %{}, long("DO_SET_ROI_NONE", []), :accepted, 0, mavsdk: @no_method)
    ]
  end

  # Each set-point stays in force until the next one.
  defp steering(by) do
    long = %{hold: 10, rate: 50}

    [
      row(
        "setpoint_local",
        Map.merge(long, %{north: 20, east: 0, down: -20}),
        stream("set_position_target_local_ned", target(1, @position, %{x: 20, y: 0, z: -20})),
        :accepted,
        nil,
        mavsdk: {"offboard.set_position_ned", [%{"PositionNedYaw" => [20.0, 0.0, -20.0, 0.0]}]},
        # PX4 wants a second of set-points before OFFBOARD (X7); MAVSDK ends them after three of ours without it.
        lasts_s: 4
      ),
      row(
        "set_mode",
        %{mode: by.("GUIDED", "OFFBOARD")},
        by.(long("DO_SET_MODE", [1, 4]), long("DO_SET_MODE", [1, 6])),
        :completed,
        0,
        mavsdk: "offboard.start",
        does: &(&1.mode in ~w(GUIDED OFFBOARD))
      ),
      row(
        "setpoint_velocity",
        Map.merge(long, %{vx: 0, vy: 3, vz: 0}),
        stream("set_position_target_local_ned", target(1, @velocity, %{vx: 0, vy: 3, vz: 0})),
        :accepted,
        nil,
        mavsdk: {"offboard.set_velocity_ned", [%{"VelocityNedYaw" => [0.0, 3.0, 0.0, 0.0]}]},
        does: &(&1.mode in ~w(GUIDED OFFBOARD) and &1.groundspeed > 2 and &1.east > 5)
      ),
      row(
        "setpoint_position",
        Map.merge(long, %{lat: @lat, lon: @lon, altitude: 20}),
        stream(
          "set_position_target_global_int",
          target(6, @position, %{lat_int: e7(@lat), lon_int: e7(@lon), alt: 20})
        ),
        :accepted,
        nil,
        mavsdk: {"offboard.set_position_global", [%{"PositionGlobalYaw" => [@lat, @lon, 20.0, 0.0, 0]}]},
        does: &(abs(&1.north) < 3 and abs(&1.east) < 3)
      ),
      row(
        "setpoint_attitude",
        Map.merge(long, %{roll: 0, pitch: 0, yaw: 0, thrust: 0.5}),
        stream("set_attitude_target", %{
          type_mask: 7,
          q: [1, 0, 0, 0],
          body_roll_rate: 0,
          body_pitch_rate: 0,
          body_yaw_rate: 0,
          thrust: 0.5,
          time_boot_ms: 0
        }),
        :accepted,
        nil,
        mavsdk: {"offboard.set_attitude", [%{"Attitude" => [0.0, 0.0, 0.0, 0.5]}]}
      ),
      row(
        "rc_override",
        %{channels: [1500, 1500, 1500, 1500], hold: 0.5},
        message(
          "rc_channels_override",
          Map.new(1..8, &{"chan#{&1}_raw", if(&1 <= 4, do: 1500, else: 65_535)})
        ),
        :accepted,
        nil,
        mavsdk: @no_method
      ),
      row(
        "manual_control",
        %{throttle: 0.5, hold: 0.5},
        message("manual_control", %{x: 0, y: 0, z: 500, r: 0, buttons: 0}),
        :accepted,
        nil,
        mavsdk: {"manual_control.set_manual_control_input", [0.0, 0.0, 0.5, 0.0]}
      ),
      row(
        "hold",
        %{},
        by.(long("DO_SET_MODE", [1, 17]), long("DO_SET_MODE", [1, 4, 3])),
        :completed,
        0,
        mavsdk: "action.hold",
        does: &(&1.mode in ~w(BRAKE LOITER AUTO_LOITER))
      )
    ]
  end

  defp target(frame, mask, fields) do
    names = ~w(vx vy vz afx afy afz yaw yaw_rate time_boot_ms)a
    places = if is_map_key(fields, :alt), do: [], else: ~w(x y z)a

    Map.new(names ++ places, &{&1, 0})
    |> Map.merge(%{coordinate_frame: frame, type_mask: mask})
    |> Map.merge(fields)
  end

  defp mission(by) do
    seq = by.(2, 1)

    [
      row(
        "mission_set_current",
        %{seq: seq},
        by.(long("DO_SET_MISSION_CURRENT", [seq]), message("mission_set_current", %{seq: seq})),
        :completed,
        by.(0, nil),
        mavsdk: ["mission_raw.download_mission", {"mission_raw.set_current_mission_item", [seq]}],
        hears: "mission_set_current",
        does: &(&1.mission.current == seq)
      ),
      row("mission_start", %{}, long("MISSION_START", []), :completed, 0,
        mavsdk: "mission_raw.start_mission",
        does: &(&1.mode in ~w(AUTO AUTO_MISSION))
      ),
      row(
        "mission_pause",
        %{},
        by.(long("DO_PAUSE_CONTINUE", [0]), long("DO_SET_MODE", [1, 4, 3])),
        by.(:accepted, :completed),
        0,
        mavsdk: "mission_raw.pause_mission",
        does: &(&1.groundspeed < 0.5)
      ),
      row(
        "resume",
        %{},
        by.(long("DO_PAUSE_CONTINUE", [1]), long("MISSION_START", [])),
        by.(:accepted, :completed),
        0,
        mavsdk: "mission_raw.start_mission",
        does: &(&1.groundspeed > 1 and &1.mode in ~w(AUTO AUTO_MISSION))
      ),
      row("jump", %{tag: 1}, long("DO_JUMP_TAG", [1]), :rejected, 3, mavsdk: @no_method),
      row("land_start", %{}, long("DO_LAND_START", []), :rejected, 3, mavsdk: @no_method)
    ]
  end

  defp ends(by) do
    [
      row("rtl", %{}, long("NAV_RETURN_TO_LAUNCH", []), :completed, 0,
        mavsdk: "action.return_to_launch",
        does: &(&1.mode in ~w(RTL AUTO_RTL))
      ),
      row(
        "land",
        %{},
        long("NAV_LAND", [0, 0, 0, by.(0, nil), by.(0, nil), by.(0, nil), by.(0, nil)]),
        :completed,
        0,
        mavsdk: "action.land",
        does: &(not &1.armed)
      ),
      armable(by),
      arm(),
      row("force_disarm", %{}, long("COMPONENT_ARM_DISARM", [0, 21_196]), :completed, 0,
        mavsdk: "action.kill",
        does: &(not &1.armed)
      ),
      arm(),
      row("terminate", %{}, long("DO_FLIGHTTERMINATION", [1]), by.(:accepted, :rejected), by.(0, 2),
        mavsdk: "action.terminate",
        result: by.("SUCCESS", "COMMAND_DENIED"),
        does: &(not &1.armed)
      ),
      row("force_disarm", %{}, long("COMPONENT_ARM_DISARM", [0, 21_196]), :completed, 0,
        mavsdk: "action.kill",
        does: &(not &1.armed),
        # Until the gateway has heard it: reboot needs a disarmed vehicle.
        lasts_s: 5
      ),
      row("reboot", %{}, long("PREFLIGHT_REBOOT_SHUTDOWN", [1]), :completed, 0,
        mavsdk: "action.reboot",
        does: &(&1.boots == 2)
      )
    ]
  end
end
