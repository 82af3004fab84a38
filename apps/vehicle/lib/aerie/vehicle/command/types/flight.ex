defmodule Aerie.Vehicle.Command.Types.Flight do
  @moduledoc "Commands that arm, take off, land, and change what the vehicle is doing: rows of `Aerie.Vehicle.Command.Types`."

  import Aerie.Vehicle.Command.Types.Shared

  alias Aerie.Vehicle.Command.{Param, Type}

  @standard_modes ~w(position_hold orbit cruise altitude_hold safe_recovery mission land takeoff)

  @doc false
  @spec rows() :: [Type.t()]
  def rows do
    [
      %Type{
        name: "arm",
        group: :flight,
        meaning:
          "Arms the vehicle, so that its motors may turn. The vehicle's own checks decide whether it arms.",
        mav_cmds: ~w(COMPONENT_ARM_DISARM)a,
        permission: :arm,
        retry: :never,
        confirmed_by: "it is armed",
        moves_vehicle?: true
      },
      %Type{
        name: "disarm",
        group: :flight,
        meaning: "Disarms the vehicle. A flying vehicle refuses.",
        permission: :arm,
        confirmed_by: "it is not armed"
      },
      %Type{
        name: "force_disarm",
        group: :flight,
        meaning: "Stops the motors at once, in flight too: the vehicle falls.",
        permission: :force_disarm,
        retry: :never,
        confirmed_by: "it is not armed",
        moves_vehicle?: true
      },
      %Type{
        name: "terminate",
        group: :flight,
        meaning: "Ends the flight for good (flight termination): the vehicle falls, or opens its parachute.",
        mav_cmds: ~w(DO_FLIGHTTERMINATION)a,
        permission: :terminate,
        retry: :never,
        moves_vehicle?: true
      },
      %Type{
        name: "takeoff",
        group: :flight,
        meaning: "Takes off. The vehicle must be armed.",
        mav_cmds: ~w(NAV_TAKEOFF NAV_TAKEOFF_LOCAL NAV_VTOL_TAKEOFF SOLO_BTN_FLY_HOLD)a,
        permission: :fly,
        retry: :never,
        confirmed_by: "it is in the air",
        moves_vehicle?: true,
        params: [
          Param.number(:altitude, "m", 0.5, 1000, "height above home to climb to", required: true)
        ]
      },
      %Type{
        name: "land",
        group: :flight,
        meaning: "Lands at its present position.",
        mav_cmds: ~w(NAV_LAND NAV_LAND_LOCAL NAV_VTOL_LAND)a,
        permission: :fly,
        confirmed_by: "it is in the landing mode, or on the ground",
        moves_vehicle?: true
      },
      %Type{
        name: "rtl",
        disarmed: :refused_on_wheels,
        group: :flight,
        meaning: "Returns to home or to a rally point, and then does what its parameters say, usually land.",
        mav_cmds: ~w(NAV_RETURN_TO_LAUNCH)a,
        permission: :fly,
        confirmed_by: "it is in the return mode",
        moves_vehicle?: true
      },
      %Type{
        name: "hold",
        group: :flight,
        meaning: "Stops and stays in place; a vehicle that cannot stop circles.",
        permission: :fly,
        confirmed_by: "it is in the hold mode",
        moves_vehicle?: true
      },
      %Type{
        name: "resume",
        disarmed: :refused,
        group: :flight,
        meaning: "Continues the mission after hold or mission_pause.",
        permission: :mission,
        confirmed_by: "it is in the mission mode",
        moves_vehicle?: true
      },
      %Type{
        name: "set_mode",
        group: :flight,
        meaning:
          "Changes the flight mode: to a mode of the firmware, by the name that the vehicle's state shows, or to one of MAVLink's standard modes.",
        mav_cmds: ~w(DO_SET_MODE DO_SET_STANDARD_MODE)a,
        permission: :fly,
        confirmed_by: "it is in this mode",
        moves_vehicle?: true,
        rules: [{:one_of, [:mode, :standard_mode]}],
        params: [
          Param.text(:mode, 50, "a mode of this firmware, such as GUIDED or AUTO_LOITER"),
          Param.choice(:standard_mode, @standard_modes, "a mode of MAV_STANDARD_MODE"),
          Param.boolean(
            :setpoints_elsewhere,
            "for PX4's OFFBOARD: whether its set-points come from elsewhere, not through this gateway",
            default: false
          )
        ]
      },
      %Type{
        name: "vtol_transition",
        group: :flight,
        meaning: "Switches between fixed-wing and multicopter flight.",
        mav_cmds: ~w(DO_VTOL_TRANSITION)a,
        permission: :fly,
        retry: :never,
        confirmed_by: "its VTOL state shows it",
        long?: true,
        moves_vehicle?: true,
        params: [
          Param.choice(:to, ~w(fixed_wing multicopter), "how to fly", required: true)
        ]
      },
      %Type{
        name: "parachute",
        group: :flight,
        meaning: "Releases the parachute, or switches its automatic release on or off.",
        mav_cmds: ~w(DO_PARACHUTE)a,
        permission: :terminate,
        retry: :never,
        moves_vehicle?: true,
        params: [
          Param.choice(:action, ~w(release enable disable), "what to do", required: true)
        ]
      },
      %Type{
        name: "set_home",
        group: :flight,
        meaning: "Sets home to the vehicle's position, or to a place.",
        mav_cmds: ~w(DO_SET_HOME)a,
        permission: :fly,
        confirmed_by: "it reports this home",
        rules: [{:together, [:lat, :lon, :altitude_msl]}, {:one_of, [:here, :lat]}],
        params: [
          Param.boolean(:here, "use the vehicle's present position", values: [true]),
          Enum.at(place(), 0),
          Enum.at(place(), 1),
          altitude_msl()
        ]
      },
      %Type{
        name: "set_origin",
        group: :flight,
        meaning: "Sets the origin of the local coordinates, for a vehicle without GNSS.",
        mav_cmds: ~w(DO_SET_GLOBAL_ORIGIN)a,
        permission: :maintain,
        confirmed_by: "it sends GPS_GLOBAL_ORIGIN",
        params: place(required: true) ++ [altitude_msl(required: true)]
      }
    ]
  end
end
