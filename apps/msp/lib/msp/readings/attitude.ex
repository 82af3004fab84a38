defmodule Msp.Readings.Attitude do
  @moduledoc "ATTITUDE of both; the rates are not known."
  @behaviour Msp.Readings

  import Msp.Readings.Value

  alias MavCodec.Messages, as: M
  alias Msp.Readings

  @impl Readings
  def polls, do: [{"ATTITUDE", %{}, [betaflight: 200, inav: 200], [M.Attitude]}]

  @impl Readings
  def read(_firmware, "ATTITUDE", %{roll: roll, pitch: pitch, yaw: yaw}, _ids),
    do: %{roll: roll / 10, pitch: -pitch / 10, yaw: yaw * 1.0}

  def read(_firmware, _name, _values, _ids), do: %{}

  @impl Readings
  def messages("ATTITUDE", readings, context) do
    [
      %M.Attitude{
        time_boot_ms: context.boot_ms,
        roll: radians(readings.roll),
        pitch: radians(readings.pitch),
        yaw: radians(wrap(readings.yaw)),
        rollspeed: :nan,
        pitchspeed: :nan,
        yawspeed: :nan
      }
    ]
  end

  defp wrap(yaw) when yaw > 180, do: yaw - 360
  defp wrap(yaw), do: yaw
end
