defmodule MavCodec.Meaning.Commands.Payload do
  @moduledoc "Commands for cameras, gimbals and outputs: rows of `MavCodec.Meaning.Commands`."

  alias MavCodec.Meaning.Commands.Row

  @doc false
  @spec rows() :: [{atom(), Row.permission(), keyword()}]
  def rows, do: outputs() ++ cameras() ++ videos() ++ gimbals()

  defp outputs do
    [
      {:DO_SET_RELAY, :payload, []},
      {:DO_REPEAT_RELAY, :payload, []},
      {:DO_SET_SERVO, :payload, []},
      {:DO_REPEAT_SERVO, :payload, []},
      {:DO_SET_ACTUATOR, :payload, []},
      {:DO_GRIPPER, :payload, []},
      {:DO_WINCH, :payload, []},
      {:DO_SPRAYER, :payload, []},
      {:ILLUMINATOR_ON_OFF, :payload, []},
      {:DO_ILLUMINATOR_CONFIGURE, :payload, []},
      {:PAYLOAD_CONTROL_DEPLOY, :payload, []},
      {:PAYLOAD_CONTROL, :payload, []},
      {:QSHOT_DO_CONFIGURE, :payload, []}
    ]
  end

  defp cameras do
    [
      {:DO_DIGICAM_CONFIGURE, :payload, []},
      {:DO_DIGICAM_CONTROL, :payload, []},
      {:DO_SET_CAM_TRIGG_DIST, :payload, []},
      {:DO_SET_CAM_TRIGG_INTERVAL, :payload, []},
      {:DO_TRIGGER_CONTROL, :payload, []},
      {:OBLIQUE_SURVEY, :payload, []},
      {:IMAGE_START_CAPTURE, :payload, []},
      {:IMAGE_STOP_CAPTURE, :payload, []},
      {:PANORAMA_CREATE, :payload, []},
      {:SET_CAMERA_MODE, :payload, []},
      {:SET_CAMERA_ZOOM, :payload, []},
      {:SET_CAMERA_FOCUS, :payload, []},
      {:SET_CAMERA_SOURCE, :payload, []},
      {:SET_STORAGE_USAGE, :payload, []},
      {:STORAGE_FORMAT, :payload, []},
      {:RESET_CAMERA_SETTINGS, :payload, []},
      {:CAMERA_TRACK_POINT, :payload, []},
      {:CAMERA_TRACK_RECTANGLE, :payload, []},
      {:CAMERA_STOP_TRACKING, :payload, []},
      {:CAMERA_START_MTI, :payload, []},
      {:CAMERA_STOP_MTI, :payload, []},
      {:REQUEST_CAMERA_INFORMATION, :telemetry, class: :question},
      {:REQUEST_CAMERA_SETTINGS, :telemetry, class: :question},
      {:REQUEST_STORAGE_INFORMATION, :telemetry, class: :question},
      {:REQUEST_CAMERA_CAPTURE_STATUS, :telemetry, class: :question},
      {:REQUEST_CAMERA_IMAGE_CAPTURE, :telemetry, class: :question}
    ]
  end

  defp videos do
    [
      {:DO_CONTROL_VIDEO, :payload, []},
      {:VIDEO_START_CAPTURE, :payload, []},
      {:VIDEO_STOP_CAPTURE, :payload, []},
      {:VIDEO_START_STREAMING, :payload, []},
      {:VIDEO_STOP_STREAMING, :payload, []},
      {:REQUEST_VIDEO_STREAM_INFORMATION, :telemetry, class: :question},
      {:REQUEST_VIDEO_STREAM_STATUS, :telemetry, class: :question}
    ]
  end

  defp gimbals do
    [
      {:DO_SET_ROI_LOCATION, :payload, []},
      {:DO_SET_ROI_WPNEXT_OFFSET, :payload, []},
      {:DO_SET_ROI_NONE, :payload, []},
      {:DO_SET_ROI_SYSID, :payload, []},
      {:DO_SET_ROI, :payload, []},
      {:SPATIAL_USER_1, :maintain, []},
      {:SPATIAL_USER_2, :maintain, []},
      {:SPATIAL_USER_3, :maintain, []},
      {:SPATIAL_USER_4, :maintain, []},
      {:SPATIAL_USER_5, :maintain, []},
      {:DO_MOUNT_CONFIGURE, :payload, []},
      {:DO_MOUNT_CONTROL, :payload, []},
      {:DO_MOUNT_CONTROL_QUAT, :payload, []},
      {:DO_GIMBAL_MANAGER_PITCHYAW, :payload, []},
      {:DO_GIMBAL_MANAGER_CONFIGURE, :payload, []},
      {:STORM32_DO_GIMBAL_MANAGER_CONTROL_PITCHYAW, :payload, []},
      {:STORM32_DO_GIMBAL_MANAGER_SETUP, :payload, []},
      {:GIMBAL_RESET, :maintain, []},
      {:GIMBAL_FULL_RESET, :maintain, []},
      {:GIMBAL_AXIS_CALIBRATION_STATUS, :maintain, []},
      {:GIMBAL_REQUEST_AXIS_CALIBRATION, :maintain, []}
    ]
  end
end
