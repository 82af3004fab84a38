defmodule Aerie.Vehicle.Detector.Digest do
  @moduledoc """
  What of a vehicle's state the detector looks at: nothing that changes all the time, so that equal digests need not be
  observed twice. What is unknown is nil.

  `gps` is "OK" or the fix that is not enough; `position`: whether the estimator knows where it is; `fence_check`: PX4's check
  of its fence that fails, as it is told and by its name, or false.
  """

  import Bitwise

  alias Aerie.Vehicle.{Detector, State}

  # GPS_FIX_TYPE
  @fix_3d 3
  # Both firmwares' estimators: horizontal position relative, absolute.
  @somewhere 0x18

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
      fence_breach: mission.fence_breach,
      fence_breach_type: mission.fence_breach_type,
      mission_seq: mission.seq,
      mission_total: mission.total,
      mission_state: mission.state,
      gps: if(gps.fix, do: if(gps.fix >= @fix_3d, do: "OK", else: gps.fix_name)),
      position: if(health.ekf, do: (health.ekf.flags &&& @somewhere) != 0),
      rc_receiver: health.rc_receiver,
      fence_check: if(health.arming_checks, do: fence_check(health.arming_checks))
    }
    |> Map.merge(Detector.Batteries.digest(state))
  end

  defp fence_check(checks), do: Enum.find_value(checks, false, &violation(&1.name))
  defp violation("check_gf_violation_" <> what = name), do: {String.upcase(what), name}
  defp violation(_other), do: nil

  @doc "What is shown beside a digest for the data of events, however often it changes."
  @spec beside(State.t()) :: map()
  def beside(state), do: %{where: position(state), voltages: Detector.Batteries.voltages(state)}

  @doc "Where the vehicle is, for the data of events; nil when it does not know."
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
