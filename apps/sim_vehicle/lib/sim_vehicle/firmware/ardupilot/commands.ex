defmodule SimVehicle.Firmware.Ardupilot.Commands do
  @moduledoc """
  COMMAND_LONG and COMMAND_INT as ArduCopter answers them: it acknowledges every command once, to its sender, and unknown ones
  with UNSUPPORTED.
  """

  import MavCodec.Command
  import MavCodec.MessageId

  alias MavCodec.Enums.MavResult
  alias SimVehicle.{Flight, Vehicle}
  alias SimVehicle.Firmware.Ardupilot
  alias SimVehicle.Physics.Geo
  alias SimVehicle.Services.{Command, Requests, Telemetry}
  alias SimVehicle.Firmware.Ardupilot.{Arming, Boot, Calibration, Modes}
  alias SimVehicle.Flight.{Goal, Mission}

  @accepted MavResult.value(:MAV_RESULT_ACCEPTED)
  @temporarily_rejected MavResult.value(:MAV_RESULT_TEMPORARILY_REJECTED)
  @denied MavResult.value(:MAV_RESULT_DENIED)
  @unsupported MavResult.value(:MAV_RESULT_UNSUPPORTED)
  @failed MavResult.value(:MAV_RESULT_FAILED)
  @unsupported_frame MavResult.value(:MAV_RESULT_COMMAND_UNSUPPORTED_MAV_FRAME)

  @change_mode 1
  @global_frames [0, 3, 5, 6, 10, 11]
  @relative_frames [3, 6]

  # Accepted without an effect: regions of interest, mounts, cameras, servos, relays, grippers, sprayers.
  @shrugged cmds(~w(
    DO_SET_SERVO DO_SET_RELAY DO_SET_ROI_LOCATION DO_SET_ROI_NONE DO_SET_ROI DO_MOUNT_CONTROL
    DO_SPRAYER DO_GIMBAL_MANAGER_PITCHYAW DO_GIMBAL_MANAGER_CONFIGURE
  )a)

  @doc "Carries out a command that is addressed to the vehicle."
  @spec command(Vehicle.t(), Command.t()) :: Vehicle.t()
  def command(v, command) do
    # It cannot be disarmed or rebooted then.
    if Calibration.holds?(v), do: Vehicle.ack(v, command, @failed), else: run(v, command, command.id)
  end

  # The acknowledgement comes before the texts, which wait in a queue.
  defp run(v, c, cmd(:COMPONENT_ARM_DISARM)) do
    decision =
      case {Command.p(c, 1, nil), Command.p(c, 2)} do
        {p1, force} when p1 == 1.0 -> Arming.arm(v, force)
        {p1, force} when p1 == 0.0 -> Arming.disarm(v, force)
        _neither -> {@unsupported, & &1}
      end

    {result, then} = decision
    v |> Vehicle.ack(c, result) |> then.()
  end

  defp run(v, c, cmd(:DO_SET_MODE)) do
    {result, v} = Modes.request(v, trunc(Command.p(c, 1)), trunc(Command.p(c, 2)))
    Vehicle.ack(v, c, result)
  end

  defp run(v, c, cmd(:NAV_TAKEOFF)) do
    if c.int? and c.frame not in @relative_frames do
      Vehicle.ack(v, c, @denied)
    else
      {result, v} = takeoff(v, Command.p(c, 7))
      Vehicle.ack(v, c, result)
    end
  end

  defp run(v, c, cmd(:NAV_LOITER_UNLIM)), do: mode(v, c, "LOITER")
  defp run(v, c, cmd(:NAV_RETURN_TO_LAUNCH)), do: mode(v, c, "RTL")
  defp run(v, c, cmd(:NAV_LAND)), do: mode(v, c, "LAND")

  defp run(v, c, cmd(:MISSION_START)) do
    case Modes.change(v, "AUTO") do
      {@accepted, %{armed: true} = v} -> v |> Flight.mission() |> Vehicle.ack(c, @accepted)
      {result, v} -> Vehicle.ack(v, c, result)
    end
  end

  defp run(v, c, cmd(:CONDITION_YAW)) do
    [angle, relative] = [Command.p(c, 1, nil), Command.p(c, 4)]

    if angle != nil and angle >= 0 and angle <= 360 and relative in [0.0, 1.0] do
      v |> turn(angle * :math.pi() / 180, relative == 1.0, Command.p(c, 3)) |> Vehicle.ack(c, @accepted)
    else
      Vehicle.ack(v, c, @failed)
    end
  end

  # Ground speed, climb, descent.
  defp run(v, c, cmd(:DO_CHANGE_SPEED)) do
    speed = Command.p(c, 2)
    key = %{0.0 => :speed, 1.0 => :speed, 2.0 => :up, 3.0 => :down}[Command.p(c, 1) * 1.0]

    cond do
      speed <= 0 -> Vehicle.ack(v, c, @failed)
      key == nil -> Vehicle.ack(v, c, @failed)
      true -> Vehicle.ack(%{v | limits: Map.put(v.limits, key, min(speed, 30.0))}, c, @accepted)
    end
  end

  defp run(v, c, cmd(:DO_SET_HOME)), do: set_home(v, c, Command.p(c, 1))

  defp run(v, c, cmd(:DO_REPOSITION)) do
    {lat, lon, alt} = Command.location(c)
    change? = Bitwise.band(trunc(Command.p(c, 2)), @change_mode) != 0

    cond do
      v.mode != "GUIDED" and not change? -> Vehicle.ack(v, c, @denied)
      c.int? and c.frame not in @global_frames -> Vehicle.ack(v, c, @unsupported_frame)
      not on_globe?(lat, lon) or alt == nil -> Vehicle.ack(v, c, @denied)
      true -> reposition(v, c, lat, lon, alt)
    end
  end

  defp run(v, c, cmd(:DO_PAUSE_CONTINUE)) do
    case {Command.p(c, 1), v.mode} do
      {p1, mode} when p1 == 0.0 and mode in ["AUTO", "GUIDED"] -> v |> pause() |> Vehicle.ack(c, @accepted)
      {p1, "AUTO"} when p1 == 1.0 -> v |> resume() |> Vehicle.ack(c, @accepted)
      {p1, "GUIDED"} when p1 == 1.0 -> Vehicle.ack(v, c, @accepted)
      {p1, _mode} when p1 in [0.0, 1.0] -> Vehicle.ack(v, c, @failed)
      _other -> Vehicle.ack(v, c, @denied)
    end
  end

  defp run(v, c, cmd(:DO_SET_MISSION_CURRENT)) do
    {ok?, v} = Mission.set_current(v, trunc(Command.p(c, 1)))

    if ok?,
      do: v |> Vehicle.emit(Telemetry.message(v, id(MissionCurrent))) |> Vehicle.ack(c, @accepted),
      else: Vehicle.ack(v, c, @failed)
  end

  defp run(v, c, cmd(:DO_FLIGHTTERMINATION)) do
    if Command.p(c, 1) > 0.5,
      do: v |> Arming.stop() |> Vehicle.ack(c, @accepted),
      else: Vehicle.ack(v, c, @failed)
  end

  # Not fitted.
  defp run(v, c, cmd(:DO_PARACHUTE)), do: Vehicle.ack(v, c, @failed)

  defp run(v, c, cmd(:DO_FENCE_ENABLE)) do
    if Command.p(c, 1) in [0.0, 1.0, 2.0] do
      {:ok, params} =
        SimVehicle.Params.put(v.params, "FENCE_ENABLE", if(Command.p(c, 1) == 1.0, do: 1, else: 0))

      Vehicle.ack(%{v | params: params}, c, @accepted)
    else
      Vehicle.ack(v, c, @failed)
    end
  end

  defp run(v, c, cmd(:PREFLIGHT_CALIBRATION)), do: Calibration.command(v, c)
  defp run(v, c, cmd(:ACCELCAL_VEHICLE_POS)), do: Calibration.position(v, c)
  # Whether magnetometers are calibrated or not.
  defp run(v, c, cmd(:DO_CANCEL_MAG_CAL)), do: Vehicle.ack(v, c, @accepted)

  # Acknowledged first.
  defp run(v, c, cmd(:PREFLIGHT_REBOOT_SHUTDOWN)) do
    cond do
      v.armed -> Vehicle.ack(v, c, @failed)
      Command.p(c, 1) in [1.0, 3.0] -> v |> Vehicle.ack(c, @accepted) |> Vehicle.reboot()
      true -> Vehicle.ack(v, c, @unsupported)
    end
  end

  defp run(%{armed: true} = v, c, cmd(:RUN_PREARM_CHECKS)), do: Vehicle.ack(v, c, @temporarily_rejected)

  defp run(v, c, cmd(:RUN_PREARM_CHECKS)) do
    v = Vehicle.ack(v, c, @accepted)
    Enum.reduce(Arming.reasons(v), v, &Vehicle.text(&2, 2, "PreArm: " <> &1))
  end

  defp run(%{home: nil} = v, c, cmd(:GET_HOME_POSITION)), do: Vehicle.ack(v, c, @failed)

  defp run(v, c, cmd(:GET_HOME_POSITION)),
    do: v |> Vehicle.ack(c, @accepted) |> Vehicle.emit(Telemetry.message(v, id(HomePosition)))

  defp run(v, c, cmd(:SET_MESSAGE_INTERVAL)), do: Requests.set_interval(v, c, Ardupilot.streamed())

  defp run(v, c, cmd(:GET_MESSAGE_INTERVAL)),
    do: v |> Vehicle.emit(Requests.interval(v, c, Ardupilot.streamed())) |> Vehicle.ack(c, @accepted)

  # The acknowledgement first; a message that is not there yet does not come.
  defp run(v, c, cmd(:REQUEST_MESSAGE)) do
    id = trunc(Command.p(c, 1))

    if id in Ardupilot.streamed() do
      v = Vehicle.ack(v, c, @accepted)

      case Telemetry.message(v, id) do
        nil -> v
        message -> Vehicle.emit(v, message)
      end
    else
      Vehicle.ack(v, c, @failed)
    end
  end

  defp run(v, c, cmd(:REQUEST_AUTOPILOT_CAPABILITIES)),
    do: v |> Vehicle.ack(c, @accepted) |> Vehicle.emit(Telemetry.message(v, id(AutopilotVersion)))

  defp run(v, c, cmd(:DO_SEND_BANNER)), do: v |> Vehicle.ack(c, @accepted) |> Boot.banner()
  defp run(v, c, id) when id in @shrugged, do: Vehicle.ack(v, c, @accepted)
  defp run(v, c, _unknown), do: Vehicle.ack(v, c, @unsupported)

  defp mode(v, c, name) do
    {result, v} = Modes.change(v, name)
    Vehicle.ack(v, c, result)
  end

  # Takes off to `alt` metres above home: only armed, on the ground and in a mode that can.
  defp takeoff(%{armed: true, airborne: false, mode: mode} = v, alt)
       when mode in ["GUIDED", "LOITER", "ALT_HOLD"] do
    if alt > Vehicle.relative_altitude(v) + 0.1 do
      from = max(v.now, v.armed_at + round(v.limits.spool * 1.0e6))
      d = v.origin.alt - (v.home || v.origin).alt - alt
      {@accepted, Flight.go(v, Goal.takeoff(v.kin, d, from))}
    else
      {@failed, v}
    end
  end

  defp takeoff(v, _alt), do: {@failed, v}

  defp turn(%{airborne: true, mode: "GUIDED"} = v, angle, relative?, direction) do
    sign = if direction < 0, do: -1, else: 1
    yaw = if relative?, do: v.kin.yaw + sign * angle, else: angle
    k = v.kin

    {n, e, d} =
      case v.flight do
        %{n: n, e: e, d: d} -> {n, e, d}
        _other -> {k.n, k.e, k.d}
      end

    # Practically for ever: no battery lasts an hour.
    Flight.go(v, Map.put(Goal.wait(n, e, d, 3_600_000_000), :yaw, Geo.wrap_pi(yaw)))
  end

  defp turn(v, _angle, _relative?, _direction), do: v

  defp set_home(v, c, p1) when p1 == 1.0 do
    if Vehicle.positioned?(v) do
      {lat, lon} = Vehicle.position(v)
      v |> home(%{lat: lat, lon: lon, alt: Vehicle.altitude(v)}) |> Vehicle.ack(c, @accepted)
    else
      Vehicle.ack(v, c, @failed)
    end
  end

  defp set_home(v, c, _p1) do
    {lat, lon, alt} = Command.location(c)

    cond do
      c.int? and c.frame not in @global_frames -> Vehicle.ack(v, c, @unsupported_frame)
      not on_globe?(lat, lon) or alt == nil -> Vehicle.ack(v, c, @denied)
      v.home == nil -> Vehicle.ack(v, c, @failed)
      true -> v |> home(%{lat: lat, lon: lon, alt: alt * 1.0}) |> Vehicle.ack(c, @accepted)
    end
  end

  defp home(v, home) do
    v = %{v | home: home} |> Vehicle.put_own(:home_locked, true)
    Vehicle.emit(v, Telemetry.message(v, id(HomePosition)))
  end

  defp reposition(v, c, lat, lon, alt) do
    case Modes.change(v, "GUIDED") do
      {@accepted, v} ->
        {n, e} = Geo.to_local(v.origin, lat, lon)
        base = if c.int? and c.frame not in [0, 5], do: (v.home || v.origin).alt, else: 0.0
        goal = Goal.goto(n, e, v.origin.alt - base - alt)
        v = if v.airborne, do: %{Flight.go(v, goal) | landed: :in_air}, else: v
        Vehicle.ack(v, c, @accepted)

      {result, v} ->
        Vehicle.ack(v, c, result)
    end
  end

  defp pause(%{airborne: false} = v), do: v
  defp pause(v), do: Flight.hold(v)

  defp resume(%{airborne: false} = v), do: v
  defp resume(v), do: Flight.mission(v)

  defp on_globe?(lat, lon),
    do: lat != nil and lon != nil and abs(lat) <= 900_000_000 and abs(lon) <= 1_800_000_000
end
