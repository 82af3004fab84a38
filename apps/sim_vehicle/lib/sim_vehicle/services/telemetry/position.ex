defmodule SimVehicle.Services.Telemetry.Position do
  @moduledoc false

  import MavCodec.MessageId

  alias MavCodec.Messages, as: M
  alias SimVehicle.Vehicle
  alias SimVehicle.Physics.{Geo, Kinematics}
  alias SimVehicle.Services.Telemetry

  @type_mask_position_only 65_016

  @spec message(Vehicle.t(), non_neg_integer) :: struct | nil
  def message(v, id(GpsRawInt)), do: gps_raw(v, gps_fix(v))
  def message(v, id(LocalPositionNed)), do: if(v.home, do: local(v))
  def message(v, id(GlobalPositionInt)), do: global(v)
  def message(v, id(GpsGlobalOrigin)), do: if(v.home, do: origin(v))
  def message(v, id(VfrHud)), do: vfr_hud(v)
  def message(v, id(PositionTargetLocalNed)), do: target_local(v, aim(v.flight, v.mission))
  def message(v, id(PositionTargetGlobalInt)), do: target_global(v, aim(v.flight, v.mission))
  def message(v, id(Altitude)), do: altitude(v)
  def message(v, id(HomePosition)), do: if(v.home, do: home(v))

  @doc "GPS_FIX_TYPE: none until a quarter of the way to ready, then the personality's."
  @spec gps_fix(Vehicle.t()) :: 0..6
  def gps_fix(v) do
    cond do
      MapSet.member?(v.failsafes, :gps) -> 1
      v.now * 4 < v.ready_us -> 0
      v.plans.style == :ardupilot -> 6
      true -> 3
    end
  end

  defp gps_raw(v, fix) when fix < 2 do
    %M.GpsRawInt{
      time_usec: v.now,
      fix_type: fix,
      eph: 65_535,
      epv: 65_535,
      vel: 0,
      cog: 0,
      satellites_visible: 0
    }
  end

  defp gps_raw(v, fix) do
    {lat, lon} = Vehicle.position(v)
    alt = Geo.millimetres(Vehicle.altitude(v))

    %M.GpsRawInt{
      time_usec: v.now,
      fix_type: fix,
      lat: lat,
      lon: lon,
      alt: alt,
      eph: 121,
      epv: 200,
      vel: round(Kinematics.groundspeed(v.kin) * 100),
      cog: Geo.centidegrees(:math.atan2(v.kin.ve, v.kin.vn)),
      satellites_visible: 10,
      alt_ellipsoid: alt,
      h_acc: 300,
      v_acc: 300
    }
  end

  # Before there is a position the firmware sends zeros, not nothing.
  defp global(%{home: nil} = v) do
    %M.GlobalPositionInt{time_boot_ms: Telemetry.boot_ms(v), hdg: Telemetry.heading(v)}
  end

  defp global(v) do
    {lat, lon} = Vehicle.position(v)

    %M.GlobalPositionInt{
      time_boot_ms: Telemetry.boot_ms(v),
      lat: lat,
      lon: lon,
      alt: Geo.millimetres(Vehicle.altitude(v)),
      relative_alt: Geo.millimetres(Vehicle.relative_altitude(v)),
      vx: cm(v.kin.vn),
      vy: cm(v.kin.ve),
      vz: cm(v.kin.vd),
      hdg: Telemetry.heading(v)
    }
  end

  defp local(v) do
    %M.LocalPositionNed{
      time_boot_ms: Telemetry.boot_ms(v),
      x: v.kin.n,
      y: v.kin.e,
      z: v.kin.d,
      vx: v.kin.vn,
      vy: v.kin.ve,
      vz: v.kin.vd
    }
  end

  defp origin(v) do
    %M.GpsGlobalOrigin{
      latitude: v.origin.lat,
      longitude: v.origin.lon,
      altitude: Geo.millimetres(v.origin.alt),
      time_usec: v.now
    }
  end

  defp home(v) do
    {n, e} = Geo.to_local(v.origin, v.home.lat, v.home.lon)

    %M.HomePosition{
      latitude: v.home.lat,
      longitude: v.home.lon,
      altitude: Geo.millimetres(v.home.alt),
      x: n,
      y: e,
      z: v.origin.alt - v.home.alt,
      q: [:nan, :nan, :nan, :nan],
      time_usec: v.now
    }
  end

  defp vfr_hud(v) do
    speed = Kinematics.groundspeed(v.kin)

    %M.VfrHud{
      airspeed: speed,
      groundspeed: speed,
      heading: div(Telemetry.heading(v), 100),
      throttle: if(v.armed, do: round(v.kin.throttle * 100), else: 0),
      alt: if(v.home, do: Vehicle.altitude(v), else: 0.0),
      climb: -v.kin.vd
    }
  end

  defp altitude(v) do
    %M.Altitude{
      time_usec: v.now,
      altitude_monotonic: Vehicle.altitude(v),
      altitude_amsl: Vehicle.altitude(v),
      altitude_local: -v.kin.d,
      altitude_relative: Vehicle.relative_altitude(v),
      altitude_terrain: -v.kin.d,
      bottom_clearance: -v.kin.d
    }
  end

  # Where the vehicle is going, if it is going anywhere.
  defp aim(%{n: n, e: e, d: d, do: kind}, _mission) when kind in [:goto, :takeoff, :hold, :wait],
    do: {n, e, d}

  defp aim(%{do: :steps, steps: [{_tag, goal} | _rest]}, mission), do: aim(goal, mission)
  defp aim(:mission, %{goal: %{} = goal}), do: aim(goal, nil)
  defp aim(_flight, _mission), do: nil

  defp target_local(_v, nil), do: nil

  defp target_local(v, {n, e, d}) do
    %M.PositionTargetLocalNed{
      time_boot_ms: Telemetry.boot_ms(v),
      coordinate_frame: 1,
      type_mask: @type_mask_position_only,
      x: n,
      y: e,
      z: d
    }
  end

  defp target_global(_v, nil), do: nil

  defp target_global(v, {n, e, d}) do
    {lat, lon} = Geo.to_global(v.origin, n, e)

    %M.PositionTargetGlobalInt{
      time_boot_ms: Telemetry.boot_ms(v),
      coordinate_frame: 0,
      type_mask: @type_mask_position_only,
      lat_int: lat,
      lon_int: lon,
      alt: v.origin.alt - d
    }
  end

  defp cm(speed), do: (speed * 100) |> round() |> max(-32_768) |> min(32_767)
end
