defmodule Aerie.Vehicle.Command.Types.Maintenance do
  @moduledoc "Commands for the workshop, and for messages: rows of `Aerie.Vehicle.Command.Types`."

  import Aerie.Vehicle.Command.Types.Shared

  alias Aerie.Vehicle.Command.{Param, Type}

  @sensors ~w(gyro accelerometer accelerometer_simple level magnetometer barometer airspeed rc esc compass_motor)

  @doc false
  @spec rows() :: [Type.t()]
  def rows, do: workshop() ++ calibration() ++ messages()

  defp workshop do
    [
      %Type{
        name: "prearm_check",
        group: :maintenance,
        meaning: "Runs the checks before arming; what they find comes as texts and reports.",
        mav_cmds: ~w(RUN_PREARM_CHECKS)a,
        permission: :telemetry
      },
      %Type{
        name: "motor_test",
        group: :maintenance,
        meaning: "Turns one motor. Take the propellers off.",
        mav_cmds: ~w(DO_MOTOR_TEST ACTUATOR_TEST ACTUATOR_GROUP_TEST CONFIGURE_ACTUATOR PREFLIGHT_UAVCAN)a,
        permission: :maintain,
        retry: :never,
        moves_vehicle?: true,
        params: [
          Param.integer(:motor, nil, 1, 16, "which motor, in the firmware's order", required: true),
          Param.number(:throttle, "0..1", 0, 1, "share of full throttle", required: true),
          Param.number(:duration, "s", 0.1, 3, "for how long", required: true)
        ]
      },
      %Type{
        name: "reboot",
        group: :maintenance,
        meaning: "Restarts the autopilot. An armed vehicle refuses.",
        mav_cmds: ~w(PREFLIGHT_REBOOT_SHUTDOWN FLASH_BOOTLOADER)a,
        permission: :maintain,
        retry: :never,
        confirmed_by: "its clock starts again",
        params: [
          Param.choice(
            :to,
            ~w(normal bootloader),
            "whether it stays in its boot loader, where firmware is loaded",
            default: "normal"
          )
        ]
      },
      %Type{
        name: "save_params",
        group: :maintenance,
        meaning: "Stores the parameters where they survive a power cut.",
        mav_cmds: ~w(PREFLIGHT_STORAGE)a,
        permission: :maintain,
        params: [
          Param.choice(
            :what,
            ~w(params mission),
            "what is stored; the mission only by iNav, which forgets it otherwise",
            default: "params"
          )
        ]
      },
      %Type{
        name: "reset_params",
        group: :maintenance,
        meaning:
          "Resets all parameters to the firmware's defaults, calibration included; also needs `protection`.",
        permission: :maintain,
        retry: :never
      },
      %Type{
        name: "rx_pair",
        group: :maintenance,
        meaning: "Makes the remote control receiver ready to be bound.",
        mav_cmds: ~w(START_RX_PAIR)a,
        permission: :maintain,
        retry: :never,
        params: [
          Param.choice(:receiver, ~w(dsm2 dsmx dsmx8 crsf), "what kind of receiver", required: true)
        ]
      }
    ]
  end

  defp calibration do
    [
      %Type{
        name: "calibrate",
        group: :maintenance,
        meaning:
          "Calibrates a sensor. The vehicle's instructions, such as how to place it, come as progress.",
        mav_cmds: ~w(PREFLIGHT_CALIBRATION PREFLIGHT_SET_SENSOR_OFFSETS FIXED_MAG_CAL
          FIXED_MAG_CAL_FIELD FIXED_MAG_CAL_YAW DO_START_MAG_CAL)a,
        permission: :maintain,
        retry: :never,
        confirmed_by: "what the vehicle reports",
        long?: true,
        cancel?: true,
        params: [Param.choice(:sensor, @sensors, "what to calibrate", required: true)]
      },
      %Type{
        name: "calibrate_position",
        group: :maintenance,
        meaning: "Tells the vehicle that it is in the position that the accelerometer calibration asked for.",
        mav_cmds: ~w(ACCELCAL_VEHICLE_POS)a,
        permission: :maintain,
        retry: :never,
        params: [
          Param.choice(:position, ~w(level left right nose_down nose_up back), "the position", required: true)
        ]
      },
      %Type{
        name: "calibrate_accept",
        group: :maintenance,
        meaning: "Stores what the calibration of the magnetometers found.",
        mav_cmds: ~w(DO_ACCEPT_MAG_CAL)a,
        permission: :maintain
      },
      %Type{
        name: "calibrate_cancel",
        group: :maintenance,
        meaning:
          "Ends a calibration without a result. ArduPilot cannot end that of the accelerometer, and stores what that of compass and motors has found until then.",
        mav_cmds: ~w(DO_CANCEL_MAG_CAL)a,
        permission: :maintain
      }
    ]
  end

  defp messages do
    [
      %Type{
        name: "request_message",
        group: :telemetry,
        meaning: "Asks for a message once.",
        mav_cmds: ~w(REQUEST_MESSAGE)a,
        permission: :telemetry,
        confirmed_by: "the message arrives",
        params: [
          Param.integer(:message_id, nil, 0, 16_777_215, "id of the message", required: true),
          Param.integer(:index, nil, 0, 65_535, "which one, for messages that exist several times",
            default: 0
          ),
          component()
        ]
      },
      %Type{
        name: "set_message_interval",
        group: :telemetry,
        meaning:
          "Sets how often a message comes by the link that the vehicle is commanded by. What the gateway and its clients want besides may change it again.",
        mav_cmds: ~w(SET_MESSAGE_INTERVAL)a,
        permission: :telemetry,
        rules: [{:one_of, [:rate, :action]}],
        params: [
          Param.integer(:message_id, nil, 0, 16_777_215, "id of the message", required: true),
          Param.number(:rate, "Hz", 0.001, 1000, "how often"),
          Param.choice(:action, ~w(stop default), "stop it, or let the vehicle decide")
        ]
      },
      %Type{
        name: "high_latency",
        group: :telemetry,
        meaning: "Starts or stops sending only a summary, for high-latency links.",
        mav_cmds: ~w(CONTROL_HIGH_LATENCY)a,
        permission: :telemetry,
        params: [Param.boolean(:enabled, "whether only the summary is sent", required: true)]
      }
    ]
  end
end
