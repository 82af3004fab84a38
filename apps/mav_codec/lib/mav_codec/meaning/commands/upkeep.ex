defmodule MavCodec.Meaning.Commands.Upkeep do
  @moduledoc "Commands for the workshop, for estimators, and for messages: rows of `MavCodec.Meaning.Commands`."

  alias MavCodec.Meaning.Commands.Row

  @byte {:index, 0, 255}

  @doc false
  @spec rows() :: [{atom(), Row.permission(), keyword()}]
  def rows, do: messages() ++ estimators() ++ calibration() ++ workshop() ++ others()

  defp messages do
    [
      {:GET_HOME_POSITION, :telemetry, class: :question},
      {:GET_MESSAGE_INTERVAL, :telemetry, class: :question},
      {:REQUEST_MESSAGE, :telemetry, class: :question},
      {:REQUEST_PROTOCOL_VERSION, :telemetry, class: :question},
      {:REQUEST_AUTOPILOT_CAPABILITIES, :telemetry, class: :question},
      {:REQUEST_FLIGHT_INFORMATION, :telemetry, class: :question},
      {:UAVCAN_GET_NODE_INFO, :telemetry, class: :question},
      {:DO_SEND_BANNER, :telemetry, class: :question},
      {:SET_MESSAGE_INTERVAL, :telemetry, []},
      {:CONTROL_HIGH_LATENCY, :telemetry, []},
      {:LOGGING_START, :telemetry, []},
      {:LOGGING_STOP, :telemetry, []},
      {:RUN_PREARM_CHECKS, :telemetry, []}
    ]
  end

  # Commands that set the vehicle's estimate of itself and of the world.
  defp estimators do
    [
      {:EXTERNAL_ATTITUDE_ESTIMATE, :sensors, []},
      {:EXTERNAL_POSITION_ESTIMATE, :sensors, []},
      {:EXTERNAL_WIND_ESTIMATE, :sensors, []},
      {:SET_HAGL, :sensors, []},
      {:ESTIMATOR_SENSOR_ENABLE, :protection, []},
      {:SET_EKF_SOURCE_SET, :maintain, []},
      {:DO_SET_GLOBAL_ORIGIN, :maintain, []},
      # A charge that is made up keeps the battery's failsafe away.
      {:BATTERY_RESET, :protection, []}
    ]
  end

  defp calibration do
    [
      {:PREFLIGHT_CALIBRATION, :maintain, []},
      {:PREFLIGHT_SET_SENSOR_OFFSETS, :maintain, []},
      {:FIXED_MAG_CAL, :maintain, []},
      {:FIXED_MAG_CAL_FIELD, :maintain, []},
      {:FIXED_MAG_CAL_YAW, :maintain, []},
      {:DO_START_MAG_CAL, :maintain, []},
      {:DO_ACCEPT_MAG_CAL, :maintain, []},
      {:DO_CANCEL_MAG_CAL, :maintain, []},
      {:ACCELCAL_VEHICLE_POS, :maintain, numbers: [{1, :any}]}
    ]
  end

  defp workshop do
    [
      {:DO_MOTOR_TEST, :maintain, []},
      # Ground stations add 1000 to functions of PX4's own.
      {:ACTUATOR_TEST, :maintain, numbers: [{5, {:index, 0, 65_535}}]},
      {:ACTUATOR_GROUP_TEST, :maintain, []},
      {:CONFIGURE_ACTUATOR, :maintain, numbers: [{5, {:index, 0, 65_535}}]},
      {:PREFLIGHT_UAVCAN, :maintain, []},
      {:PREFLIGHT_STORAGE, :maintain, numbers: [{2, {:index, 0, 4}}]},
      {:PREFLIGHT_STORAGE_ADVANCED, :protection, []},
      {:PREFLIGHT_REBOOT_SHUTDOWN, :maintain, []},
      {:FLASH_BOOTLOADER, :maintain, []},
      {:START_RX_PAIR, :maintain, []},
      {:DO_SET_PARAMETER, :maintain, []},
      {:DO_SET_SYS_CMP_ID, :maintain, []},
      {:SET_FACTORY_TEST_MODE, :maintain, []},
      # It stops the autopilot where it is.
      {:DEBUG_TRAP, :force_disarm, []},
      {:POWER_OFF_INITIATED, :maintain, []},
      {:CAN_FORWARD, :maintain, numbers: [{1, @byte}]},
      {:SCRIPTING, :maintain, []},
      {:DO_SEND_SCRIPT_MESSAGE, :maintain, []}
    ]
  end

  defp others do
    [
      {:LOWEHEISER_SET_STATE, :maintain, []},
      {:RESET_MPPT, :maintain, []},
      {:DUMMY_ALL, :maintain, []},
      {:USER_1, :maintain, []},
      {:USER_2, :maintain, []},
      {:USER_3, :maintain, []},
      {:USER_4, :maintain, []},
      {:USER_5, :maintain, []}
    ]
  end
end
