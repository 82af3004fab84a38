defmodule Aerie.Vehicle.State.HighLatency do
  @moduledoc """
  HIGH_LATENCY2, the only message that comes by a satellite link (X6): a summary without a heartbeat. What firmwares put
  into it differs (`Aerie.Vehicle.Firmware.Telemetry`).
  """
  @behaviour Aerie.Vehicle.State.Group

  import Bitwise

  alias Aerie.Vehicle.Firmware.Modes
  alias Aerie.Vehicle.Firmware
  alias Aerie.Vehicle.Protocol.Kind
  alias Aerie.Vehicle.State.{Group, Value}
  alias Aerie.Vehicle.State.Groups.Battery
  alias MavCodec.Enums.{HlFailureFlag, MavModeFlag}
  alias MavCodec.Messages, as: M

  @safety_armed MavModeFlag.value(:MAV_MODE_FLAG_SAFETY_ARMED)
  @geofence HlFailureFlag.value(:HL_FAILURE_FLAG_GEOFENCE)

  @impl Group
  def read(%M.HighLatency2{} = m, state, at) do
    with {lat, lon} <- Value.lat_lon(m.latitude, m.longitude) || {nil, nil} do
      autopilot = Firmware.heard(m.autopilot)
      kind = Kind.name(m.type)
      telemetry = Firmware.telemetry(autopilot)
      mode = m.custom_mode <<< telemetry.high_latency_shift

      {[autopilot: autopilot, type: m.type, kind: kind, high_latency: true],
       [
         mode: armed(%{mode: Modes.name(autopilot, kind, 1, mode), custom_mode: mode}, telemetry, m),
         position: %{lat: lat, lon: lon, alt_msl: m.altitude * 1.0, heading: heading(m.heading)},
         velocity: %{
           groundspeed: m.groundspeed / 5,
           airspeed: m.airspeed / 5,
           climb: m.climb_rate / 10,
           throttle: Value.up_to(m.throttle, 100, 100)
         },
         gps: %{
           lat: lat,
           lon: lon,
           alt_msl: m.altitude * 1.0,
           h_acc: decimetres(m.eph),
           v_acc: decimetres(m.epv)
         },
         mission: mission(m),
         health: %{unhealthy: failures(m.failure_flags)}
       ] ++ Battery.summary(%{remaining: if(m.battery in 0..100, do: m.battery / 100)}, state, at)}
    else
      :invalid -> {:invalid, :high_latency2}
    end
  end

  defp armed(mode, %{high_latency_armed?: true}, m),
    do: Map.put(mode, :armed, (m.custom0 &&& @safety_armed) != 0)

  defp armed(mode, _telemetry, _m), do: mode

  # Among the failures only the fence has a field of its own.
  defp mission(m) do
    %{
      seq: Value.unsigned(m.wp_num, 16),
      wp_distance: Value.unsigned(m.target_distance, 16, 0.1),
      fence_breach: (m.failure_flags &&& @geofence) != 0
    }
  end

  defp failures(flags) do
    {names, unknown} = HlFailureFlag.flags(flags)
    named = for name <- names, do: name |> Atom.to_string() |> String.replace_prefix("HL_FAILURE_FLAG_", "")
    named ++ if(unknown == 0, do: [], else: ["FLAGS(#{unknown})"])
  end

  # In two degrees. More than a circle is unknown.
  defp heading(half) when half <= 180, do: rem(half * 2, 360) * 1.0
  defp heading(_unknown), do: nil

  defp decimetres(value), do: Value.unsigned(value, 8, 10)
end
