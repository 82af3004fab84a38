defmodule Aerie.Vehicle.Reports.Names do
  @moduledoc """
  Names of EVENT ids.

  The upper 8 bits of an id are a name space (the component that defines it; 0 for those in common), the lower 24 bits are,
  in PX4, the 32-bit FNV-1a hash of the event's name without its upper 8 bits. So a name that is known gives the id of the
  event in every version of the firmware that has it. An event of another name keeps its number.
  """

  import Bitwise

  @px4 ~w(
    check_battery_critical check_battery_disconnected check_battery_emergency check_battery_low check_battery_missing
    check_estimator_gps_fix_too_low check_estimator_missing_data check_failure_detector_arm_esc
    check_failure_detector_roll check_mag_missing check_modes_angular_velocity check_modes_attitude
    check_modes_cannot_takeoff check_modes_global_pos check_modes_home_position check_modes_local_alt
    check_modes_local_pos check_modes_manual_control check_modes_mission check_modes_not_supported
    check_modes_offboard_signal check_rc_dl_no_dllink check_rc_dl_no_rc check_system_arm_auth_failed
    check_system_avoidance_not_ready check_system_flight_term_active check_system_no_global_pos
    check_system_no_home_pos check_system_safety_button check_system_usb_connected check_system_vtol_in_fw_mode
    check_system_vtol_in_transition commander_arm_denied_calibrating commander_arm_denied_resolve_failures
    commander_arm_denied_throttle_center commander_armed_by commander_arming_check_summary
    commander_disarm_denied_not_landed commander_disarmed_by commander_failsafe_enter
    commander_failsafe_enter_generic_hold commander_failsafe_enter_hold commander_failsafe_enter_low_bat
    commander_health_summary commander_landing_current_pos commander_landing_detected commander_load_param_failed
    commander_low_bat_shutdown_failed commander_mission_start_denied_no_mission commander_modeswitch_not_avail
    commander_rtl commander_takeoff_detected commander_transition_denied commander_unsupported_arm_disarm_param
    commander_unsupported_auto_mode logger_open_file_time mavlink_mission_mis_item_invalid mission_climb_before_start
    mission_execute mission_finished_loiter navigator_course_gps_lost navigator_geofence_invalid_against_home
    navigator_geofence_max_dist_from_home navigator_mis_first_wp_far navigator_mis_no_pos_lock
    navigator_mis_takeoff_missing navigator_reposition_outside_geofence navigator_takeoff_default_alt
    navigator_traffic_expired navigator_traffic_ignore rtl_climb_to rtl_completed_loiter rtl_failed_to_read_land_item
    rtl_land_at_destination rtl_mission_land_climb vrtl_return_at
  )

  # Numbered, not hashed.
  @common %{
    1100 => "cal_progress",
    1101 => "cal_orientation_detected",
    1102 => "cal_orientation_done",
    1103 => "cal_done"
  }

  @space 1 <<< 24
  hash = fn name ->
    for <<byte <- name>>, reduce: 0x811C9DC5 do
      hash -> rem(bxor(hash, byte) * 0x01000193, 1 <<< 32)
    end
  end

  @names Map.merge(@common, Map.new(@px4, &{@space + (hash.(&1) &&& 0xFFFFFF), &1}))

  @doc "The name of an event, nil when it is not known."
  @spec name(non_neg_integer()) :: String.t() | nil
  def name(id), do: Map.get(@names, id)

  @doc "All names that are known, by id."
  @spec all() :: %{non_neg_integer() => String.t()}
  def all, do: @names
end
