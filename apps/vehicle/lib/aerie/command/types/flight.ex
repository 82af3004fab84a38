defmodule Aerie.Command.Types.Flight do
  @moduledoc "Commands that arm, take off, land, and change what the vehicle is doing: rows of `Aerie.Command.Types`."

  import Aerie.Command.Types.Shared

  alias Aerie.Command.{Param, Type}

  @standard_modes ~w(position_hold orbit cruise altitude_hold safe_recovery mission land takeoff)

  @doc false
  @spec rows() :: [Type.t()]
  def rows do
    [
      %Type{
        name: "arm",
        group: :flight,
        meaning: "Arms the vehicle: its motors may turn from now on. The vehicle's own checks decide.",
        permission: :arm,
        retry: :never,
        confirmed_by: "it is armed",
        moves_vehicle?: true
      },
      %Type{
        name: "disarm",
        group: :flight,
        meaning: "Disarms the vehicle. The vehicle refuses while it flies.",
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
        permission: :terminate,
        retry: :never,
        moves_vehicle?: true
      },
      %Type{
        name: "takeoff",
        group: :flight,
        meaning: "Takes off from where it stands. It has to be armed.",
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
        meaning: "Lands where it is.",
        permission: :fly,
        confirmed_by: "its mode is that for landing, or it is on the ground",
        moves_vehicle?: true
      },
      %Type{
        name: "rtl",
        group: :flight,
        meaning:
          "Returns to home, or to a rally point, and does there what its parameters say, usually landing.",
        permission: :fly,
        confirmed_by: "its mode is that for returning",
        moves_vehicle?: true
      },
      %Type{
        name: "hold",
        group: :flight,
        meaning: "Stops and stays where it is; what cannot stop circles.",
        permission: :fly,
        confirmed_by: "its mode is that for holding",
        moves_vehicle?: true
      },
      %Type{
        name: "resume",
        group: :flight,
        meaning: "Goes on with the mission after hold or mission_pause.",
        permission: :mission,
        confirmed_by: "its mode is that for missions",
        moves_vehicle?: true
      },
      %Type{
        name: "set_mode",
        group: :flight,
        meaning:
          "Changes the flight mode: to one of this firmware's by the name that the vehicle's state shows, or to a standard mode of MAVLink that every firmware has a mode for.",
        permission: :fly,
        confirmed_by: "its mode",
        moves_vehicle?: true,
        rules: [{:one_of, [:mode, :standard_mode]}],
        params: [
          Param.text(:mode, 50, "a mode of this firmware, such as GUIDED or AUTO_LOITER"),
          Param.choice(:standard_mode, @standard_modes, "a mode of MAV_STANDARD_MODE"),
          Param.boolean(
            :setpoints_elsewhere,
            "for PX4's OFFBOARD: the set-points that it needs come in another way than through this gateway",
            default: false
          )
        ]
      },
      %Type{
        name: "vtol_transition",
        group: :flight,
        meaning: "Changes between flying on wings and on rotors.",
        permission: :fly,
        retry: :never,
        confirmed_by: "its VTOL state",
        long?: true,
        moves_vehicle?: true,
        params: [
          Param.choice(:to, ~w(fixed_wing multicopter), "how it is to fly", required: true)
        ]
      },
      %Type{
        name: "parachute",
        group: :flight,
        meaning: "Releases the parachute, or switches its automatic release on or off.",
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
        meaning: "Sets home: to where the vehicle is, or to a place.",
        permission: :fly,
        confirmed_by: "home",
        rules: [{:together, [:lat, :lon, :altitude_msl]}, {:one_of, [:here, :lat]}],
        params: [
          Param.boolean(:here, "where the vehicle is", values: [true]),
          Enum.at(place(), 0),
          Enum.at(place(), 1),
          altitude_msl()
        ]
      },
      %Type{
        name: "set_origin",
        group: :flight,
        meaning: "Tells a vehicle without GNSS where its local coordinates begin.",
        permission: :maintain,
        confirmed_by: "GPS_GLOBAL_ORIGIN",
        params: place(required: true) ++ [altitude_msl(required: true)]
      }
    ]
  end
end
