defmodule Aerie.Vehicle.Command.Types.Mission do
  @moduledoc "Commands that start and steer a mission, and the fence: rows of `Aerie.Vehicle.Command.Types`."

  alias Aerie.Vehicle.Command.{Param, Type}

  @doc false
  @spec rows() :: [Type.t()]
  def rows do
    [
      %Type{
        name: "mission_start",
        disarmed: :refused,
        group: :mission,
        meaning: "Starts the mission, or continues it. It does not arm the vehicle.",
        mav_cmds: ~w(MISSION_START)a,
        permission: :mission,
        confirmed_by: "it is in the mission mode",
        moves_vehicle?: true
      },
      %Type{
        name: "mission_pause",
        group: :mission,
        meaning: "Stops and waits in place; resume continues the mission.",
        mav_cmds: ~w(DO_PAUSE_CONTINUE)a,
        permission: :mission,
        confirmed_by: "its mode has changed, if the firmware changes it",
        moves_vehicle?: true
      },
      %Type{
        name: "mission_set_current",
        group: :mission,
        meaning: "Makes an item of the mission the current one.",
        mav_cmds: ~w(DO_SET_MISSION_CURRENT)a,
        permission: :mission,
        confirmed_by: "it is the current item",
        moves_vehicle?: true,
        params: [
          Param.integer(:seq, nil, 0, 65_534, "number of the item as the vehicle counts", required: true)
        ]
      },
      %Type{
        name: "jump",
        disarmed: :refused,
        group: :mission,
        meaning: "Continues the mission at the item with a tag.",
        mav_cmds: ~w(DO_JUMP DO_JUMP_TAG)a,
        permission: :mission,
        retry: :never,
        moves_vehicle?: true,
        params: [
          Param.integer(:tag, nil, 0, 65_535, "the tag, as the JUMP_TAG item has it", required: true),
          Param.integer(:repeat, nil, 0, 65_535, "how many more times", default: 0)
        ]
      },
      %Type{
        name: "set_geofence",
        group: :mission,
        meaning: "Switches the vehicle's own fence on or off; off also needs `protection`.",
        mav_cmds: ~w(DO_FENCE_ENABLE)a,
        permission: :mission,
        params: [Param.boolean(:enabled, "whether the fence is on", required: true)]
      }
    ]
  end
end
