defmodule Aerie.Vehicle.Events.Detector.Digest do
  @moduledoc """
  The part of a vehicle's state that events are about. Nothing in it changes all the time, so that the detector need not see
  equal digests. Unknown values are nil.

  `gps`: "OK", or the fix that is too weak; `position`: whether the estimator knows the position; `fence_check`:
  `{breach, name}` of PX4's fence check that fails, or false.
  """

  import Bitwise

  alias Aerie.Vehicle.State
  alias Aerie.Vehicle.Events.Detector
  alias MavCodec.Enums.{EstimatorStatusFlags, GpsFixType}

  @fix_3d GpsFixType.value(:GPS_FIX_TYPE_3D_FIX)
  # The flags of both firmwares' estimators for a relative and an absolute horizontal position.
  @horizontal_position EstimatorStatusFlags.value(:ESTIMATOR_POS_HORIZ_REL) |||
                         EstimatorStatusFlags.value(:ESTIMATOR_POS_HORIZ_ABS)

  @doc "The digest of a state."
  @spec of(State.t()) :: map()
  def of(state) do
    mode = State.data(state, :mode)
    mission = State.data(state, :mission)
    health = State.data(state, :health)
    gps = State.data(state, :gps)

    %{
      mode: mode.mode,
      custom_mode: mode.custom_mode,
      armed: mode.armed,
      in_air: mode.in_air,
      failsafe: mode.failsafe,
      system_status: mode.system_status,
      fence_on: health.fence_enabled,
      fence_breach: mission.fence_breach,
      fence_breach_type: mission.fence_breach_type,
      mission_seq: mission.seq,
      mission_total: mission.total,
      mission_state: mission.state,
      gps: if(gps.fix, do: if(gps.fix >= @fix_3d, do: "OK", else: gps.fix_name)),
      position: if(health.ekf, do: (health.ekf.flags &&& @horizontal_position) != 0),
      rc_receiver: health.rc_receiver,
      fence_check: if(health.arming_checks, do: fence_check(health.arming_checks))
    }
    |> Map.merge(Detector.Batteries.digest(state))
  end

  defp fence_check(checks), do: Enum.find_value(checks, false, &violation(&1.name))
  defp violation("check_gf_violation_" <> what = name), do: {String.upcase(what), name}
  defp violation(_other), do: nil

  @doc """
  Data that events need besides the digest, however often it changes: the position, the batteries' voltages, and
  whether one that is disarmed now would fall.
  """
  @spec beside(State.t()) :: map()
  def beside(state),
    do: %{
      where: position(state),
      voltages: Detector.Batteries.voltages(state),
      aloft: State.Flight.aloft?(state)
    }

  @doc "The position as event data; nil if it is not known."
  @spec position(State.t()) :: map() | nil
  def position(state) do
    case State.data(state, :position) do
      %{lat: nil} ->
        nil

      %{lat: lat, lon: lon} = p ->
        %{"lat" => lat, "lon" => lon, "alt_msl" => p.alt_msl, "alt_rel" => p.alt_rel}
    end
  end
end
