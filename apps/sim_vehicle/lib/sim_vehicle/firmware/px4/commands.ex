defmodule SimVehicle.Firmware.Px4.Commands do
  @moduledoc """
  COMMAND_LONG and COMMAND_INT as PX4 1.17.0 answers them: mode changes twice, some commands never, refusals with an event.
  """

  import MavCodec.Command
  import MavCodec.MessageId

  alias MavCodec.Enums.MavResult
  alias MavCodec.Messages, as: M
  alias SimVehicle.{Flight, Params, Vehicle}
  alias SimVehicle.Firmware.Px4
  alias SimVehicle.Physics.{Battery, Geo}
  alias SimVehicle.Services.{Command, Requests, Telemetry}
  alias SimVehicle.Flight.Goal
  alias SimVehicle.Firmware.Px4.{Arming, Events, Modes}

  @accepted MavResult.value(:MAV_RESULT_ACCEPTED)
  @temporarily_rejected MavResult.value(:MAV_RESULT_TEMPORARILY_REJECTED)
  @denied MavResult.value(:MAV_RESULT_DENIED)
  @unsupported MavResult.value(:MAV_RESULT_UNSUPPORTED)
  @failed MavResult.value(:MAV_RESULT_FAILED)

  # Known to PX4 1.17 and never answered: a gimbal's control and a VTOL's transition without either.
  @silent cmds(~w(DO_MOUNT_CONTROL DO_VTOL_TRANSITION)a)
  # Accepted without a visible effect.
  @shrugged cmds(~w(
    RUN_PREARM_CHECKS REQUEST_PROTOCOL_VERSION DO_SET_ROI_LOCATION DO_SET_ROI_NONE
    DO_GIMBAL_MANAGER_PITCHYAW DO_GIMBAL_MANAGER_CONFIGURE DO_TRIGGER_CONTROL DO_SET_SERVO
    DO_SET_ACTUATOR
  )a)
  # The circuit breaker that disables flight termination.
  @termination_off 121_212
  # The commander runs in a thread of its own.
  @commander_us 5_000

  @doc "Carries out a command that is addressed to the vehicle."
  @spec command(Vehicle.t(), Command.t()) :: Vehicle.t()
  def command(v, command), do: v |> Arming.heard(command) |> run(command, command.id)

  defp run(v, c, cmd(:COMPONENT_ARM_DISARM)) do
    case {Command.p(c, 1, nil), Command.p(c, 2)} do
      {p1, _force} when p1 == 1.0 -> Arming.arm(v, c)
      {p1, force} when p1 == 0.0 -> Arming.disarm(v, c, force)
      {p1, _force} -> arm_argument(v, p1 || :nan)
    end
  end

  # 1.17.0 accepts at once, and sends the commander's result some milliseconds later. An unknown main mode
  # changes nothing, and so is "accepted" the second time as well.
  defp run(v, c, cmd(:DO_SET_MODE)) do
    {main, sub} = {trunc(Command.p(c, 2)), trunc(Command.p(c, 3))}
    v = Vehicle.ack(v, c, @accepted)
    {result, v} = if Modes.main?(main), do: Modes.request(v, main, sub), else: {@accepted, v}
    ack_later(v, c, result)
  end

  # The altitude is above the sea.
  defp run(v, c, cmd(:NAV_TAKEOFF)) do
    if Vehicle.positioned?(v) do
      {_lat, _lon, alt} = Command.location(c)
      v = Vehicle.ack(v, c, @accepted)
      v |> Vehicle.put_own(:takeoff_alt, alt) |> Modes.enter("AUTO_TAKEOFF")
    else
      Vehicle.ack(v, c, @temporarily_rejected)
    end
  end

  defp run(v, c, cmd(:NAV_LAND)) do
    if Modes.available?(v, "AUTO_LAND") do
      v
      |> Events.emit(:landing_here, [], {6, "Landing at current position"})
      |> Vehicle.ack(c, @accepted)
      |> Modes.enter("AUTO_LAND")
    else
      Vehicle.ack(v, c, @temporarily_rejected)
    end
  end

  defp run(v, c, cmd(:NAV_LOITER_UNLIM)), do: mode(v, c, "AUTO_LOITER")
  defp run(v, c, cmd(:NAV_RETURN_TO_LAUNCH)), do: mode(v, c, "AUTO_RTL")

  defp run(v, c, cmd(:DO_REPOSITION)) do
    {lat, lon, alt} = Command.location(c)

    cond do
      not Vehicle.positioned?(v) -> Vehicle.ack(v, c, @temporarily_rejected)
      not v.airborne -> Vehicle.ack(v, c, @accepted)
      true -> reposition(v, c, lat, lon, alt)
    end
  end

  defp run(%{airborne: true} = v, c, cmd(:DO_ORBIT)) do
    {lat, lon, alt} = Command.location(c)
    {n, e} = if lat && lon, do: Geo.to_local(v.origin, lat, lon), else: {v.kin.n, v.kin.e}
    radius = min(max(abs(Command.p(c, 1, 10.0)), 1.0), 1000.0)
    d = if alt, do: v.origin.alt - alt, else: v.kin.d
    v = v |> Vehicle.ack(c, @accepted) |> Modes.enter("ORBIT")
    goal = Goal.orbit(n, e, d, radius, min(max(abs(Command.p(c, 2, 3.0)), 0.5), 10.0))
    v |> Flight.go(goal) |> Vehicle.put_own(:orbit, goal)
  end

  defp run(v, c, cmd(:DO_ORBIT)), do: Vehicle.ack(v, c, @temporarily_rejected)

  defp run(v, c, cmd(:DO_CHANGE_SPEED)) do
    speed = Command.p(c, 2, -1.0)
    v = Vehicle.ack(v, c, @accepted)

    if speed > 0,
      do: %{v | limits: %{v.limits | speed: min(speed, Params.get(v.params, "MPC_XY_VEL_MAX"))}},
      else: v
  end

  # Any latitude is accepted, and shown.
  defp run(v, c, cmd(:DO_SET_HOME)) do
    {lat, lon, alt} = if Command.p(c, 1) == 1.0, do: here(v), else: Command.location(c)

    if lat && lon && alt,
      do: %{v | home: %{lat: lat, lon: lon, alt: alt * 1.0}} |> Vehicle.ack(c, @accepted),
      else: Vehicle.ack(v, c, @denied)
  end

  defp run(v, c, cmd(:MISSION_START)) do
    if Modes.mission?(v),
      do: mode(v, c, "AUTO_MISSION"),
      else:
        v
        |> Vehicle.ack(c, @denied)
        |> Events.emit(:mission_denied, [], {2, "Mission start denied! No valid mission"})
  end

  defp run(v, c, cmd(:DO_FLIGHTTERMINATION)) do
    if Params.get(v.params, "CBRK_FLIGHTTERM") == @termination_off or Command.p(c, 1) <= 0.5,
      do: Vehicle.ack(v, c, @denied),
      else: v |> Vehicle.ack(c, @accepted) |> Arming.stop(1)
  end

  # Calibration of the gyros takes a second, that of the accelerometer waits to be turned; others are over at once.
  defp run(%{armed: false} = v, c, cmd(:PREFLIGHT_CALIBRATION)) do
    if Arming.calibrating?(v) do
      Vehicle.ack(v, c, @temporarily_rejected)
    else
      v = Vehicle.ack(v, c, @accepted)

      cond do
        Command.p(c, 1) == 1.0 -> Arming.calibrate(v, "gyro")
        Command.p(c, 5) == 1.0 -> Arming.calibrate(v, "accel")
        true -> v
      end
    end
  end

  defp run(v, c, id) when id in cmds(~w(PREFLIGHT_CALIBRATION PREFLIGHT_STORAGE)a),
    do: Vehicle.ack(v, c, if(v.armed, do: @temporarily_rejected, else: @accepted))

  defp run(v, c, cmd(:PREFLIGHT_REBOOT_SHUTDOWN)) do
    cond do
      v.armed -> Vehicle.ack(v, c, @denied)
      Command.p(c, 1) == 1.0 -> v |> Vehicle.ack(c, @accepted) |> Vehicle.reboot()
      true -> Vehicle.ack(v, c, @denied)
    end
  end

  defp run(v, c, cmd(:ACTUATOR_TEST)), do: Vehicle.ack(v, c, @denied)

  # The answer for the battery is broadcast; other units give no answer.
  defp run(v, c, cmd(:INJECT_FAILURE)) do
    case {trunc(Command.p(c, 1)), trunc(Command.p(c, 2))} do
      {100, 1} -> v |> broadcast_ack(c) |> empty() |> Px4.failsafe(:battery_critical, true)
      {100, 0} -> v |> broadcast_ack(c) |> Px4.failsafe(:battery_critical, false)
      {4, 1} -> v |> broadcast_ack(c) |> Px4.failsafe(:gps, true)
      {4, 0} -> v |> broadcast_ack(c) |> Px4.failsafe(:gps, false)
      _unknown_unit -> v
    end
  end

  defp run(v, c, cmd(:SET_MESSAGE_INTERVAL)), do: Requests.set_interval(v, c, Px4.streamed())

  defp run(v, c, cmd(:GET_MESSAGE_INTERVAL)),
    do: v |> Vehicle.emit(Requests.interval(v, c, Px4.streamed())) |> Vehicle.ack(c, @accepted)

  # The message comes before the acknowledgement.
  defp run(v, c, cmd(:REQUEST_MESSAGE)) do
    id = trunc(Command.p(c, 1))

    case requested(v, c, id) do
      nil ->
        Vehicle.ack(v, c, if(id in Px4.streamed(), do: @failed, else: @denied))

      messages ->
        messages |> List.wrap() |> Enum.reduce(v, &Vehicle.emit(&2, &1)) |> Vehicle.ack(c, @accepted)
    end
  end

  defp run(v, c, cmd(:REQUEST_AUTOPILOT_CAPABILITIES)),
    do: v |> Vehicle.emit(Telemetry.message(v, id(AutopilotVersion))) |> Vehicle.ack(c, @accepted)

  defp run(v, _c, id) when id in @silent, do: v
  defp run(v, c, id) when id in @shrugged, do: Vehicle.ack(v, c, @accepted)
  defp run(v, c, _unknown), do: Vehicle.ack(v, c, @unsupported)

  defp requested(_v, c, id(AvailableModes)), do: Modes.available(trunc(Command.p(c, 2)))

  defp requested(v, _c, id),
    do:
      if(id in Px4.streamed() or id in [id(AutopilotVersion), id(ProtocolVersion), id(ComponentMetadata)],
        do: Telemetry.message(v, id)
      )

  defp mode(v, c, name) do
    {result, changed} = Modes.change(v, name)
    insert_ack(v, changed, c, result)
  end

  # The acknowledgement goes before the messages of the mode change.
  defp insert_ack(before, changed, c, result) do
    said = Enum.drop(changed.out, -length(before.out))
    acked = Vehicle.ack(%{changed | out: before.out}, c, result)
    %{acked | out: said ++ acked.out}
  end

  # Only the text.
  defp arm_argument(v, p1) do
    shown = if is_number(p1), do: :erlang.float_to_binary(p1 * 1.0, decimals: 3), else: "nan"
    Events.emit(v, :arm_argument, [p1], {2, "Unsupported ARM_DISARM param: #{shown}"})
  end

  defp reposition(v, c, lat, lon, alt) do
    v = v |> Vehicle.ack(c, @accepted) |> Modes.enter("AUTO_LOITER")
    {n, e} = if lat && lon, do: Geo.to_local(v.origin, lat, lon), else: {v.kin.n, v.kin.e}
    d = if alt, do: v.origin.alt - alt - relative(v, c), else: v.kin.d
    Flight.go(v, Goal.goto(n, e, d, yaw: Command.p(c, 4, nil)))
  end

  defp relative(v, %{int?: true, frame: frame}) when frame in [3, 6], do: (v.home || v.origin).alt
  defp relative(_v, _c), do: 0.0

  defp here(v) do
    {lat, lon} = Vehicle.position(v)
    {lat, lon, Vehicle.altitude(v)}
  end

  defp ack_later(v, %{source: :pilot}, _result), do: v

  defp ack_later(v, c, result) do
    {system, component} = c.source

    Vehicle.later(v, @commander_us, %M.CommandAck{
      command: c.id,
      result: result,
      target_system: system,
      target_component: component
    })
  end

  defp empty(v), do: %{v | battery: Battery.set_remaining(v.battery, 0.02)}
  defp broadcast_ack(v, c), do: Vehicle.emit(v, %M.CommandAck{command: c.id, result: @accepted})
end
