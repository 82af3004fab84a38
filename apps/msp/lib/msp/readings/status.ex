defmodule Msp.Readings.Status do
  @moduledoc """
  Boxes, arming flags, sensors, load and seconds since the start. HEARTBEAT and SYS_STATUS are made of them, which
  `Msp.Session.Reports` sends: a heartbeat as well when it changes.
  """
  @behaviour Msp.Readings

  import Bitwise
  import Msp.Readings.Value

  alias MavCodec.Enums.{MavSysStatusSensor, MavType}
  alias MavCodec.Messages, as: M
  alias Msp.{Firmware, Identity, Modes, Readings}
  alias Msp.Firmware.Arming

  # MAV_MODE_FLAG
  @custom 1
  @armed 128
  # MAV_STATE
  @calibrating 2
  @standby 3
  @active 4
  @critical 5
  @prearm MavSysStatusSensor.value(:MAV_SYS_STATUS_PREARM_CHECK)
  @receiver MavSysStatusSensor.value(:MAV_SYS_STATUS_SENSOR_RC_RECEIVER)
  # The sensors of both firmwares by their bits, as far as MAVLink has them.
  @sensors for {bit, name} <- [
                 {0, :"3D_ACCEL"},
                 {1, :ABSOLUTE_PRESSURE},
                 {2, :"3D_MAG"},
                 {3, :GPS},
                 {4, :LASER_POSITION}
               ],
               do: {bit, MavSysStatusSensor.value(:"MAV_SYS_STATUS_SENSOR_#{name}")}
  @generic MavType.value(:MAV_TYPE_GENERIC)
  # Its place in BOXIDS says which flag means armed.
  @arm 0
  # SENSOR_STATUS, in the order of the bits of STATUS.
  @inav_sensors [acc: 0, baro: 1, mag: 2, gps: 3, rangefinder: 4, opflow: 5, pitot: 6]

  @impl Readings
  def polls do
    rated = [M.Heartbeat, M.SysStatus]

    [
      {"STATUS_EX", %{}, [betaflight: 200], rated},
      {"MSP2_INAV_STATUS", %{}, [inav: 200], rated},
      {"MSP2_INAV_MISC2", %{}, [inav: 1000], []},
      {"SENSOR_STATUS", %{}, [inav: 2000], []},
      {"BOXIDS", %{}, [betaflight: 10_000, inav: 10_000], []}
    ]
  end

  @impl Readings
  def read(firmware, name, values, ids)

  def read(:betaflight, "STATUS_EX", %{mode_flags: low} = v, ids) do
    flags =
      for {%{flags: byte}, n} <- Enum.with_index(v[:more_flags] || []),
          reduce: low,
          do: (sum -> sum + (byte <<< (32 + 8 * n)))

    status(flags, v[:arming_disable_flags], v, ids)
  end

  def read(:inav, "MSP2_INAV_STATUS", %{mode_flags: flags} = v, ids),
    do: status(flags, v[:arming_flags], v, ids)

  def read(:inav, "MSP2_INAV_MISC2", v, _ids), do: %{on_s: v[:on_time]}

  def read(:inav, "SENSOR_STATUS", v, _ids) do
    # 1 is healthy, 2 unavailable although wanted, 3 unhealthy.
    %{
      unhealthy: for({key, bit} <- @inav_sensors, v[key] in [2, 3], reduce: 0, do: (sum -> sum + (1 <<< bit)))
    }
  end

  def read(_firmware, _name, _values, _ids), do: %{}

  defp status(flags, arming, v, ids) do
    %{
      boxes: if(@arm in ids, do: Modes.boxes(flags, ids)),
      arming: arming,
      sensors: v[:sensors],
      load: percent(v[:cpu_load])
    }
  end

  @impl Readings
  def messages(_name, _readings, _context), do: []

  @doc "The MAV_TYPE of a vehicle, by its mixer or its platform type."
  @spec type(Modes.firmware(), non_neg_integer | nil) :: non_neg_integer
  def type(firmware, number) do
    %{types: types, other_type: other} = Firmware.of(firmware)
    name = Enum.find_value(types, other, fn {name, numbers} -> if number in numbers, do: name end)
    with nil <- MavType.value(:"MAV_TYPE_#{name}"), do: @generic
  end

  @doc "HEARTBEAT."
  @spec heartbeat(Identity.t(), non_neg_integer, Readings.t()) :: struct
  def heartbeat(identity, type, readings) do
    armed? = Modes.armed?(readings.boxes)

    %M.Heartbeat{
      type: type,
      autopilot: 0,
      base_mode: @custom + if(armed?, do: @armed, else: 0),
      custom_mode: Modes.mode(identity.firmware, readings.boxes),
      system_status: state(readings, armed?)
    }
  end

  defp state(readings, armed?) do
    cond do
      Modes.failsafe?(readings.boxes) -> @critical
      armed? -> @active
      calibrating?(readings[:arming]) -> @calibrating
      true -> @standby
    end
  end

  defp calibrating?(nil), do: false
  defp calibrating?(flags), do: (flags >>> 12 &&& 1) == 1

  @doc "SYS_STATUS: sensors, what keeps it from being armed, load, and the battery."
  @spec sys_status(Identity.t(), Readings.t()) :: struct
  def sys_status(identity, readings) do
    target = Identity.target(identity)
    armed? = Modes.armed?(readings.boxes)
    present = sensors(identity.firmware, readings[:sensors] || 0)
    failing = sensors(identity.firmware, readings[:unhealthy] || 0)
    {rc, rc_fails} = bit(Arming.rc_lost?(target, readings.arming || 0, armed?), @receiver)
    {ready, not_ready} = bit(readings.arming && Arming.names(target, readings.arming) != [], @prearm)
    all = present ||| failing ||| rc ||| ready

    %M.SysStatus{
      onboard_control_sensors_present: all,
      onboard_control_sensors_enabled: all,
      onboard_control_sensors_health: all &&& bnot(failing ||| rc_fails ||| not_ready),
      load: if(readings[:load], do: round(readings.load * 1000), else: 0xFFFF),
      voltage_battery: scaled(readings[:voltage], 1000, :u16),
      current_battery: scaled(readings[:current], 100, :current),
      battery_remaining: scaled(readings[:remaining], 100, :percent),
      drop_rate_comm: 0xFFFF
    }
  end

  # An unknown one is not there.
  defp bit(nil, _bit), do: {0, 0}
  defp bit(fails?, bit), do: {bit, if(fails?, do: bit, else: 0)}

  defp sensors(firmware, bits) do
    for {bit, value} <- @sensors ++ more(firmware),
        (bits >>> bit &&& 1) == 1,
        reduce: 0,
        do: (sum -> sum ||| value)
  end

  defp more(firmware) do
    for {bit, name} <- Firmware.of(firmware).sensors,
        do: {bit, MavSysStatusSensor.value(:"MAV_SYS_STATUS_SENSOR_#{name}")}
  end
end
