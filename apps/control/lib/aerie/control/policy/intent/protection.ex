defmodule Aerie.Control.Policy.Intent.Protection do
  @moduledoc """
  Which parameters and files of a vehicle protect it: fences, failsafes, arming checks, the safety switch, avoidance, termination
  and parachutes, by the names of ArduPilot, PX4, Betaflight and iNav. Changing them needs the permission `protection` besides `maintain`.
  """

  # `*` stands for any characters.
  @ardupilot ~w(FENCE_* AVOID_* AVD_* OA_* ADSB_* ARMING_* BRD_SAFETY* DISARM_DELAY FS_* *_FS_* AFS_* CRASH_* CHUTE_* THR_FAILSAFE
    THR_FS* FLTMODE_GCSBLOCK MOT_SAFE* BATT*_LOW_* BATT*_CRT_* BATT*_ARM_* EK*_CHECK_SCALE RC*_OPTION RC_OPTIONS RCMAP_*
    SYSID_ENFORCE SYSID_MYGCS MAV_GCS_SYSID* MAV_OPTIONS SCR_ENABLE)
  @px4 ~w(GF_* NAV_*_ACT NAV_TRAFF_* NAV_MIN_* CBRK_* CP_* FD_* COM_*_ACT COM_*_EXCEPT COM_*_LOSS* COM_ACT_FAIL* COM_ARM_* COM_DISARM_*
    COM_FAIL* COM_FLTT_* COM_FORCE_SAFETY COM_IMB_PROP* COM_KILL_* COM_LKDOWN* COM_LOW_BAT* COM_OB*_ACT COM_PARACHUTE COM_POS*
    COM_PREARM_MODE COM_PREARM_ODID COM_QC_ACT COM_RC_* COM_RCL_* COM_SPOOLUP* COM_VEL_* COM_WIND_* BAT*_CRIT_THR BAT*_EMERGEN_THR BAT*_LOW_THR BAT_*_THR
    RC_MAP_* MAN_KILL_* SYS_FAILURE_* EKF2_REQ_* PWM_*_DIS* PWM_*_FAIL* VT_*QC_* MIS_DIST_*)

  # Betaflight and iNav; the first eleven letters are also those of MAVLink's names (`MavCodec.Msp.ShortName`).
  @msp ~w(FAILSAFE_* GPS_RESCUE_* SMALL_ANGLE AUTO_DISARM* NAV_RTH_* NAV_EXTRA_* SAFEHOME_* GEOZONE_* VBAT_* MIN_CHECK MAX_CHECK
    RX_MIN_USEC RX_MAX_USEC MSP_OVERRI* PREARM_TIM* RECEIVER_T* NAV_LAND_D* NAV_EMERG_*
    RUNAWAY_TA* CRASHFLIP_* YAW_SPIN_RE* LANDING_DIS* AP_* ENABLE_STI* PREARM_ALL* PWR_ON_ARM* USE_VBAT_*
    USE_CBAT_*)

  @patterns Enum.map(Enum.uniq(@ardupilot ++ @px4 ++ @msp), &:binary.split(&1, "*", [:global]))

  # Files that set parameters, missions and fences, and what runs when the autopilot starts.
  @virtual ["@", "/@"]
  @parts ["param", "mission", "fence", "rally", "dataman", "script", ".lua", "etc/", "default", "storage"]

  @doc "Whether a parameter protects the vehicle. ArduPilot does not tell small letters from capitals."
  @spec parameter?(String.t()) :: boolean()
  def parameter?(name) do
    [name | _rest] = :binary.split(name, <<0>>)
    name = String.upcase(name, :ascii)
    Enum.any?(@patterns, &like?(name, &1))
  end

  defp like?(name, [name]), do: true
  defp like?(_name, [_whole]), do: false

  defp like?(name, [start | rest]) do
    size = byte_size(start)

    case name do
      <<^start::binary-size(^size), left::binary>> -> follows?(left, rest)
      _other -> false
    end
  end

  defp follows?(left, [last]), do: last == "" or String.ends_with?(left, last)

  defp follows?(left, [part | rest]) do
    case :binary.split(left, part) do
      [_before, left] -> follows?(left, rest)
      [_without] -> false
    end
  end

  @doc "Whether writing, moving or removing a file changes what protects the vehicle."
  @spec file?(binary()) :: boolean()
  def file?(path) do
    path = String.downcase(path, :ascii)
    String.starts_with?(path, @virtual) or String.contains?(path, @parts)
  end
end
