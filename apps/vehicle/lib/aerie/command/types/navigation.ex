defmodule Aerie.Command.Types.Navigation do
  @moduledoc "Commands that send the vehicle somewhere or change how it flies: rows of `Aerie.Command.Types`."

  import Aerie.Command.Types.Shared

  alias Aerie.Command.{Param, Type}

  @doc false
  @spec rows() :: [Type.t()]
  def rows do
    [
      %Type{
        name: "goto",
        group: :navigation,
        meaning: "Flies to a place and stays there.",
        permission: :fly,
        confirmed_by: "its mode is that for going to a place",
        moves_vehicle?: true,
        params:
          place(required: true) ++
            altitude("height to fly at", required: true) ++
            [
              Param.number(:speed, "m/s", 0.1, 100, "ground speed; without it the vehicle's own"),
              heading(:yaw, "where its nose is to point; without it as the vehicle likes")
            ]
      },
      %Type{
        name: "orbit",
        group: :navigation,
        meaning: "Circles around a place, or around where it is, until it is told otherwise.",
        permission: :fly,
        confirmed_by: "its mode is that for circling",
        moves_vehicle?: true,
        rules: [{:together, [:lat, :lon]}],
        params:
          place() ++
            altitude("height to fly at; without it the present one") ++
            [
              Param.number(:radius, "m", 1, 10_000, "radius of the circle", required: true),
              Param.number(:speed, "m/s", 0.1, 100, "speed on the circle; without it the vehicle's own"),
              Param.choice(:direction, ~w(clockwise counterclockwise), "seen from above",
                default: "clockwise"
              ),
              Param.choice(
                :yaw_behaviour,
                ~w(center initial uncontrolled tangent rc unchanged),
                "where its nose points: to the centre, as at the beginning, anywhere, ahead, as the pilot steers, as it is set",
                default: "center"
              )
            ]
      },
      %Type{
        name: "set_speed",
        group: :navigation,
        meaning: "Sets the speed at which it flies to its goals.",
        permission: :fly,
        moves_vehicle?: true,
        params: [
          Param.number(:speed, "m/s", 0.1, 100, "how fast", required: true),
          Param.choice(:kind, ~w(groundspeed airspeed climb descent), "which speed", default: "groundspeed")
        ]
      },
      %Type{
        name: "set_altitude",
        group: :navigation,
        meaning: "Climbs or descends to a height and stays above the place where it is.",
        permission: :fly,
        confirmed_by: "its mode is that for going to a place",
        moves_vehicle?: true,
        params: altitude("height to fly at", required: true)
      },
      %Type{
        name: "set_yaw",
        group: :navigation,
        meaning: "Turns its nose while it stays where it is.",
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
          Param.boolean(:relative, "whether it is from where its nose points now", default: false),
          Param.number(:rate, "°/s", 0, 360, "how fast; 0: as the vehicle likes", default: 0.0)
        ]
      },
      %Type{
        name: "set_roi",
        group: :navigation,
        meaning: "Points camera and nose at a place from now on.",
        permission: :payload,
        moves_vehicle?: true,
        params: place(required: true) ++ altitude("height of the place", default: 0.0)
      },
      %Type{
        name: "clear_roi",
        group: :navigation,
        meaning: "Ceases to point at a place.",
        permission: :payload,
        moves_vehicle?: true
      },
      %Type{
        name: "land_start",
        group: :navigation,
        meaning: "Goes to the beginning of the mission's landing and lands by it.",
        permission: :mission,
        moves_vehicle?: true
      }
    ]
  end
end
