defmodule Aerie.CommandTrials.Standing do
  @moduledoc "What `Aerie.CommandTrials` tries before the vehicle is armed."

  import Aerie.CommandTrials.Row

  @lat -35.363261
  @lon 149.165230
  @msl 584.0

  # MAVSDK moves ArduPilot's actuators so.
  @do_set_servo 183

  @no_method {:no, "no method"}
  @no_gimbal {:no, "its gimbal plugin needs a gimbal that announces itself"}
  @no_camera {:no, "its camera plugin needs a camera that announces itself"}

  @doc "The rows; `by` chooses between ArduPilot's and PX4's."
  @spec rows((term(), term() -> term())) :: [Aerie.CommandTrials.Row.t()]
  def rows(by), do: Enum.concat([ground(by), workshop(by), payload(by), control()])

  defp ground(by) do
    [
      row("request_message", %{message_id: 148}, long("REQUEST_MESSAGE", [148]), :completed, 0,
        mavsdk: "telemetry.get_gps_global_origin"
      ),
      row(
        "set_message_interval",
        %{message_id: 30, rate: 4},
        long("SET_MESSAGE_INTERVAL", [30, 250_000]),
        :accepted,
        0,
        mavsdk: {"telemetry.set_rate_attitude_euler", [4.0]}
      ),
      row("high_latency", %{enabled: true}, long("CONTROL_HIGH_LATENCY", [1]), :rejected, 3,
        mavsdk: @no_method
      ),
      row("prearm_check", %{}, long("RUN_PREARM_CHECKS", []), :accepted, 0, mavsdk: @no_method),
      row("set_home", %{here: true}, long("DO_SET_HOME", [1]), :completed, 0,
        mavsdk: {"action.set_home", [true, 0.0, 0.0, 0.0]}
      ),
      row(
        "set_origin",
        %{lat: @lat, lon: @lon, altitude_msl: @msl},
        message("set_gps_global_origin", %{latitude: e7(@lat), longitude: e7(@lon), altitude: 584_000}),
        :unknown,
        nil,
        mavsdk: {"action.set_gps_global_origin", [@lat, @lon, @msl]},
        result: "TIMEOUT"
      ),
      row(
        "set_geofence",
        %{enabled: false},
        long("DO_FENCE_ENABLE", [0]),
        by.(:accepted, :rejected),
        by.(0, 3),
        mavsdk: @no_method
      )
    ]
  end

  defp workshop(by) do
    test = by.(long("DO_MOTOR_TEST", [1, 0, 10, 1]), long("ACTUATOR_TEST", [0.1, 1, 0, 0, 1]))

    [
      row("motor_test", %{motor: 1, throttle: 0.1, duration: 1}, test, :rejected, by.(3, 2),
        mavsdk: @no_method
      ),
      row("rx_pair", %{receiver: "dsmx"}, long("START_RX_PAIR", [0, 1]), :rejected, 3, mavsdk: @no_method),
      row("save_params", %{}, long("PREFLIGHT_STORAGE", [1]), by.(:rejected, :accepted), by.(3, 0),
        mavsdk: @no_method
      ),
      row("reset_params", %{}, long("PREFLIGHT_STORAGE", [2]), by.(:rejected, :accepted), by.(3, 0),
        mavsdk: @no_method
      ),
      row(
        "calibrate_cancel",
        %{},
        by.(long("DO_CANCEL_MAG_CAL", []), long("PREFLIGHT_CALIBRATION", [])),
        :accepted,
        0,
        mavsdk: {:no, "cancels only a calibration that it began and that still runs"}
      ),
      row(
        "calibrate",
        %{sensor: "gyro"},
        long("PREFLIGHT_CALIBRATION", [1]),
        by.(:accepted, :completed),
        0,
        mavsdk: "calibration.calibrate_gyro",
        result: by.("UNSUPPORTED", "SUCCESS")
      ),
      row(
        "calibrate_position",
        %{position: "level"},
        long("ACCELCAL_VEHICLE_POS", [1]),
        by.(:failed, :rejected),
        by.(4, 3),
        mavsdk: @no_method
      ),
      row("calibrate_accept", %{}, long("DO_ACCEPT_MAG_CAL", []), :rejected, 3, mavsdk: @no_method)
    ]
  end

  defp payload(by) do
    [
      row("camera_photo", %{}, long("IMAGE_START_CAPTURE", [0, 0, 1]), by.(:rejected, :unknown), 3,
        mavsdk: @no_camera
      ),
      row("camera_video", %{}, long("VIDEO_START_CAPTURE", []), by.(:rejected, :unknown), 3,
        mavsdk: @no_camera
      ),
      row("camera_trigger", %{}, long("DO_DIGICAM_CONTROL", [0, 0, 0, 0, 1]), :rejected, 3,
        mavsdk: @no_method
      ),
      row("camera_trigger_distance", %{distance: 10}, long("DO_SET_CAM_TRIGG_DIST", [10]), :rejected, 3,
        mavsdk: @no_method
      ),
      row(
        "gimbal",
        %{pitch: -30, yaw: 0},
        long("DO_GIMBAL_MANAGER_PITCHYAW", [-30, 0, nil, nil, 32]),
        :accepted,
        0,
        mavsdk: @no_gimbal
      ),
      row("gripper", %{action: "grab"}, long("DO_GRIPPER", [1, 1]), by.(:rejected, :rejected), 3,
        mavsdk: {"gripper.grab", [1]},
        result: "UNSUPPORTED"
      ),
      row(
        "servo",
        %{channel: 9, pwm: 1500},
        long("DO_SET_SERVO", [9, 1500]),
        by.(:accepted, :rejected),
        0,
        mavsdk: @no_method
      ),
      row(
        "actuator",
        %{actuator: 1, value: 0.5},
        long("DO_SET_ACTUATOR", [0.5]),
        by.(:rejected, :accepted),
        by.(3, 0),
        mavsdk: {"action.set_actuator", [1, 0.5]},
        mavsdk_hears: by.(@do_set_servo, nil)
      ),
      row("relay", %{relay: 0, on: true}, long("DO_SET_RELAY", [0, 1]), by.(:accepted, :rejected), by.(0, 3),
        mavsdk: {"action.set_relay", [0, 0]},
        result: by.("SUCCESS", "UNSUPPORTED")
      ),
      row("parachute", %{action: "disable"}, long("DO_PARACHUTE", [0]), by.(:failed, :rejected), by.(4, 3),
        mavsdk: @no_method
      ),
      row("vtol_transition", %{to: "fixed_wing"}, long("DO_VTOL_TRANSITION", [4]), :rejected, by.(3, nil),
        mavsdk: {:no, "decides by itself that it is not a VTOL, and asks nobody"}
      )
    ]
  end

  # The gateway answers these itself; nothing reaches the vehicle.
  defp control do
    [
      row("take_control", %{}, long("REQUEST_OPERATOR_CONTROL", [1, 0]), :completed, 0,
        mavsdk: @no_method,
        hears: nil
      ),
      row("hand_over_control", %{}, long("REQUEST_OPERATOR_CONTROL", [1, 1]), :completed, 0,
        mavsdk: @no_method,
        hears: nil
      ),
      row("release_control", %{}, long("REQUEST_OPERATOR_CONTROL", [0]), :completed, 0,
        mavsdk: @no_method,
        hears: nil
      )
    ]
  end
end
