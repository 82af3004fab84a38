defmodule Aerie.Vehicle.Command.Types.Payload do
  @moduledoc "Commands for cameras, gimbals, grippers and outputs: rows of `Aerie.Vehicle.Command.Types`."

  import Aerie.Vehicle.Command.Types.Shared

  alias Aerie.Vehicle.Command.{Param, Type}

  @doc false
  @spec rows() :: [Type.t()]
  def rows do
    [
      %Type{
        name: "camera_photo",
        group: :payload,
        meaning: "Takes photos, or stops taking them.",
        mav_cmds:
          ~w(DO_DIGICAM_CONFIGURE DO_DIGICAM_CONTROL DO_SET_CAM_TRIGG_INTERVAL IMAGE_START_CAPTURE IMAGE_STOP_CAPTURE)a,
        permission: :payload,
        retry: :never,
        long?: true,
        cancel?: true,
        params: [
          Param.choice(:action, ~w(start stop), "take photos, or stop taking them", default: "start"),
          Param.integer(:count, nil, 0, 100_000, "number of photos; 0: until stopped", default: 1),
          Param.number(:interval, "s", 0, 86_400, "time between two photos", default: 0.0),
          component()
        ]
      },
      %Type{
        name: "camera_video",
        group: :payload,
        meaning: "Starts or stops recording a video.",
        mav_cmds: ~w(VIDEO_START_CAPTURE VIDEO_STOP_CAPTURE)a,
        permission: :payload,
        params: [
          Param.choice(:action, ~w(start stop), "start or stop recording", default: "start"),
          Param.integer(:stream, nil, 0, 255, "which stream of the camera; 0: all", default: 0),
          component()
        ]
      },
      %Type{
        name: "camera_trigger",
        group: :payload,
        meaning: "Releases the shutter once.",
        mav_cmds: ~w(DO_TRIGGER_CONTROL SET_CAMERA_MODE SET_CAMERA_ZOOM SET_CAMERA_FOCUS)a,
        permission: :payload,
        retry: :never
      },
      %Type{
        name: "camera_trigger_distance",
        group: :payload,
        meaning: "Takes a photo each time the vehicle has flown this distance.",
        mav_cmds: ~w(DO_SET_CAM_TRIGG_DIST)a,
        permission: :payload,
        params: [
          Param.number(:distance, "m", 0, 10_000, "distance between two photos; 0: stop", required: true)
        ]
      },
      %Type{
        name: "gimbal",
        group: :payload,
        meaning:
          "Points the gimbal. Without `component` it is for the one that manages gimbals, or the autopilot.",
        mav_cmds: ~w(DO_MOUNT_CONFIGURE DO_MOUNT_CONTROL DO_MOUNT_CONTROL_QUAT DO_GIMBAL_MANAGER_PITCHYAW
          DO_GIMBAL_MANAGER_CONFIGURE)a,
        permission: :payload,
        rules: [{:together, [:pitch, :yaw]}],
        params: [
          Param.choice(:action, ~w(point neutral retract), "point it, or bring it to rest", default: "point"),
          Param.number(:pitch, "°", -180, 180, "up is positive; required for point"),
          Param.number(:yaw, "°", -180, 180, "right is positive; required for point"),
          Param.choice(:yaw_reference, ~w(vehicle north), "what yaw is measured from", default: "vehicle"),
          Param.integer(:gimbal, nil, 0, 255, "which gimbal; 0: the first", default: 0),
          component()
        ]
      },
      %Type{
        name: "gripper",
        group: :payload,
        meaning: "Opens or closes the gripper.",
        mav_cmds: ~w(DO_GRIPPER)a,
        permission: :payload,
        retry: :never,
        long?: true,
        params: [
          Param.choice(:action, ~w(release grab), "open or close", required: true),
          Param.integer(:gripper, nil, 1, 255, "which gripper", default: 1)
        ]
      },
      %Type{
        name: "servo",
        group: :payload,
        meaning: "Moves a servo output that nothing else steers.",
        mav_cmds: ~w(DO_SET_SERVO DO_REPEAT_SERVO)a,
        permission: :payload,
        moves_vehicle?: true,
        params: [
          Param.integer(:channel, nil, 1, 32, "the output", required: true),
          Param.integer(:pwm, "µs", 500, 2500, "width of the pulse", required: true)
        ]
      },
      %Type{
        name: "actuator",
        group: :payload,
        meaning: "Moves an output of an actuator set.",
        mav_cmds: ~w(DO_SET_ACTUATOR)a,
        permission: :payload,
        moves_vehicle?: true,
        params: [
          Param.integer(:actuator, nil, 1, 6, "which output", required: true),
          Param.number(:value, nil, -1, 1, "from one end to the other", required: true)
        ]
      },
      %Type{
        name: "relay",
        group: :payload,
        meaning: "Switches a relay.",
        mav_cmds: ~w(DO_SET_RELAY DO_REPEAT_RELAY)a,
        permission: :payload,
        params: [
          Param.integer(:relay, nil, 0, 15, "which relay", required: true),
          Param.boolean(:on, "on or off", required: true)
        ]
      }
    ]
  end
end
