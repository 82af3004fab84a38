defmodule Aerie.Vehicle.State.Power do
  @moduledoc """
  Batteries, and the health in SYS_STATUS.

  `batteries` has each battery that sends BATTERY_STATUS. The group's own `voltage`, `current` and `remaining` come from one
  message: BATTERY_STATUS of the battery with the lowest id (`id`) that has a voltage or a remaining charge. Only while no
  BATTERY_STATUS comes are they those of SYS_STATUS or HIGH_LATENCY2, which do not say of which battery (`id` is nil).
  `charge_state` is the worst of all batteries.
  """
  @behaviour Aerie.Vehicle.State

  import Bitwise

  alias Aerie.Vehicle.State
  alias Aerie.Vehicle.State.Value
  alias MavCodec.Enums.{MavBatteryChargeState, MavSysStatusSensor}
  alias MavCodec.Messages, as: M

  # PX4 sends BATTERY_STATUS every two seconds, slow links less often.
  @fresh_us 10_000_000
  @prearm_check MavSysStatusSensor.value(:MAV_SYS_STATUS_PREARM_CHECK)
  @fence MavSysStatusSensor.value(:MAV_SYS_STATUS_GEOFENCE)
  @rc_receiver MavSysStatusSensor.value(:MAV_SYS_STATUS_SENSOR_RC_RECEIVER)
  @battery_status M.BatteryStatus.id()
  # MAV_BATTERY_CHARGE_STATE by severity.
  @severity %{
    "CHARGING" => 0,
    "OK" => 1,
    "UNHEALTHY" => 2,
    "LOW" => 3,
    "CRITICAL" => 4,
    "EMERGENCY" => 5,
    "FAILED" => 6
  }
  # Ids have 8 bits. No vehicle has more than a few batteries, and a faulty one must not fill the memory.
  @max_batteries 16
  @own [:id, :voltage, :current, :remaining, :consumed_mah]

  @impl State
  def read(%M.SysStatus{} = m, state, at) do
    battery = %{
      voltage: voltage(m.voltage_battery),
      current: current(m.current_battery, state.autopilot),
      remaining: remaining(m.battery_remaining)
    }

    {[], summary(battery, state, at) ++ [health: health(m)] ++ fence_off(m, State.data(state, :health))}
  end

  def read(%M.BatteryStatus{} = m, state, _at) do
    one = %{
      id: m.id,
      voltage: total_voltage(m),
      current: current(m.current_battery, state.autopilot),
      remaining: remaining(m.battery_remaining),
      consumed_mah: if(m.current_consumed >= 0, do: m.current_consumed),
      temperature: Value.signed(m.temperature, 16, 100),
      charge_state: charge_state(m.charge_state)
    }

    group = State.data(state, :battery)
    others = Enum.reject(group.batteries || [], &(&1.id == m.id))
    batteries = Enum.take(Enum.sort_by([one | others], & &1.id), @max_batteries)

    {[],
     battery: Map.merge(own(first(batteries), group), %{batteries: batteries, charge_state: worst(batteries)})}
  end

  defp own(nil, %{id: nil}), do: %{}
  # It does not measure any more. What was measured before is none of the present.
  defp own(nil, _group), do: Map.from_keys(@own, nil)
  defp own(first, _group), do: Map.take(first, @own)

  @doc "The battery whose values are the group's own: the first one with a voltage or a remaining charge, or nil."
  @spec first([map()]) :: map() | nil
  def first(batteries), do: Enum.find(batteries, &(&1.voltage != nil or &1.remaining != nil))

  @doc """
  Battery values of a message that does not say of which battery, as a change of the group; none while BATTERY_STATUS comes.
  """
  @spec summary(map(), State.t(), at :: integer()) :: [{:battery, map()}]
  def summary(values, state, at) do
    case {State.data(state, :battery), state.sources} do
      {%{id: id}, %{@battery_status => heard}} when id != nil and at - heard <= @fresh_us -> []
      _no_battery -> [battery: Map.merge(%{id: nil, voltage: nil, current: nil, consumed_mah: nil}, values)]
    end
  end

  defp health(m) do
    enabled = m.onboard_control_sensors_enabled
    failing = m.onboard_control_sensors_present &&& enabled &&& bnot(m.onboard_control_sensors_health)

    %{
      load: Value.up_to(m.load, 1000, 1000),
      unhealthy: names(failing &&& bnot(@prearm_check)),
      rc_receiver: rc_receiver(m),
      fence_enabled: fence_enabled(m),
      ready_to_arm: if((enabled &&& @prearm_check) != 0, do: (failing &&& @prearm_check) == 0),
      drop_rate: Value.unsigned(m.drop_rate_comm, 16, 10_000),
      errors: m.errors_comm
    }
  end

  # PX4 shows a lost receiver as not present.
  defp rc_receiver(m) do
    if (m.onboard_control_sensors_enabled &&& @rc_receiver) != 0,
      do: (m.onboard_control_sensors_present &&& m.onboard_control_sensors_health &&& @rc_receiver) != 0
  end

  # ArduPilot sends FENCE_STATUS only of a fence that is on: what the last one said is not known any more.
  defp fence_off(m, %{fence_enabled: true}),
    do: if(fence_enabled(m), do: [], else: [mission: State.Plan.fence_unknown()])

  defp fence_off(_m, _health), do: []

  # A vehicle without a fence shows it as not present.
  defp fence_enabled(m) do
    if (m.onboard_control_sensors_present &&& @fence) != 0,
      do: (m.onboard_control_sensors_enabled &&& @fence) != 0
  end

  defp names(0), do: []

  defp names(bits) do
    {flags, unknown} = MavSysStatusSensor.flags(bits)
    named = for flag <- flags, do: flag |> Atom.to_string() |> short()
    if unknown == 0, do: named, else: named ++ ["bits 0x#{Integer.to_string(unknown, 16)}"]
  end

  defp short("MAV_SYS_STATUS_SENSOR_" <> name), do: String.downcase(name)
  defp short("MAV_SYS_STATUS_" <> name), do: String.downcase(name)

  defp voltage(0), do: nil
  defp voltage(millivolts), do: Value.unsigned(millivolts, 16, 1000)

  # `voltages` has up to ten cells, or the voltage of the whole pack in the first field (what exceeds 65 V in the second,
  # and so on). The extension has cells 11 to 14, where 0 is unknown.
  defp total_voltage(m) do
    case Enum.reject(m.voltages, &(&1 == 0xFFFF)) ++ Enum.reject(m.voltages_ext, &(&1 in [0, 0xFFFF])) do
      [] -> nil
      cells -> voltage_of(Enum.sum(cells))
    end
  end

  # A monitor without a voltage.
  defp voltage_of(0), do: nil
  defp voltage_of(millivolts), do: millivolts / 1000

  # PX4 scales its "unknown" of -1 A before sending it. The lowest number is what did not fit.
  defp current(-100, :px4), do: nil
  defp current(-0x8000, _autopilot), do: nil
  defp current(centiamperes, _autopilot), do: Value.or_minus_one(centiamperes, 100)

  defp remaining(percent) when percent in 0..100, do: percent / 100
  defp remaining(_unknown), do: nil

  defp charge_state(0), do: nil
  defp charge_state(value), do: MavBatteryChargeState.label(value) || "STATE(#{value})"

  defp worst(batteries) do
    batteries |> Enum.map(& &1.charge_state) |> Enum.max_by(&Map.get(@severity, &1, -1))
  end
end
