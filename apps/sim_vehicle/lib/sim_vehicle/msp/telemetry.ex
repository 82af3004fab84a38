defmodule SimVehicle.Msp.Telemetry do
  @moduledoc "What a simulated flight controller says of its state, as the values of its replies."

  alias MavCodec.Msp.{Messages, Payload}
  alias SimVehicle.Msp.Flight

  @gps_us 3_000_000
  # Barometer and GPS receiver.
  @altimeters 0b1010

  @doc "The payload of a reply that tells its state; nil for one of its configuration."
  @spec payload(map, id :: non_neg_integer, arming_flags :: non_neg_integer) :: binary | nil
  def payload(fc, id, flags) do
    with {:ok, %{kind: :read} = message} <- Messages.fetch(fc.firmware, id),
         values when values != nil <- values(Map.put(fc, :flags, flags), message.name, fc.blocks[id]) do
      {:ok, payload} = Payload.encode(message.reply, values, fc.version)
      payload
    else
      _other -> nil
    end
  end

  defp values(fc, name, block) when name in ["STATUS", "STATUS_EX", "MSP2_INAV_STATUS"] and block != nil do
    {:ok, message} = Messages.fetch(fc.firmware, name)
    {:ok, values} = Payload.decode(message.reply, block, fc.version)
    flags = fc.flags

    values = Map.put(values, :mode_flags, mode_flags(fc))

    values =
      if fc.blind, do: Map.update!(values, :sensors, &(&1 - Bitwise.band(&1, @altimeters))), else: values

    if fc.firmware == :inav,
      do: %{values | arming_flags: inav_flags(fc, flags)},
      else: %{values | arming_disable_flags: flags}
  end

  defp values(%{flight: f}, "ATTITUDE", _block),
    do: %{roll: round(f.roll * 10), pitch: round(-f.pitch * 10), yaw: rem(round(f.yaw), 360)}

  # It says so however high it is.
  defp values(%{blind: true} = fc, "ALTITUDE", _block),
    do: Map.merge(%{altitude: 0, vario: 0}, if(fc.firmware == :inav, do: %{baro_altitude: 0}, else: %{}))

  defp values(%{firmware: :inav, flight: f}, "ALTITUDE", _block),
    do: %{altitude: cm(f.alt), vario: cm(f.climb), baro_altitude: cm(f.alt)}

  # Above where it was armed; disarmed above the sea, as soon as there is a position.
  defp values(%{flight: f} = fc, "ALTITUDE", _block) do
    above = if not fc.armed and fix?(fc), do: f.ground + f.alt, else: f.alt - fc.home_alt
    %{altitude: cm(above), vario: cm(f.climb)}
  end

  defp values(%{flight: f} = fc, "RAW_GPS", _block) do
    fix? = fix?(fc)

    values = %{
      fix: if(fix?, do: 2, else: 0),
      satellites: if(fix?, do: 14, else: 3),
      lat: round(f.lat * 1.0e7),
      lon: round(f.lon * 1.0e7),
      altitude: round(f.ground + f.alt),
      ground_speed: round(f.speed * 100),
      course: round(f.course * 10)
    }

    Map.put(values, if(fc.firmware == :inav, do: :hdop, else: :dop), 110)
  end

  defp values(%{firmware: :betaflight, flight: f}, "BATTERY_STATE", _block) do
    {_left, volts} = Flight.battery(f)

    %{
      cells: 4,
      capacity: Flight.capacity(),
      voltage_dv: round(volts * 10),
      drawn: round(f.drawn),
      current: 1200,
      state: charge(volts),
      voltage: round(volts * 100)
    }
  end

  defp values(%{firmware: :inav, flight: f}, "MSP2_INAV_ANALOG", _block) do
    {left, volts} = Flight.battery(f)

    %{
      battery_flags: Bitwise.bsl(4, 4) + Bitwise.bsl(charge(volts), 2) + 1,
      voltage: round(volts * 100),
      current: 1200,
      power: round(volts * 1200),
      drawn: round(f.drawn),
      energy: 0,
      remaining: round(left * Flight.capacity()),
      percentage: round(left * 100),
      rssi: 900
    }
  end

  defp values(fc, "RC", _block) do
    [roll, pitch, throttle, yaw | more] = fc.channels
    throttle = if fc.rc_lost and fc.firmware == :betaflight, do: 885, else: throttle
    %{entries: for(us <- [roll, pitch, yaw, throttle | more], do: %{channel: us})}
  end

  defp values(%{firmware: :inav} = fc, "MSP2_INAV_MISC2", _block) do
    %{
      on_time: div(fc.now - fc.started, 1_000_000),
      flight_time: round(fc.flight.flown),
      throttle: 0,
      auto_throttle: 0
    }
  end

  defp values(_fc, _name, _block), do: nil

  defp fix?(fc), do: not fc.blind and fc.now - fc.started > @gps_us
  defp cm(metres), do: round(metres * 100)

  defp charge(volts) when volts < 4 * 3.4, do: 2
  defp charge(volts) when volts < 4 * 3.5, do: 1
  defp charge(_volts), do: 0

  defp mode_flags(fc) do
    for {<<id>>, bit} <- Enum.with_index(for(<<id <- fc.blocks[119]>>, do: <<id>>)),
        id in fc.boxes,
        reduce: 0,
        do: (sum -> sum + Bitwise.bsl(1, bit))
  end

  # Bits of states, which are not reasons.
  defp inav_flags(%{armed: true}, _flags), do: 0b1100
  defp inav_flags(_fc, flags), do: flags
end
