defmodule SimVehicle.Firmware.Ardupilot.Boot do
  @moduledoc """
  ArduCopter's texts from power-up until it can fly, in the order and at about the times of the recordings.

  Times are shares of `ready_us`, the time at which the position is good (41.4 s in the recordings), so that they scale with
  it.
  """

  import MavCodec.MessageId

  alias MavCodec.Messages, as: M
  alias SimVehicle.Vehicle
  alias SimVehicle.Physics.Geo

  @version "ArduCopter V4.6.3 (92b0cd78)"

  @boot_text "\n\nInit #{@version}\n\nFree RAM: 524288\nBooting 0/0\nFirmware change: erasing EEPROM...\ndone.\n" <>
               "0 0 0 AP_Logger_File: buffer size=204800\n"

  @recorded_ready 41.4

  @timeline [
    {0.11, "Calibrating barometer"},
    {0.95, @version},
    {0.95, "3d1219c7c4c5404aaa1f6d2a48adfda4"},
    {0.95, "Frame: QUAD/PLUS"},
    {1.71, "Barometer 1 calibration complete"},
    {2.24, "ArduPilot Ready"},
    {2.24, "AHRS: DCM active"},
    {4.24, "EKF3 IMU0 initialised"},
    {4.24, "AHRS: EKF3 active"},
    {5.59, "EKF3 IMU0 tilt alignment complete"},
    {9.60, "GPS 1: probing for u-blox at 230400 baud"},
    {9.62, "GPS 1: detected u-blox"},
    {19.81, :origin},
    {19.81, "EKF3 IMU0 origin set"},
    {19.84, :field_elevation},
    {41.43, "EKF3 IMU0 is using GPS"}
  ]

  @doc "The first moment: boot text and the first mode."
  @spec power_up(Vehicle.t()) :: Vehicle.t()
  def power_up(v) do
    %{v | mode: "STABILIZE"}
    |> Vehicle.act({:bytes, @boot_text})
    |> Vehicle.put_own(:timeline, @timeline)
  end

  @doc "The texts that are due."
  @spec tick(Vehicle.t()) :: Vehicle.t()
  def tick(v) do
    case Vehicle.own(v, :timeline, []) do
      [{at, what} | rest] ->
        if v.now >= at / @recorded_ready * v.ready_us,
          do: v |> send_text(what) |> Vehicle.put_own(:timeline, rest) |> tick(),
          else: v

      [] ->
        v
    end
  end

  @doc "The lines that a ground station gets when it asks for the banner."
  @spec banner(Vehicle.t()) :: Vehicle.t()
  def banner(v) do
    Enum.reduce(
      [@version, "3d1219c7c4c5404aaa1f6d2a48adfda4", "Frame: QUAD/PLUS"],
      v,
      &Vehicle.text(&2, 6, &1)
    )
  end

  defp send_text(v, :origin) do
    v = if v.home, do: v, else: home(v)

    Vehicle.emit(v, %M.GpsGlobalOrigin{
      latitude: v.origin.lat,
      longitude: v.origin.lon,
      altitude: Geo.millimetres(v.origin.alt),
      time_usec: v.now
    })
  end

  defp send_text(v, :field_elevation), do: Vehicle.text(v, 6, "Field Elevation Set: #{round(v.origin.alt)}m")
  defp send_text(v, text), do: Vehicle.text(v, 6, text)

  defp home(v) do
    {lat, lon} = Vehicle.position(v)
    v = %{v | home: %{lat: lat, lon: lon, alt: Vehicle.altitude(v)}}
    Vehicle.emit(v, SimVehicle.Services.Telemetry.message(v, id(HomePosition)))
  end
end
