defmodule Msp.Readings.Battery do
  @moduledoc "BATTERY_STATE of Betaflight and MSP2_INAV_ANALOG: BATTERY_STATUS; not made while no battery is connected."
  @behaviour Msp.Readings

  import Msp.Readings.Value

  alias MavCodec.Messages, as: M
  alias Msp.Readings

  @charge_of %{0 => :ok, 1 => :low, 2 => :critical, 3 => :absent}
  # MAV_BATTERY_CHARGE_STATE
  @charge %{ok: 1, low: 2, critical: 3}

  @impl Readings
  def polls do
    [
      {"BATTERY_STATE", %{}, [betaflight: 1000], [M.BatteryStatus]},
      {"MSP2_INAV_ANALOG", %{}, [inav: 1000], [M.BatteryStatus]}
    ]
  end

  @impl Readings
  def read(:betaflight, "BATTERY_STATE", %{cells: cells} = v, _ids) do
    there? = cells > 0
    capacity = v[:capacity] || 0

    %{
      cells: if(there?, do: cells),
      voltage: if(there?, do: volts(v)),
      current: if(there?, do: v[:current] && v.current / 100),
      drawn: if(there?, do: v[:drawn]),
      remaining: if(there? and capacity > 0 and is_integer(v[:drawn]), do: max(0.0, 1 - v.drawn / capacity)),
      charge: @charge_of[v[:state]]
    }
  end

  def read(:inav, "MSP2_INAV_ANALOG", %{battery_flags: flags} = v, _ids) do
    charge = @charge_of[flags |> Bitwise.bsr(2) |> Bitwise.band(3)]
    there? = charge != :absent

    %{
      cells: if(there?, do: Bitwise.bsr(flags, 4)),
      voltage: if(there?, do: v[:voltage] && v.voltage / 100),
      current: if(there?, do: v[:current] && v.current / 100),
      drawn: if(there?, do: v[:drawn]),
      remaining: if(there?, do: percent(v[:percentage])),
      charge: charge,
      rssi: rssi(v[:rssi])
    }
  end

  def read(_firmware, _name, _values, _ids), do: %{}

  # The byte saturates at 25.5 V; the word came with API 1.41.
  defp volts(%{voltage: centivolts}), do: centivolts / 100
  defp volts(%{voltage_dv: decivolts}) when decivolts < 255, do: decivolts / 10
  defp volts(_saturated), do: nil

  @impl Readings
  def messages(_name, %{voltage: nil}, _context), do: []

  def messages(_name, readings, _context) do
    [
      %M.BatteryStatus{
        voltages: [scaled(readings.voltage, 1000, :u16) | List.duplicate(0xFFFF, 9)],
        current_battery: scaled(readings.current, 100, :current),
        current_consumed: scaled(readings.drawn, 1, :consumed),
        energy_consumed: -1,
        battery_remaining: scaled(readings.remaining, 100, :percent),
        temperature: 0x7FFF,
        charge_state: Map.get(@charge, readings.charge, 0)
      }
    ]
  end
end
