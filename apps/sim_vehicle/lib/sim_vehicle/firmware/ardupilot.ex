defmodule SimVehicle.Firmware.Ardupilot do
  @moduledoc """
  ArduCopter 4.6.3 according to its recordings and source.

  Boot text before the first frame, results of refused commands (FAILED rather than DENIED), STATUSTEXTs, the order of
  answers, mission item 0 = home, disarming by itself, `FS_*` and `BATT_FS_*` failsafes.
  """

  @behaviour SimVehicle.Firmware.Personality

  import MavCodec.MessageId
  import Bitwise

  alias MavCodec.Messages, as: M
  alias SimVehicle.{Params, Vehicle}
  alias SimVehicle.Services.{Requests, Setpoints, Telemetry}
  alias SimVehicle.Firmware.Ardupilot.{Arming, Boot, Calibration, Commands, Events, Failsafes, Modes, Sticks}
  alias SimVehicle.Flight.Mission

  @groups %{
    1 => [id(RawImu), id(ScaledImu2), id(ScaledImu3), id(ScaledPressure), id(ScaledPressure2)],
    2 => [
      id(SysStatus),
      id(PowerStatus),
      id(Meminfo),
      id(MissionCurrent),
      id(GpsRawInt),
      id(NavControllerOutput),
      id(PositionTargetGlobalInt),
      id(FenceStatus)
    ],
    3 => [id(ServoOutputRaw), id(RcChannels)],
    6 => [id(GlobalPositionInt), id(LocalPositionNed)],
    10 => [id(Attitude), id(Ahrs2)],
    11 => [id(VfrHud)],
    12 => [id(Ahrs), id(SystemTime), id(Wind), id(Vibration), id(EkfStatusReport), id(BatteryStatus)]
  }

  @streamed @groups
            |> Map.values()
            |> List.flatten()
            |> Kernel.++([
              id(Heartbeat),
              id(AttitudeQuaternion),
              id(PositionTargetLocalNed),
              id(HomePosition),
              id(ExtendedSysState),
              id(AutopilotVersion),
              id(GpsGlobalOrigin)
            ])
            |> Enum.sort()

  # MAV_PROTOCOL_CAPABILITY bits of 4.6.3; 4.6.3 with type 255 (release) as 8-bit fields.
  @capabilities 64_495
  @version 67_503_103

  @impl SimVehicle.Firmware.Personality
  def params, do: Params.new(Params.Ardupilot.definitions(), :c_cast)

  @impl SimVehicle.Firmware.Personality
  def plan_style, do: :ardupilot

  @impl SimVehicle.Firmware.Personality
  def rates do
    # An operator's horizon wants more than 4 Hz.
    @groups
    |> Map.values()
    |> List.flatten()
    |> Map.new(&{&1, 4})
    |> Map.merge(%{id(Heartbeat) => 1, id(Attitude) => 10})
  end

  @impl SimVehicle.Firmware.Personality
  def limits(params) do
    cm = fn name -> max(Params.get(params, name) / 100, 0.1) end

    %{
      speed: cm.("WPNAV_SPEED"),
      up: cm.("WPNAV_SPEED_UP"),
      down: cm.("WPNAV_SPEED_DN"),
      takeoff: cm.("WPNAV_SPEED_UP"),
      land_fast: cm.("WPNAV_SPEED_DN"),
      land_slow: cm.("LAND_SPEED"),
      land_slow_below: 10.0,
      radius: cm.("WPNAV_RADIUS"),
      orbit: cm.("CIRCLE_RADIUS"),
      rtl_alt: Params.get(params, "RTL_ALT") / 100,
      rtl_wait: Params.get(params, "RTL_LOIT_TIME") / 1000,
      # Less than WPNAV_ACCEL: the real one builds acceleration up gently.
      accel: 2.0,
      spool: 2.9
    }
  end

  @impl SimVehicle.Firmware.Personality
  def boot(v), do: Boot.power_up(v)

  @impl SimVehicle.Firmware.Personality
  def tick(v),
    do: v |> Boot.tick() |> Arming.tick() |> Failsafes.tick() |> Requests.tick_params() |> timesync()

  # ArduPilot also accepts messages for unknown components of its system.
  @impl SimVehicle.Firmware.Personality
  def addressed?(v, {system, _component}), do: system in [0, v.system]

  @impl SimVehicle.Firmware.Personality
  defdelegate command(v, command), to: Commands

  @impl SimVehicle.Firmware.Personality
  def text(v, severity, text) do
    # A text above 50 bytes is sent in chunks with an id; a shorter one has id 0.
    if byte_size(text) > 50,
      do: chunks(v, severity, text),
      else: Vehicle.emit(v, statustext(severity, text, 0, 0))
  end

  @impl SimVehicle.Firmware.Personality
  def gcs_heard(v, system), do: Failsafes.gcs_heard(v, system)

  @impl SimVehicle.Firmware.Personality
  defdelegate flight_event(v, event), to: Events

  @impl SimVehicle.Firmware.Personality
  defdelegate failsafe(v, kind, on?), to: Failsafes, as: :set

  @impl SimVehicle.Firmware.Personality
  def plan_changed(v, kind, 0) do
    v = Mission.reset(v)
    if kind == :stored, do: Vehicle.text(v, 6, "Flight plan received"), else: v
  end

  def plan_changed(v, :stored, 1), do: Vehicle.text(v, 7, "Fence Indexed OK")
  def plan_changed(v, _kind, _type), do: v

  @impl SimVehicle.Firmware.Personality
  def mission_rtl(v), do: {:goal, Modes.rtl(v)}

  @impl SimVehicle.Firmware.Personality
  def message(v, %M.ParamRequestList{}, _source), do: Requests.list_params(v, [], 2000)

  # After a request by name the index is 65535, as in the recordings; an unknown name is ignored.
  def message(v, %M.ParamRequestRead{} = m, _source) do
    case Requests.wanted_param(v, m) do
      nil -> v
      name -> Vehicle.emit(v, Requests.param_value(v, name, if(m.param_index == -1, do: 65_535)))
    end
  end

  def message(v, %M.ParamSet{} = m, _source) do
    case Requests.set_param(v, m) do
      {:ok, v} -> Vehicle.emit(v, Requests.param_value(v, m.param_id, 65_535))
      {:error, :unknown} -> v
      {:error, _refused} -> Vehicle.emit(v, Requests.param_value(v, m.param_id, 65_535))
    end
  end

  def message(v, %M.RequestDataStream{} = m, _source), do: Requests.data_stream(v, m, @groups)

  def message(v, %M.SetMode{} = m, {system, component}) do
    {result, v} = Modes.request(v, m.base_mode, m.custom_mode)

    # The acknowledgement carries the id of the message SET_MODE in place of a command.
    Vehicle.emit(v, %M.CommandAck{
      command: id(SetMode),
      result: result,
      target_system: system,
      target_component: component
    })
  end

  def message(v, %M.MissionSetCurrent{seq: seq}, _source) do
    {ok?, v} = Mission.set_current(v, seq)
    if ok?, do: Vehicle.emit(v, Telemetry.message(v, id(MissionCurrent))), else: v
  end

  def message(%{mode: "GUIDED"} = v, %module{} = m, _source)
      when module in [M.SetPositionTargetLocalNed, M.SetPositionTargetGlobalInt] do
    case Setpoints.whole(v, m, round(Params.get(v.params, "GUID_TIMEOUT") * 1.0e6)) do
      {:ok, goal} when v.airborne and v.armed -> v |> SimVehicle.Flight.go(goal) |> Map.put(:landed, :in_air)
      :stop when v.airborne and v.armed -> SimVehicle.Flight.hold(v)
      _grounded -> v
    end
  end

  def message(v, %M.CommandAck{} = m, _source), do: Calibration.acknowledged(v, m)

  def message(v, %module{} = m, {system, _component}) when module in [M.RcChannelsOverride, M.ManualControl],
    do: Sticks.take(v, m, system, {"FLTMODE_CH", "FLTMODE"}, &elem(Modes.request(&1, 1, &2), 1))

  def message(v, %M.Timesync{} = m, source), do: Requests.timesync(v, m, source)

  def message(v, _message, _source), do: v

  @doc "The ids that this firmware streams."
  @spec streamed() :: [non_neg_integer]
  def streamed, do: @streamed

  @impl SimVehicle.Firmware.Personality
  def telemetry(v, id(Heartbeat)) do
    %M.Heartbeat{
      type: 2,
      autopilot: 3,
      base_mode: base_mode(v),
      custom_mode: Modes.number(v.mode),
      system_status: system_status(v),
      mavlink_version: 3
    }
  end

  def telemetry(v, id(AutopilotVersion)) do
    %M.AutopilotVersion{
      capabilities: @capabilities,
      flight_sw_version: @version,
      flight_custom_version: "92b0cd78"
    }
    |> Map.put(:uid, v.system)
  end

  def telemetry(v, id(ExtendedSysState)),
    do: %M.ExtendedSysState{vtol_state: 3, landed_state: Telemetry.landed_state(v)}

  def telemetry(_v, id(Meminfo)), do: %M.Meminfo{freemem: 65_535, freemem32: 524_288}
  def telemetry(v, id(NavControllerOutput)), do: navigation(v)
  def telemetry(v, id(FenceStatus)), do: fence_status(v)
  def telemetry(_v, id(Ahrs)), do: %M.Ahrs{error_rp: 0.002, error_yaw: 0.007}
  def telemetry(v, id(Wind)), do: if(v.home, do: %M.Wind{direction: -180.0})
  def telemetry(v, id(Ahrs2)), do: if(v.now > 2_800_000, do: ahrs2(v))
  def telemetry(v, id(EkfStatusReport)), do: %M.EkfStatusReport{flags: ekf_flags(v), compass_variance: 0.03}
  def telemetry(_v, _id), do: :common

  defp base_mode(v) do
    81 ||| if(v.armed, do: 128, else: 0) ||| if(Modes.position?(v.mode), do: 8, else: 0)
  end

  # MAV_STATE: 1 boot, 3 standby, 4 active, 5 critical.
  defp system_status(v) do
    cond do
      MapSet.size(v.failsafes) > 0 -> 5
      v.airborne -> 4
      v.now < 2_000_000 -> 1
      true -> 3
    end
  end

  defp navigation(v) do
    %M.NavControllerOutput{
      nav_roll: v.kin.roll * 57.29578,
      nav_pitch: v.kin.pitch * 57.29578,
      nav_bearing: round(v.kin.yaw * 57.29578)
    }
  end

  defp fence_status(v) do
    if Params.get(v.params, "FENCE_ENABLE") != 0 do
      breached = if MapSet.member?(v.failsafes, :fence), do: 1, else: 0
      %M.FenceStatus{breach_status: breached, breach_count: breached, breach_type: breached}
    end
  end

  defp ahrs2(v) do
    {lat, lon} = if v.home, do: Vehicle.position(v), else: {0, 0}

    %M.Ahrs2{
      roll: v.kin.roll,
      pitch: v.kin.pitch,
      yaw: v.kin.yaw,
      altitude: Vehicle.altitude(v),
      lat: lat,
      lng: lon
    }
  end

  # EKF_STATUS_FLAGS seen in the recordings: uninitialised, no position yet, on the ground, in flight.
  defp ekf_flags(v) do
    cond do
      v.now < 4_200_000 and v.ready_us > 4_200_000 -> 1024
      not Vehicle.positioned?(v) -> 167
      true -> 831
    end
  end

  defp statustext(severity, text, id, chunk),
    do: %M.Statustext{severity: severity, text: text, id: id, chunk_seq: chunk}

  defp chunks(v, severity, text) do
    id = rem(v.text_id, 65_535) + 1

    text
    |> SimVehicle.Services.Texts.split()
    |> Enum.with_index()
    |> Enum.reduce(%{v | text_id: id}, fn {chunk, seq}, v ->
      Vehicle.emit(v, statustext(severity, chunk, id, seq))
    end)
  end

  # Its own request every ten seconds, with nanoseconds of its clock.
  defp timesync(v) do
    if v.now >= Vehicle.own(v, :timesync_at, 10_000_000) do
      v
      |> Vehicle.put_own(:timesync_at, v.now + 10_000_000)
      |> Vehicle.emit(%M.Timesync{tc1: 0, ts1: v.now * 1000 + v.system})
    else
      v
    end
  end
end
