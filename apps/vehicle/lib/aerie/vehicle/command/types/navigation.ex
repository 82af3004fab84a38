defmodule Aerie.Vehicle.Command.Types.Navigation do
  @moduledoc "Commands that send the vehicle somewhere or change how it flies: rows of `Aerie.Vehicle.Command.Types`."

  import Aerie.Vehicle.Command.Types.Shared

  alias Aerie.Vehicle.Command.{Param, Type}

  @doc false
  @spec rows() :: [Type.t()]
  def rows do
    [
      %Type{
        name: "goto",
        disarmed: :refused,
        group: :navigation,
        meaning: "Flies to a place and stays there.",
        mav_cmds: ~w(DO_REPOSITION OVERRIDE_GOTO)a,
        permission: :fly,
        confirmed_by: "it is in the mode for flying to a place",
        moves_vehicle?: true,
        params:
          place(required: true) ++
            altitude("height to fly at", required: true) ++
            [
              Param.number(:speed, "m/s", 0.1, 100, "ground speed; without it, the vehicle's default"),
              heading(:yaw, "heading of the nose; without it, the vehicle decides")
            ]
      },
      %Type{
        name: "orbit",
        disarmed: :refused,
        group: :navigation,
        meaning: "Circles around a place, or around its present position, until the next command.",
        mav_cmds: ~w(DO_ORBIT)a,
        permission: :fly,
        confirmed_by: "it is in the circling mode",
        moves_vehicle?: true,
        rules: [{:together, [:lat, :lon]}],
        params:
          place() ++
            altitude("height to fly at; without it, the present height") ++
            [
              Param.number(:radius, "m", 1, 10_000, "radius of the circle", required: true),
              Param.number(:speed, "m/s", 0.1, 100, "speed on the circle; without it, the vehicle's default"),
              Param.choice(:direction, ~w(clockwise counterclockwise), "seen from above",
                default: "clockwise"
              ),
              Param.choice(
                :yaw_behaviour,
                ~w(center initial uncontrolled tangent rc unchanged),
                "where the nose points: at the centre, in the initial direction, anywhere, along the circle, as the pilot steers, as configured",
                default: "center"
              )
            ]
      },
      %Type{
        name: "set_speed",
        group: :navigation,
        meaning: "Sets the speed at which it flies to its targets.",
        mav_cmds: ~w(DO_CHANGE_SPEED GUIDED_CHANGE_SPEED)a,
        permission: :fly,
        moves_vehicle?: true,
        params: [
          Param.number(:speed, "m/s", 0.1, 100, "the speed", required: true),
          Param.choice(:kind, ~w(groundspeed airspeed climb descent), "which speed", default: "groundspeed")
        ]
      },
      %Type{
        name: "set_altitude",
        disarmed: :refused,
        group: :navigation,
        meaning: "Climbs or descends to a height above its present position.",
        mav_cmds: ~w(DO_CHANGE_ALTITUDE GUIDED_CHANGE_ALTITUDE)a,
        permission: :fly,
        confirmed_by: "it is in the mode for flying to a place",
        moves_vehicle?: true,
        params: altitude("height to fly at", required: true)
      },
      %Type{
        name: "set_yaw",
        disarmed: :refused,
        group: :navigation,
        meaning: "Turns the nose while staying in place.",
        mav_cmds: ~w(CONDITION_YAW)a,
        permission: :fly,
        retry: :never,
        moves_vehicle?: true,
        params: [
          Param.number(
            :yaw,
            "°",
            -360,
            360,
            "heading from north, or, if relative, how far to turn to the right",
            required: true
          ),
          Param.boolean(:relative, "whether the angle is relative to the present heading", default: false),
          Param.number(:rate, "°/s", 0, 360, "how fast; 0: the vehicle decides", default: 0.0)
        ]
      },
      %Type{
        name: "set_roi",
        group: :navigation,
        meaning: "Keeps camera and nose pointed at a place.",
        mav_cmds: ~w(NAV_ROI DO_SET_ROI_LOCATION DO_SET_ROI_WPNEXT_OFFSET DO_SET_ROI_SYSID DO_SET_ROI)a,
        permission: :payload,
        moves_vehicle?: true,
        params: place(required: true) ++ altitude("height of the place", default: 0.0)
      },
      %Type{
        name: "clear_roi",
        group: :navigation,
        meaning: "Stops pointing at a place.",
        mav_cmds: ~w(DO_SET_ROI_NONE)a,
        permission: :payload,
        moves_vehicle?: true
      },
      %Type{
        name: "land_start",
        disarmed: :refused,
        group: :navigation,
        meaning: "Flies to the start of the mission's landing sequence and lands with it.",
        mav_cmds: ~w(DO_LAND_START)a,
        permission: :mission,
        moves_vehicle?: true
      }
    ]
  end
end
