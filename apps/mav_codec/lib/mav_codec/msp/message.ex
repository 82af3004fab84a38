defmodule MavCodec.Msp.Message do
  @moduledoc """
  What is known of a message of one firmware: a row of `priv/msp`.

  - `name`, `id`: of the firmware
  - `kind`: `:read` asks and changes nothing, `:write` changes something
  - `since`, `until`: the first version that has it, the first that no longer has it; nil: all
  - `request`, `reply`: their fields
  - `sizes`: lengths at which a payload may end, ascending; the firmware fills what is missing from what happens to be in its buffer
  - `min`, `max`, `each`: the same as a shortest and a longest length, and as a multiple
  - `exact?`: nothing else is accepted; otherwise further bytes are ignored
  - `armed`: may it be sent to an armed vehicle? `:ask`: with a permission of its own, as it takes effect in flight. Firmware checks this for few messages.
  - `channels?`: it moves channels of the receiver, which arm and steer: sent only with a dead-man
  - `eeprom?`: lost with the next restart, unless EEPROM_WRITE follows; `restart?`: takes effect with the next restart
  - `never`: why it is never sent, or nil
  - `note`: what its fields do not say
  """

  alias MavCodec.Msp.Field

  @enforce_keys [:name, :id, :kind]
  defstruct [
    :name,
    :id,
    :kind,
    :since,
    :until,
    :each,
    :max,
    :never,
    :note,
    request: [],
    reply: [],
    sizes: [],
    min: 0,
    exact?: false,
    armed: :yes,
    channels?: false,
    eeprom?: false,
    restart?: false
  ]

  @type version :: {major :: non_neg_integer, minor :: non_neg_integer}
  @type t :: %__MODULE__{
          name: String.t(),
          id: 0..0xFFFF,
          kind: :read | :write,
          since: version | nil,
          until: version | nil,
          request: Field.layout(),
          reply: Field.layout(),
          sizes: [non_neg_integer],
          min: non_neg_integer,
          max: non_neg_integer | nil,
          each: pos_integer | nil,
          exact?: boolean,
          armed: :yes | :ask | :no,
          channels?: boolean,
          eeprom?: boolean,
          restart?: boolean,
          never: String.t() | nil,
          note: String.t() | nil
        }

  @doc "Whether a version has the message; every message may be had by an unknown version (nil)."
  @spec in?(t, version | nil) :: boolean
  def in?(_message, nil), do: true

  def in?(%__MODULE__{since: since, until: until}, version),
    do: (since == nil or version >= since) and (until == nil or version < until)
end
