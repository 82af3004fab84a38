defmodule Protocols.Mission.Result do
  @moduledoc """
  The outcome of a transfer, and the plan that the vehicle then has.
  """

  alias Protocols.Mission.Item

  @enforce_keys [:status]
  defstruct [:status, :reason, :items, :opaque_id, :mismatch, :read_at] ++
              [on_board: :unknown, remarks: [], sent: 0, ms: 0]

  @typedoc "How it ended, as a command does."
  @type status :: :completed | :accepted | :rejected | :failed | :cancelled | :timeout | :unknown

  @typedoc """
  The plan on board, if it was read back:

    * `:new` - the one that was sent, completely
    * `:old` - the previous one: nothing that changes it was sent
    * `:other` - another one than was sent
    * `:read` - the one in `:items`: the transfer only read it
    * `:unknown` - it could not be read back
  """
  @type on_board :: :new | :old | :other | :read | :unknown

  @typedoc """
    * `:status` - `:completed` only if the plan was read back and is right, and the firmware, if it checks plans afterwards, found
      it valid; `:accepted` if that check reported nothing
    * `:items` - the items that were last read completely, or nil
    * `:opaque_id` - the vehicle's id for the plan (W7), or nil
    * `:mismatch` - the number of the first item that differs from what was sent
    * `:remarks` - what the firmware does not keep of the plan that it has, in sentences
    * `:read_at` - when the last read began, by the clock of the events
    * `:sent` - how many messages were sent; `:ms` - how long it took
  """
  @type t :: %__MODULE__{
          status: status(),
          reason: String.t() | nil,
          items: [Item.t()] | nil,
          opaque_id: pos_integer() | nil,
          mismatch: non_neg_integer() | nil,
          read_at: integer() | nil,
          on_board: on_board(),
          remarks: [String.t()],
          sent: non_neg_integer(),
          ms: non_neg_integer()
        }
end
