defmodule SimVehicle.Services.Telemetry.Power do
  @moduledoc false

  alias MavCodec.Messages, as: M
  alias SimVehicle.{Params, Vehicle}
  alias SimVehicle.Physics.Battery

  import Bitwise

  @prearm_check 0x1000_0000
  @rc_receiver 0x1_0000
  @gps 0x20
  @fence 0x10_0000

  # The bits that the two firmwares showed in flight, without those of the three sensors that can fail here.
  @sensors %{
    ardupilot: {1_399_979_055, 1_382_128_687, 1_467_063_343},
    px4: {50_348_079, 50_413_615, 320_915_519}
  }

  @spec sys_status(Vehicle.t()) :: struct
  def sys_status(v) do
    {present, enabled, health} = Map.fetch!(@sensors, v.plans.style)

    %M.SysStatus{
      onboard_control_sensors_present: present,
      onboard_control_sensors_enabled: enabled ||| fence(v),
      onboard_control_sensors_health: health &&& bnot(unhealthy(v)),
      load: 60,
      voltage_battery: millivolts(v),
      current_battery: centiamps(v),
      battery_remaining: Battery.percent(v.battery)
    }
  end

  @spec battery_status(Vehicle.t()) :: struct
  def battery_status(v) do
    %M.BatteryStatus{
      temperature: 32_767,
      voltages: [millivolts(v) | List.duplicate(65_535, 9)],
      current_battery: centiamps(v),
      current_consumed: round(v.battery.used_mah),
      # In hectojoule: mAh x V x 3.6 / 100.
      energy_consumed: round(v.battery.used_mah * v.battery.cells * 3.7 * 3.6 / 100),
      battery_remaining: Battery.percent(v.battery),
      charge_state: charge_state(v)
    }
  end

  @spec power_status(Vehicle.t()) :: struct
  def power_status(_v), do: %M.PowerStatus{vcc: 5000}

  # MAV_BATTERY_CHARGE_STATE: 1 ok, 2 low, 3 critical.
  defp charge_state(v) do
    cond do
      MapSet.member?(v.failsafes, :battery_critical) -> 3
      MapSet.member?(v.failsafes, :battery) -> 2
      true -> 1
    end
  end

  defp unhealthy(v) do
    bits = [
      {@prearm_check, not Vehicle.positioned?(v)},
      {@rc_receiver, MapSet.member?(v.failsafes, :rc)},
      {@gps, MapSet.member?(v.failsafes, :gps) or v.now * 4 < v.ready_us}
    ]

    Enum.reduce(bits, 0, fn {bit, bad?}, sum -> if bad?, do: sum ||| bit, else: sum end)
  end

  # PX4 shows no fence here.
  defp fence(%{plans: %{style: :ardupilot}} = v),
    do: if(Params.get(v.params, "FENCE_ENABLE") == 0, do: 0, else: @fence)

  defp fence(_px4), do: 0

  defp millivolts(v), do: round(Battery.voltage(v.battery) * 1000)
  defp centiamps(v), do: v.battery.current_a |> Kernel.*(100) |> round() |> min(32_767)
end
