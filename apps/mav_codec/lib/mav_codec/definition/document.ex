defmodule MavCodec.Definition.Document do
  @moduledoc """
  The content of one definition file: facts only (names, numbers, types, units, order), no prose. Lines are those of the
  file that it was read from, for error messages; they are not facts.
  """

  defmodule Field do
    @moduledoc """
    One field of a message, in the order of the XML.

    `type` is the element type, `length` the array length (`nil`: no array), `extension` whether it follows
    `<extensions/>`. `constant` is the value of an `uint8_t_mavlink_version` field. The rest is text as in
    the XML: `enum`, `units`, `invalid`, `multiplier`, `min`, `max`, `increment`, `default`, `format` (print_format),
    `bitmask` (display="bitmask") and `instance` as booleans.

    `bytes` is set for a `char[]` that holds bytes and not text. Its `type` is `:uint8`, as of any other bytes; only
    CRC_EXTRA still says "char".
    """
    @enforce_keys [:name, :type]
    defstruct [
                :name,
                :type,
                :length,
                :enum,
                :units,
                :invalid,
                :multiplier,
                :min,
                :max,
                :increment,
                :default,
                :format
              ] ++
                [:constant, :line, extension: false, instance: false, bitmask: false, bytes: false]

    @type scalar ::
            :char | :int8 | :uint8 | :int16 | :uint16 | :int32 | :uint32 | :int64 | :uint64 | :float | :double
    @type t :: %__MODULE__{name: String.t(), type: scalar(), length: 1..255 | nil}
  end

  defmodule Message do
    @moduledoc "A message: id (24 bits), name and fields in the order of the XML."
    @enforce_keys [:id, :name]
    defstruct [:id, :name, :line, :file, fields: [], deprecated: nil, wip: false]

    @type t :: %__MODULE__{id: 0..0xFFFFFF, name: String.t(), fields: [Field.t()]}
  end

  defmodule Entry do
    @moduledoc "An enum entry. `params` are the parameters of a command (MAV_CMD): `{index, [{key, text}]}`."
    @enforce_keys [:name, :value]
    defstruct [:name, :value, :line, :file, params: [], deprecated: nil, wip: false, facts: []]

    @type t :: %__MODULE__{name: String.t(), value: non_neg_integer()}
  end

  defmodule Enumeration do
    @moduledoc "An enum or bitmask; enums of one name are merged over files."
    @enforce_keys [:name]
    defstruct [:name, :line, bitmask: false, entries: [], deprecated: nil, wip: false]

    @type t :: %__MODULE__{name: String.t(), bitmask: boolean(), entries: [Entry.t()]}
  end

  @enforce_keys [:file]
  defstruct [:file, :version, :dialect, includes: [], enums: [], messages: []]

  @type t :: %__MODULE__{
          file: String.t(),
          version: non_neg_integer() | nil,
          dialect: non_neg_integer() | nil,
          includes: [{String.t(), line :: pos_integer()}],
          enums: [Enumeration.t()],
          messages: [Message.t()]
        }
end
