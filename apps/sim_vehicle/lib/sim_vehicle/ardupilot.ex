defmodule SimVehicle.Ardupilot do
  @moduledoc """
  ArduCopter 4.6.3 as its recordings and its source show it.

  Boot text before the first frame, results of refused commands (FAILED rather than DENIED), STATUSTEXTs, the order of
  answers, mission item 0 = home, disarming by itself, `FS_*` and `BATT_FS_*` failsafes.
  """

  @behaviour SimVehicle.Personality

  import Bitwise

  alias MavCodec.Messages, as: M
  alias SimVehicle.{Params, Requests, Setpoints, Telemetry, Vehicle}
  alias SimVehicle.Ardupilot.{Arming, Boot, Commands, Events, Failsafes, Modes}
  alias SimVehicle.Flight.Mission

  @groups %{
    1 => [27, 116, 129, 29, 137],
    2 => [1, 125, 152, 42, 24, 62, 87, 162],
    3 => [36, 65],
    6 => [33, 32],
    10 => [30, 178],
    11 => [74],
    12 => [163, 2, 168, 241, 193, 147]
  }

  @streamed @groups
            |> Map.values()
            |> List.flatten()
            |> Kernel.++([0, 31, 85, 242, 245, 148, 49])
            |> Enum.sort()

  # MAV_PROTOCOL_CAPABILITY bits of 4.6.3; 4.6.3 with type 255 (release) as 8-bit fields.
  @capabilities 64_495
  @version 67_503_103

  @impl SimVehicle.Personality
  def params, do: Params.new(Params.Ardupilot.definitions(), :c_cast)

  @impl SimVehicle.Personality
  def plan_style, do: :ardupilot

  @impl SimVehicle.Personality
  def rates do
    # 30 is ATTITUDE: an operator's horizon wants more than 4 Hz.
    @groups |> Map.values() |> List.flatten() |> Map.new(&{&1, 4}) |> Map.merge(%{0 => 1, 30 => 10})
  end

  @impl SimVehicle.Personality
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

  @impl SimVehicle.Personality
  def boot(v), do: Boot.power_up(v)

  @impl SimVehicle.Personality
  def tick(v), do: v |> Boot.tick() |> Arming.tick() |> Failsafes.tick() |> timesync()

  # ArduPilot also takes what is meant for a component of its system that it does not know.
  @impl SimVehicle.Personality
  def addressed?(v, {system, _component}), do: system in [0, v.system]

  @impl SimVehicle.Personality
  defdelegate command(v, command), to: Commands

  @impl SimVehicle.Personality
  def text(v, severity, text) do
    # Longer than 50 bytes goes in chunks with an id; the usual text has id 0.
    if byte_size(text) > 50,
      do: chunks(v, severity, text),
      else: Vehicle.emit(v, statustext(severity, text, 0, 0))
  end

  @impl SimVehicle.Personality
  def gcs_heard(v, system), do: Failsafes.gcs_heard(v, system)

  @impl SimVehicle.Personality
  defdelegate flight_event(v, event), to: Events

  @impl SimVehicle.Personality
  defdelegate failsafe(v, kind, on?), to: Failsafes, as: :set

  @impl SimVehicle.Personality
  def plan_changed(v, kind, 0) do
    v = Mission.reset(v)
    if kind == :stored, do: Vehicle.text(v, 6, "Flight plan received"), else: v
  end

  def plan_changed(v, :stored, 1), do: Vehicle.text(v, 7, "Fence Indexed OK")
  def plan_changed(v, _kind, _type), do: v

  @impl SimVehicle.Personality
  def mission_rtl(v), do: {:goal, Modes.rtl(v)}

  @impl SimVehicle.Personality
  def message(v, %M.ParamRequestList{}, _source) do
    names = 0..(Params.count(v.params) - 1)//1
    Enum.reduce(names, v, &Vehicle.emit(&2, Requests.param_value(v, Params.name_at(v.params, &1))))
  end

  # Read by name the index is 65535, as in the recordings; an unknown name is passed over.
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
      command: 11,
      result: result,
      target_system: system,
      target_component: component
    })
  end

  def message(v, %M.MissionSetCurrent{seq: seq}, _source) do
    {ok?, v} = Mission.set_current(v, seq)
    if ok?, do: Vehicle.emit(v, Telemetry.message(v, 42)), else: v
  end

  def message(%{mode: "GUIDED"} = v, %module{} = m, _source)
      when module in [M.SetPositionTargetLocalNed, M.SetPositionTargetGlobalInt] do
    case Setpoints.goal(v, m, round(Params.get(v.params, "GUID_TIMEOUT") * 1.0e6)) do
      {:ok, goal} when v.airborne and v.armed -> v |> SimVehicle.Flight.go(goal) |> Map.put(:landed, :in_air)
      _grounded_or_ignored -> v
    end
  end

  def message(v, %M.Timesync{} = m, source) do
    case Requests.timesync(v, m, source) do
      nil -> v
      answer -> Vehicle.emit(v, answer)
    end
  end

  def message(v, %M.LogRequestList{}, _source), do: Vehicle.emit(v, %M.LogEntry{})
  def message(v, _message, _source), do: v

  @doc "The ids that this firmware streams."
  @spec streamed() :: [non_neg_integer]
  def streamed, do: @streamed

  @impl SimVehicle.Personality
  def telemetry(v, 0) do
    %M.Heartbeat{
      type: 2,
      autopilot: 3,
      base_mode: base_mode(v),
      custom_mode: Modes.number(v.mode),
      system_status: system_status(v),
      mavlink_version: 3
    }
  end

  def telemetry(v, 148) do
    %M.AutopilotVersion{
      capabilities: @capabilities,
      flight_sw_version: @version,
      flight_custom_version: "92b0cd78"
    }
    |> Map.put(:uid, v.system)
  end

  def telemetry(v, 245), do: %M.ExtendedSysState{vtol_state: 3, landed_state: Telemetry.landed_state(v)}
  def telemetry(_v, 152), do: %M.Meminfo{freemem: 65_535, freemem32: 524_288}
  def telemetry(v, 62), do: navigation(v)
  def telemetry(v, 162), do: fence_status(v)
  def telemetry(_v, 163), do: %M.Ahrs{error_rp: 0.002, error_yaw: 0.007}
  def telemetry(v, 168), do: if(v.home, do: %M.Wind{direction: -180.0})
  def telemetry(v, 178), do: if(v.now > 2_800_000, do: ahrs2(v))
  def telemetry(v, 193), do: %M.EkfStatusReport{flags: ekf_flags(v), compass_variance: 0.03}
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
    |> SimVehicle.Texts.split()
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
