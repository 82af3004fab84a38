defmodule Aerie.Vehicle.Firmware.Traits do
  @moduledoc "What a firmware is and what it offers. The defaults are those of an unknown one."

  defstruct title: "unknown firmware",
            mav_autopilot: nil,
            vendor: nil,
            modes: nil,
            param_encoding: :c_cast

  @typedoc """
    * `:title` - its name for people
    * `:mav_autopilot` - its number in MAV_AUTOPILOT; nil: it has none
    * `:vendor` - its name in COMPONENT_INFORMATION_BASIC, of one without a number
    * `:modes` - the module of its flight modes (`Aerie.Vehicle.Firmware.Modes`); nil: the flags of its heartbeat
    * `:param_encoding` - how integer parameters are put into PARAM_SET's float (P2)
  """
  @type t :: %__MODULE__{
          title: String.t(),
          mav_autopilot: non_neg_integer() | nil,
          vendor: String.t() | nil,
          modes: module() | nil,
          param_encoding: :c_cast | :bytewise
        }
end
