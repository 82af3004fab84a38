defmodule Aerie.Vehicle.Protocol.Step do
  @moduledoc """
  One thing to send and to wait for, as data. An adapter makes steps, encodes them and reads their answers; the executor
  carries them out in order without knowing what they do.
  """

  alias Aerie.Vehicle.Protocol.Condition

  @enforce_keys [:key, :forms]
  defstruct [
    :key,
    :forms,
    :component,
    :confirm,
    :watch,
    :stream,
    :cancel,
    :cancel_key,
    :ends,
    :holds,
    :note,
    repeat: :safe,
    acked?: true,
    urgent?: false,
    shared?: false,
    answer_ms: 0,
    within_ms: 3_000
  ]

  @typedoc """
    * `:key` - steps with the same key wait for each other: a vehicle has only one of them in flight
    * `:forms` - alternative messages for it; the first is used unless an answer asks for another (result codes 7, 8 and 9)
    * `:component` - the component that is addressed; nil: the autopilot
    * `:repeat` - whether it may be sent again when no answer comes
    * `:acked?` - whether the vehicle answers it
    * `:urgent?` - it waits for nothing: steps with its key that are in flight or waiting are given up
    * `:shared?` - the session sends the same command for its own purposes; it pauses meanwhile, because an answer does not say
      which of the two it belongs to (C8)
    * `:answer_ms` - how long to wait for the answer at least, if the command blocks the firmware
    * `:confirm`, `:within_ms` - the condition that shows that it was done, and how long that may take after the acceptance
    * `:watch` - for the adapter: which texts and messages report its progress and end
    * `:stream` - it is repeated at `hz` for `ms`, then `release` is sent; the vehicle answers none of these
    * `:note` - what the result of a stream says besides
    * `:cancel` - the message that cancels it, sent again until the vehicle says something; nil: MAVLink's COMMAND_CANCEL;
      `{:never, reason}`: nothing does
    * `:cancel_key` - the key of the steps that send the same command as `:cancel` does
    * `:ends` - the key of steps in flight that the vehicle ends because of this one
    * `:holds` - what the vehicle is busy with from the acceptance until it tells the end (`busy_with` in `Aerie.Vehicle.Protocol.Vehicle`)
  """
  @type t :: %__MODULE__{
          key: term(),
          forms: [form(), ...],
          component: 1..255 | nil,
          repeat: :safe | :never,
          acked?: boolean(),
          urgent?: boolean(),
          shared?: boolean(),
          answer_ms: non_neg_integer(),
          confirm: Condition.t() | nil,
          within_ms: pos_integer(),
          watch: term(),
          stream: %{hz: pos_integer(), ms: pos_integer(), release: form() | nil} | nil,
          note: String.t() | nil,
          cancel: form() | {:never, String.t()} | nil,
          cancel_key: term(),
          ends: term(),
          holds: String.t() | nil
        }

  @typedoc "Only the adapter knows what it means."
  @type form :: term()
end
