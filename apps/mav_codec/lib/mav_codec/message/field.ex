defmodule MavCodec.Message.Field do
  @moduledoc """
  The description of a field, see `c:MavCodec.Message.fields/0`.

    * `key` - the struct key, `name` - the name in the XML
    * `type` - element type (`:uint8` for a `char[]` that holds bytes), `length` - array length (`nil`: no array)
    * `units` - as the definitions write them (`"m/s"`, `"degE7"`, `"cm"` ...), `nil` if none
    * `enum` - module of `MavCodec.Enums`, `bitmask` - whether it is a set of flags
    * `invalid` - the value that means "unknown", as text (`"UINT16_MAX"`, `"NaN"`, `"[0]"` ...)
    * `multiplier`, `min`, `max`, `increment`, `default` - as text, where given
    * `instance` - whether the field distinguishes several instances of a message (battery 1, battery 2)
    * `extension` - whether it is in MAVLink 2 only
  """

  @enforce_keys [:key, :name, :type]
  defstruct [
              :key,
              :name,
              :type,
              :length,
              :units,
              :enum,
              :invalid,
              :multiplier,
              :min,
              :max,
              :increment,
              :default
            ] ++
              [bitmask: false, instance: false, extension: false]

  @type t :: %__MODULE__{
          key: atom(),
          name: String.t(),
          type: MavCodec.Definition.Document.Field.scalar(),
          length: 1..255 | nil,
          units: String.t() | nil,
          enum: module() | nil,
          invalid: String.t() | nil,
          multiplier: String.t() | nil,
          min: String.t() | nil,
          max: String.t() | nil,
          increment: String.t() | nil,
          default: String.t() | nil,
          bitmask: boolean(),
          instance: boolean(),
          extension: boolean()
        }
end
