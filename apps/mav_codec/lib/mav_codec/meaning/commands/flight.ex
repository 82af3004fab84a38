defmodule MavCodec.Meaning.Commands.Flight do
  @moduledoc "Commands that arm, fly, and end a flight, and those of missions: rows of `MavCodec.Meaning.Commands`."

  alias MavCodec.Meaning.Commands.Row

  @byte {:index, 0, 255}
  @forever {:index, -1, 65_535}

  @doc false
  @spec rows() :: [{atom(), Row.permission(), keyword()}]
  def rows, do: navigation() ++ conditions() ++ modes() ++ targets() ++ missions() ++ ends()

  defp navigation do
    [
      {:NAV_WAYPOINT, :fly, place: :flown},
      {:NAV_LOITER_UNLIM, :fly, place: :flown},
      {:NAV_LOITER_TURNS, :fly, place: :flown},
      {:NAV_LOITER_TIME, :fly, place: :flown},
      {:NAV_RETURN_TO_LAUNCH, :fly, []},
      {:NAV_LAND, :fly, as_item: :flown},
      {:NAV_TAKEOFF, :fly, place: :flown},
      {:NAV_LAND_LOCAL, :fly, as_item: :anywhere},
      {:NAV_TAKEOFF_LOCAL, :fly, place: :anywhere},
      {:NAV_FOLLOW, :fly, place: :anywhere},
      {:NAV_CONTINUE_AND_CHANGE_ALT, :fly, place: :height},
      {:NAV_LOITER_TO_ALT, :fly, place: :flown},
      {:NAV_ARC_WAYPOINT, :fly, place: :flown},
      {:NAV_ROI, :payload, []},
      {:NAV_PATHPLANNING, :fly, place: :flown},
      {:NAV_SPLINE_WAYPOINT, :fly, place: :flown},
      {:NAV_ALTITUDE_WAIT, :fly, []},
      {:NAV_VTOL_TAKEOFF, :fly, place: :flown},
      {:NAV_VTOL_LAND, :fly, as_item: :flown},
      # The commands of the program that then steers are judged separately.
      {:NAV_GUIDED_ENABLE, :fly, []},
      {:NAV_DELAY, :mission, []},
      {:NAV_PAYLOAD_PLACE, :fly, place: :flown},
      {:NAV_LAST, :mission, []},
      {:NAV_SET_YAW_SPEED, :manual, as_item: :anywhere},
      {:NAV_ATTITUDE_TIME, :manual, as_item: :anywhere},
      # A script may do everything.
      {:NAV_SCRIPT_TIME, :maintain, place: :anywhere},
      {:WAYPOINT_USER_1, :maintain, place: :flown},
      {:WAYPOINT_USER_2, :maintain, place: :flown},
      {:WAYPOINT_USER_3, :maintain, place: :flown},
      {:WAYPOINT_USER_4, :maintain, place: :flown},
      {:WAYPOINT_USER_5, :maintain, place: :flown}
    ]
  end

  defp conditions do
    [
      {:CONDITION_DELAY, :mission, []},
      {:CONDITION_CHANGE_ALT, :fly, place: :height},
      {:CONDITION_DISTANCE, :mission, []},
      {:CONDITION_YAW, :fly, []},
      {:CONDITION_LAST, :mission, []},
      {:CONDITION_GATE, :mission, []}
    ]
  end

  defp modes do
    [
      # How large a custom mode may be depends on the firmware.
      {:DO_SET_MODE, :fly, numbers: [{2, {:index, 0, 16_777_215}}, {3, {:index, 0, 16_777_215}}]},
      {:DO_SET_STANDARD_MODE, :fly, []},
      {:SET_GUIDED_SUBMODE_STANDARD, :fly, []},
      {:SET_GUIDED_SUBMODE_CIRCLE, :fly, place: :flown},
      {:DO_VTOL_TRANSITION, :fly, numbers: [{2, @byte}]},
      {:DO_INVERTED_FLIGHT, :fly, []},
      {:DO_SET_REVERSE, :fly, []},
      {:DO_AUTOTUNE_ENABLE, :fly, []},
      {:DO_GUIDED_LIMITS, :fly, []},
      {:DO_GUIDED_MASTER, :maintain, []},
      {:AIRFRAME_CONFIGURATION, :fly, []},
      {:DO_ADSB_OUT_IDENT, :fly, []},
      {:ODID_SET_EMERGENCY, :fly, []},
      {:SOLO_BTN_FLY_CLICK, :fly, []},
      {:SOLO_BTN_FLY_HOLD, :fly, place: :anywhere},
      {:SOLO_BTN_PAUSE_CLICK, :fly, []}
    ]
  end

  defp targets do
    [
      {:DO_FOLLOW, :fly, place: :anywhere},
      {:DO_FOLLOW_REPOSITION, :fly, place: :anywhere},
      {:DO_ORBIT, :fly, place: :flown},
      {:DO_FIGURE_EIGHT, :fly, place: :flown},
      {:DO_CHANGE_SPEED, :fly, []},
      {:DO_SET_HOME, :fly, place: :stored},
      {:DO_CHANGE_ALTITUDE, :fly, as_item: :height},
      {:DO_REPOSITION, :fly, place: :flown},
      {:DO_GO_AROUND, :fly, place: :climb},
      {:DO_RALLY_LAND, :fly, place: :climb},
      {:OVERRIDE_GOTO, :fly, as_item: :flown},
      {:GUIDED_CHANGE_SPEED, :fly, []},
      {:GUIDED_CHANGE_ALTITUDE, :fly, place: :height},
      {:GUIDED_CHANGE_HEADING, :fly, place: :anywhere},
      {:PAYLOAD_PREPARE_DEPLOY, :fly, place: :flown}
    ]
  end

  defp missions do
    [
      {:MISSION_START, :mission, []},
      {:DO_SET_MISSION_CURRENT, :mission, []},
      {:DO_JUMP, :mission, numbers: [{2, @forever}]},
      {:DO_JUMP_TAG, :mission, numbers: [{2, @forever}]},
      {:JUMP_TAG, :mission, []},
      {:DO_LAND_START, :mission, as_item: :stored},
      {:DO_RETURN_PATH_START, :mission, as_item: :stored},
      {:DO_PAUSE_CONTINUE, :mission, []},
      {:DO_SET_RESUME_REPEAT_DIST, :mission, []},
      {:DO_LAST, :mission, []},
      {:NAV_FENCE_RETURN_POINT, :mission, as_item: :stored},
      {:NAV_FENCE_POLYGON_VERTEX_INCLUSION, :mission, as_item: :stored},
      {:NAV_FENCE_POLYGON_VERTEX_EXCLUSION, :mission, []},
      {:NAV_FENCE_CIRCLE_INCLUSION, :mission, as_item: :stored},
      {:NAV_FENCE_CIRCLE_EXCLUSION, :mission, []},
      {:NAV_FENCE_HOME_CIRCLE_INCLUSION, :mission, []},
      {:NAV_RALLY_POINT, :mission, as_item: :stored}
    ]
  end

  # Commands that start, end and protect flights.
  defp ends do
    [
      {:COMPONENT_ARM_DISARM, :arm, numbers: [{2, {:values, [0, 2989, 21_196]}}]},
      {:ARM_AUTHORIZATION_REQUEST, :arm, []},
      {:DO_FLIGHTTERMINATION, :terminate, []},
      {:DO_PARACHUTE, :terminate, []},
      {:PRS_SET_ARM, :terminate, numbers: [{1, @byte}]},
      {:PRS_SET_ARM_ALTI, :terminate, []},
      {:PRS_SHUTDOWN, :protection, []},
      {:PRS_GET_ARM, :telemetry, class: :question},
      {:PRS_GET_BATTERY, :telemetry, class: :question},
      {:PRS_GET_ERR, :telemetry, class: :question},
      {:PRS_GET_ARM_ALTI, :telemetry, class: :question},
      {:DO_FENCE_ENABLE, :mission, []},
      {:DO_SET_SAFETY_SWITCH_STATE, :protection, []},
      {:INJECT_FAILURE, :protection, []},
      {:DO_ENGINE_CONTROL, :arm, []},
      # By function, some of which end a flight.
      {:DO_AUX_FUNCTION, :payload, numbers: [{1, {:index, 0, 65_535}}]},
      {:REQUEST_OPERATOR_CONTROL, :fly, numbers: [{1, {:values, [0, 1]}}, {2, {:values, [0, 1]}}, {4, @byte}]}
    ]
  end
end
