defmodule Aerie.Vehicle.Firmware.Traits do
  @moduledoc "What a firmware is and what it offers. The defaults are those of an unknown one."

  defstruct title: "unknown firmware",
            mav_autopilot: nil,
            vendor: nil,
            modes: nil,
            inputs: nil,
            room: nil,
            param_encoding: :c_cast,
            param_tables: nil,
            command_line: [],
            param_hash?: false,
            param_file?: false,
            param_list_s: 15,
            fences?: false,
            any_zone?: false,
            logs_armed?: true,
            setpoints_before_arming?: false

  @typedoc """
    * `:title` - its name for people
    * `:mav_autopilot` - its number in MAV_AUTOPILOT; nil: it has none
    * `:vendor` - its name in COMPONENT_INFORMATION_BASIC, of one without a number
    * `:modes` - the module of its flight modes (`Aerie.Vehicle.Firmware.Modes`); nil: the flags of its heartbeat
    * `:inputs` - the module of what its channels and buttons do (`Aerie.Vehicle.Firmware.Inputs`); nil: nobody knows
    * `:room` - the module of the room that it takes on its way (`Aerie.Vehicle.Firmware.Room`); nil: the most that any
      firmware takes
    * `:param_encoding` - how integer parameters are put into PARAM_SET's float: `:c_cast` or `:bytewise` (P2)
    * `:param_tables` - whose parameters `MavCodec.Msp.Params` describes, with whole names where MAVLink's are too
      short; nil: the vehicle describes them itself, or nobody does
    * `:command_line` - how the firmware's command line calls it in what it prints; empty: it has none that prints
      parameters
    * `:param_hash?` - whether the parameter `_HASH_CHECK` says if others have changed (P6)
    * `:param_file?` - whether it offers all of them as a file
    * `:param_list_s` - how many seconds may pass before it begins to list them
    * `:fences?` - whether the fence aboard can be read, to be compared with a new one
    * `:any_zone?` - whether it may be in any of its stay-inside zones; else it has to be in all of them
    * `:logs_armed?` - whether it answers questions about its logs while it is armed
    * `:setpoints_before_arming?` - whether it wants set-points before it is armed, and does not keep them (X7)
  """
  @type t :: %__MODULE__{}
end
