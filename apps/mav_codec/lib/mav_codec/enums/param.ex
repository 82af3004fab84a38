defmodule MavCodec.Enums.Param do
  @moduledoc """
  A parameter of a command: see `MavCodec.Enums.MavCmd.params/1`.

    * `index` - 1 to 7
    * `label` - its short name, `nil` where it has none
    * `units`, `enum` (a name such as `"MAV_BOOL"`), `min`, `max`, `increment` - `nil` where the definition says nothing
    * `default` - the value of a parameter that is not used: a number or `:nan`
    * `reserved` - unused: send `default`, or 0
  """

  @enforce_keys [:index]
  defstruct [:index, :label, :units, :enum, :min, :max, :increment, :default, reserved: false]

  @type t :: %__MODULE__{
          index: 1..7,
          label: String.t() | nil,
          units: String.t() | nil,
          enum: String.t() | nil,
          min: float() | nil,
          max: float() | nil,
          increment: float() | nil,
          default: float() | :nan | nil,
          reserved: boolean()
        }
end
