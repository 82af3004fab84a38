defmodule Aerie.Vehicle.State.Groups.Battery do
  @moduledoc """
  The batteries.

  `batteries` has each battery that sends BATTERY_STATUS. The group's own `voltage`, `current` and `remaining` come from one
  message: BATTERY_STATUS of the battery with the lowest id (`id`) that has a voltage or a remaining charge. Only while no
  BATTERY_STATUS comes are they those of SYS_STATUS or HIGH_LATENCY2, which do not say of which battery (`id` is nil).
  `charge_state` is the worst of all batteries.
  """

  alias Aerie.Vehicle.{Firmware, State}
  alias Aerie.Vehicle.State.{Group, Value}
  alias MavCodec.Enums.MavBatteryChargeState
  alias MavCodec.Messages, as: M

  # PX4 sends BATTERY_STATUS every two seconds, slow links less often.
  @fresh_us 10_000_000
  # One of which nothing came in this many rounds of the others was taken out; all are out if none tells for this long.
  @missed_rounds 30
  @gone_us 60_000_000
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
  @unknown %{id: nil, voltage: nil, current: nil, consumed_mah: nil, time_remaining: nil}
  @own [:id, :voltage, :current, :remaining, :consumed_mah, :time_remaining]

  use Group,
    name: :battery,
    title:
      "The battery with the lowest id, and a list of all. Without BATTERY_STATUS the values are those of SYS_STATUS.",
    sampling: {:threshold, 1.0, %{"remaining" => 0.01}, 30.0},
    messages: [M.BatteryStatus],
    fields: [
      {:id, 0, nil, "id of the battery that these values are of; null if the message does not say",
       "BATTERY_STATUS"},
      {:voltage, 2, "V", "voltage", "SYS_STATUS, BATTERY_STATUS",
       metric: {"gateway_vehicle_battery_volts", "Battery voltage."}},
      {:current, 2, "A", "discharge current", "SYS_STATUS, BATTERY_STATUS"},
      {:remaining, 2, "0..1", "remaining charge", "SYS_STATUS, BATTERY_STATUS, HIGH_LATENCY2",
       metric: {"gateway_vehicle_battery_ratio", "Remaining charge, 0 to 1."}},
      {:consumed_mah, 0, "mAh", "consumed charge", "BATTERY_STATUS"},
      {:time_remaining, 0, "s", "how long it lasts, as the firmware reckons", "BATTERY_STATUS"},
      {:charge_state, :text, nil, "MAV_BATTERY_CHARGE_STATE, the worst of all batteries", "BATTERY_STATUS"},
      {:batteries, {:list, :group}, nil, "a list of all batteries, each with the fields above and these:",
       "BATTERY_STATUS"},
      {[:batteries, :id], 0, nil, "id of the battery", "BATTERY_STATUS"},
      {[:batteries, :temperature], 1, "°C", "temperature", "BATTERY_STATUS"}
    ]

  @impl Group
  def read(%M.BatteryStatus{} = m, state, _at) do
    one = %{
      id: m.id,
      voltage: total_voltage(m),
      current: current(m.current_battery, state.autopilot),
      remaining: remaining(m.battery_remaining),
      consumed_mah: if(m.current_consumed >= 0, do: m.current_consumed),
      time_remaining: if(m.time_remaining > 0, do: m.time_remaining),
      temperature: Value.signed(m.temperature, 16, 100),
      charge_state: charge_state(m.charge_state)
    }

    group = Group.data(state, :battery)
    known = Enum.reject(group[:batteries] || [], &(&1.id == m.id))
    most = @missed_rounds * length(known)
    others = for one <- known, Map.get(state.silent_batteries, one.id, 0) < most, do: one
    silent = Map.new(others, &{&1.id, Map.get(state.silent_batteries, &1.id, 0) + 1})
    batteries = Enum.take(Enum.sort_by([one | others], & &1.id), @max_batteries)

    {[silent_batteries: silent],
     battery: Map.merge(own(first(batteries), group), %{batteries: batteries, charge_state: worst(batteries)})}
  end

  # It does not measure any more. What was measured before is none of the present.
  defp own(nil, %{id: id}) when id != nil, do: Map.from_keys(@own, nil)
  defp own(nil, _group), do: %{}
  defp own(first, _group), do: Map.take(first, @own)

  @doc "The battery whose values are the group's own: the first one with a voltage or a remaining charge, or nil."
  @spec first([map()]) :: map() | nil
  def first(batteries), do: Enum.find(batteries, &(&1.voltage != nil or &1.remaining != nil))

  @doc "The battery values of SYS_STATUS, as `summary/3`."
  @spec sys_status(struct(), State.t(), at :: integer()) :: [{:battery, map()}]
  def sys_status(m, state, at) do
    values = %{
      voltage: voltage(m.voltage_battery),
      current: current(m.current_battery, state.autopilot),
      remaining: remaining(m.battery_remaining)
    }

    summary(values, state, at)
  end

  @doc """
  Battery values of a message that does not say of which battery, as a change of the group; none while BATTERY_STATUS comes.
  """
  @spec summary(map(), State.t(), at :: integer()) :: [{:battery, map()}]
  def summary(values, state, at) do
    case {Group.data(state, :battery), state.sources} do
      {%{id: id}, %{@battery_status => heard}} when id != nil and at - heard <= @fresh_us ->
        []

      {_group, %{@battery_status => heard}} when at - heard > @gone_us ->
        [battery: Map.merge(Map.merge(@unknown, %{batteries: nil, charge_state: nil}), values)]

      _no_battery ->
        [battery: Map.merge(@unknown, values)]
    end
  end

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

  # The lowest number is what did not fit.
  defp current(-0x8000, _firmware), do: nil

  defp current(centiamperes, firmware) do
    if centiamperes != Firmware.telemetry(firmware).unknown_current,
      do: Value.or_minus_one(centiamperes, 100)
  end

  defp remaining(percent) when percent in 0..100, do: percent / 100
  defp remaining(_unknown), do: nil

  defp charge_state(0), do: nil
  defp charge_state(value), do: MavBatteryChargeState.label(value) || "STATE(#{value})"

  defp worst(batteries) do
    batteries |> Enum.map(& &1.charge_state) |> Enum.max_by(&Map.get(@severity, &1, -1))
  end
end
