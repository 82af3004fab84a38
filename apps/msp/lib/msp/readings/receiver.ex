defmodule Msp.Readings.Receiver do
  @moduledoc "RC of both: RC_CHANNELS, with the signal's strength, which Betaflight has in ANALOG."
  @behaviour Msp.Readings

  import Msp.Readings.Value

  alias MavCodec.Messages, as: M
  alias Msp.Readings

  @impl Readings
  def polls do
    [
      {"RC", %{}, [betaflight: 1000, inav: 1000], [M.RcChannels]},
      {"ANALOG", %{}, [betaflight: 2000], []}
    ]
  end

  @impl Readings
  # Roll, pitch, yaw, throttle here; MAVLink and transmitters have the throttle before the yaw.
  def read(_firmware, "RC", %{entries: entries}, _ids) do
    case Enum.map(entries, & &1.channel) do
      [roll, pitch, yaw, throttle | more] -> %{channels: [roll, pitch, throttle, yaw | more]}
      few -> %{channels: few}
    end
  end

  def read(:betaflight, "ANALOG", v, _ids), do: %{rssi: rssi(v[:rssi])}
  def read(_firmware, _name, _values, _ids), do: %{}

  @impl Readings
  def messages("ANALOG", _readings, _context), do: []

  def messages("RC", readings, context) do
    channels = Enum.take(readings.channels, 18)
    known = for {us, n} <- Enum.with_index(channels, 1), do: {:"chan#{n}_raw", us}
    none = for n <- (length(channels) + 1)..18//1, do: {:"chan#{n}_raw", 0xFFFF}

    message = %M.RcChannels{
      time_boot_ms: context.boot_ms,
      chancount: length(channels),
      rssi: scaled(readings[:rssi], 254, :u8)
    }

    [struct!(message, known ++ none)]
  end
end
