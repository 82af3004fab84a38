defmodule SimVehicle.Firmware.Px4 do
  @moduledoc """
  PX4 1.17.0 according to its recordings.

  Two acknowledgements for a mode change, commands that are never answered, texts with a tab beside events, texts held back while
  no ground station is heard, internal commands that leak out, parameters as bytes in floats with `_HASH_CHECK`, mission
  items that are reported as reached again and again.
  """

  @behaviour SimVehicle.Firmware.Personality

  import MavCodec.Command
  import MavCodec.MessageId

  alias MavCodec.Messages, as: M
  alias SimVehicle.{Flight, Params, Vehicle}
  alias SimVehicle.Services.{Requests, Setpoints, Telemetry}
  alias SimVehicle.Flight.Mission
  alias SimVehicle.Firmware.Px4.{Arming, Commands, Events, Failsafes, Missions, Modes, Reports}

  @streamed [
    id(Heartbeat),
    id(SysStatus),
    id(SystemTime),
    id(GpsRawInt),
    id(ScaledPressure),
    id(Attitude),
    id(AttitudeQuaternion),
    id(LocalPositionNed),
    id(GlobalPositionInt),
    id(ServoOutputRaw),
    id(MissionCurrent),
    id(GpsGlobalOrigin),
    id(RcChannels),
    id(VfrHud),
    id(PositionTargetLocalNed),
    id(PositionTargetGlobalInt),
    id(HighresImu),
    id(Altitude),
    id(BatteryStatus),
    id(AutopilotVersion),
    id(EstimatorStatus),
    id(Vibration),
    id(HomePosition),
    id(ExtendedSysState),
    id(ProtocolVersion),
    id(OrbitExecutionStatus),
    id(CurrentEventSequence),
    id(AvailableModes),
    id(CurrentMode),
    id(Ping)
  ]

  # Sent without a request after every boot.
  @unasked ~w(CAL_ACC0_ID CAL_BARO0_ID CAL_BARO0_OFF CAL_BARO0_PRIO CAL_GYRO0_ID CAL_MAG0_ID CAL_MAG0_PRIO
              SENS_BOARD_X_OFF SENS_DPRES_OFF SYS_AUTOCONFIG SYS_AUTOSTART)

  @impl SimVehicle.Firmware.Personality
  def params, do: Params.new(Params.Px4.definitions(), :bytewise)

  @impl SimVehicle.Firmware.Personality
  def plan_style, do: :px4

  @impl SimVehicle.Firmware.Personality
  def rates do
    %{
      id(Heartbeat) => 1,
      id(SysStatus) => 1,
      id(Ping) => 0.1,
      id(GpsRawInt) => 5,
      id(ScaledPressure) => 1,
      id(Attitude) => 10,
      id(AttitudeQuaternion) => 10,
      id(LocalPositionNed) => 10,
      id(GlobalPositionInt) => 10,
      id(ServoOutputRaw) => 4,
      id(MissionCurrent) => 1,
      id(VfrHud) => 4,
      id(PositionTargetLocalNed) => 4,
      id(PositionTargetGlobalInt) => 1,
      id(Altitude) => 1,
      id(BatteryStatus) => 0.5,
      id(EstimatorStatus) => 0.5,
      id(Vibration) => 0.1,
      id(HomePosition) => 0.5,
      id(ExtendedSysState) => 1,
      id(OrbitExecutionStatus) => 2,
      id(CurrentEventSequence) => 0.33,
      id(CurrentMode) => 0.5
    }
  end

  @impl SimVehicle.Firmware.Personality
  def limits(params) do
    %{
      speed: positive(params, "MPC_XY_CRUISE"),
      up: positive(params, "MPC_Z_V_AUTO_UP"),
      down: positive(params, "MPC_Z_V_AUTO_DN"),
      takeoff: positive(params, "MPC_TKO_SPEED"),
      land_fast: positive(params, "MPC_Z_V_AUTO_DN"),
      land_slow: positive(params, "MPC_LAND_SPEED"),
      land_slow_below: Params.get(params, "MPC_LAND_ALT2"),
      radius: positive(params, "NAV_ACC_RAD"),
      orbit: 10.0,
      rtl_alt: Params.get(params, "RTL_RETURN_ALT"),
      rtl_wait: 0.0,
      # Less than MPC_ACC_HOR, as the real one builds acceleration up gently.
      accel: 1.25,
      spool: 1.0
    }
  end

  @impl SimVehicle.Firmware.Personality
  def boot(v) do
    v = %{v | mode: "AUTO_LOITER"}
    v = Enum.reduce(@unasked, v, &Vehicle.emit(&2, Requests.param_value(&2, &1)))
    Events.emit(v, :log_opened, log_name(v))
  end

  @impl SimVehicle.Firmware.Personality
  def tick(v),
    do: v |> home() |> Arming.tick() |> Missions.tick() |> Failsafes.tick() |> Requests.tick_params()

  # A command for another component is not answered at all.
  @impl SimVehicle.Firmware.Personality
  def addressed?(v, {system, component}), do: system in [0, v.system] and component in [0, v.component]

  @impl SimVehicle.Firmware.Personality
  defdelegate command(v, command), to: Commands

  @impl SimVehicle.Firmware.Personality
  defdelegate text(v, severity, text), to: Events

  @impl SimVehicle.Firmware.Personality
  def gcs_heard(v, _system), do: v |> Events.release() |> Failsafes.gcs_heard()

  @impl SimVehicle.Firmware.Personality
  defdelegate failsafe(v, kind, on?), to: Failsafes, as: :set

  @impl SimVehicle.Firmware.Personality
  defdelegate plan_changed(v, kind, type), to: Missions

  @impl SimVehicle.Firmware.Personality
  defdelegate mission_rtl(v), to: Missions, as: :rtl

  @impl SimVehicle.Firmware.Personality
  def flight_event(v, :airborne) do
    v = Vehicle.put_own(%{v | landed: :taking_off}, :landed_at, nil)
    Events.emit(v, :takeoff, [], {6, "Takeoff detected"})
  end

  def flight_event(v, :takeoff_done) do
    v = %{v | landed: :in_air} |> Vehicle.put_own(:takeoff_alt, nil) |> Vehicle.put_own(:task, :done)
    if v.mode == "AUTO_TAKEOFF", do: Modes.enter(v, "AUTO_LOITER"), else: v
  end

  def flight_event(v, {:phase, :land}) do
    v = %{v | landed: :landing}
    if v.mode == "AUTO_RTL", do: Events.emit(v, :return_landing, [], {6, "RTL: land at destination"}), else: v
  end

  def flight_event(v, {:touchdown, _speed}), do: v

  def flight_event(v, :landed) do
    %{v | landed: :on_ground}
    |> Vehicle.put_own(:landed_at, if(v.armed, do: v.now))
    |> Vehicle.put_own(:task, :done)
    |> Events.emit(:landing_detected, [], {6, "Landing detected"})
  end

  def flight_event(v, {:item, _item}), do: %{v | landed: if(v.airborne, do: :in_air, else: v.landed)}
  def flight_event(v, {:reached, _kind, seq}), do: Missions.reached(%{v | landed: :in_air}, seq)
  def flight_event(v, :mission_done), do: Missions.done(v)
  def flight_event(v, _event), do: v

  @impl SimVehicle.Firmware.Personality
  def message(v, %M.ParamRequestList{}, _source), do: Requests.list_params(v, ["_HASH_CHECK"], 1000)

  def message(v, %M.ParamRequestRead{param_index: -1, param_id: "_HASH_CHECK"}, _source),
    do: Vehicle.emit(v, Requests.param_value(v, "_HASH_CHECK"))

  # An unknown parameter is not answered by this version.
  def message(v, %M.ParamRequestRead{} = m, _source) do
    case Requests.wanted_param(v, m) do
      nil -> v
      name -> Vehicle.emit(v, Requests.param_value(v, name))
    end
  end

  # Answered, and broadcast once more.
  def message(v, %M.ParamSet{} = m, _source) do
    case Requests.set_param(v, m) do
      {:ok, v} ->
        value = Requests.param_value(v, m.param_id)
        v |> Vehicle.emit(value) |> Vehicle.later(20_000, value) |> param_changed(m.param_id)

      {:error, _refused} ->
        v
    end
  end

  def message(v, %M.SetMode{custom_mode: custom}, {system, component}) do
    # SET_MODE is treated as the command of the same meaning, without its own answer.
    main = Bitwise.band(Bitwise.bsr(custom, 16), 0xFF)
    sub = Bitwise.band(Bitwise.bsr(custom, 24), 0xFF)
    params = {1.0, main * 1.0, sub * 1.0, 0.0, 0.0, 0.0, 0.0}

    Commands.command(v, %SimVehicle.Services.Command{
      id: cmd(:DO_SET_MODE),
      params: params,
      source: {system, component}
    })
  end

  def message(v, %M.MissionSetCurrent{seq: seq}, _source) do
    {_ok?, v} = Mission.set_current(v, seq)
    v
  end

  def message(v, %module{} = m, _source)
      when module in [M.SetPositionTargetLocalNed, M.SetPositionTargetGlobalInt] do
    case Setpoints.by_axis(v, m, 60_000_000) do
      {:ok, goal} -> v |> setpoint_heard() |> offboard(goal)
      :ignored -> v
    end
  end

  def message(v, %M.Timesync{} = m, source), do: Requests.timesync(v, m, source)

  def message(v, %M.Ping{target_system: 0} = m, {system, component}) do
    Vehicle.emit(v, %{m | target_system: system, target_component: component})
  end

  def message(v, %M.RequestEvent{} = m, source), do: Events.again(v, m, source)
  def message(v, _message, _source), do: v

  @doc "The ids that this firmware streams."
  @spec streamed() :: [non_neg_integer]
  def streamed, do: @streamed

  @impl SimVehicle.Firmware.Personality
  defdelegate telemetry(v, id), to: Reports, as: :message

  # The simulated receiver sees as many satellites as this parameter says.
  defp param_changed(v, "SIM_GPS_USED"), do: Failsafes.set(v, :gps, Params.get(v.params, "SIM_GPS_USED") < 4)
  defp param_changed(v, _name), do: v

  defp setpoint_heard(v) do
    setpoints =
      case Vehicle.own(v, :setpoints) do
        nil -> %{first: v.now, last: v.now}
        stream -> if Modes.steady?(v, stream), do: %{stream | last: v.now}, else: %{first: v.now, last: v.now}
      end

    Vehicle.put_own(v, :setpoints, setpoints)
  end

  defp offboard(%{mode: "OFFBOARD", armed: true, airborne: true} = v, goal), do: Flight.go(v, goal)

  # On the ground a setpoint that wants to go up is how an offboard controller takes off.
  defp offboard(%{mode: "OFFBOARD", armed: true} = v, %{d: d}) when d < -1.0,
    do:
      if(match?(%{do: :takeoff}, v.flight),
        do: v,
        else: v |> Vehicle.put_own(:takeoff_alt, v.origin.alt - d) |> Modes.takeoff()
      )

  defp offboard(v, _goal), do: v

  # Home is known as soon as there is a position of any quality.
  defp home(%{home: nil} = v) do
    if v.now * 4 >= v.ready_us,
      do:
        %{v | home: %{lat: v.origin.lat, lon: v.origin.lon, alt: v.origin.alt}}
        |> then(&Vehicle.emit(&1, Telemetry.message(&1, id(GpsGlobalOrigin)))),
      else: v
  end

  defp home(v), do: v

  defp positive(params, name), do: max(Params.get(params, name), 0.1)

  defp log_name(v) do
    at = DateTime.from_unix!(max(v.epoch, 0), :microsecond)
    [at.year, at.month, at.day, at.hour, at.minute, at.second]
  end
end
