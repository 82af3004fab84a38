defmodule Protocols.Mission.Firmware do
  @moduledoc """
  What a transfer of a plan needs to know of a firmware. The adapters of the vehicles implement it.
  """

  alias Protocols.Mission.StoredItem

  @doc "Whether item 0 of a mission is home, and the first real one 1 (W8)."
  @callback home_is_item_0?() :: boolean()

  @doc """
  What the firmware keeps of an item of a mission, fence or list of rally points (W8). The item is a map with the
  fields of `Protocols.Mission.Item`; `kind` is that of the vehicle: `copter`, `plane` and so on.
  """
  @callback kept(item :: map(), mission_type :: 0..2, kind :: String.t()) :: StoredItem.t()

  @doc "The offset from an item's number, counted from 1, to the firmware's number."
  @callback item_offset() :: 0 | -1

  @doc """
  For how long after an upload the vehicle may still reject the plan that it acknowledged, in microseconds; 0 if it
  never does.
  """
  @callback plan_watch_us(mission_type :: 0..2) :: non_neg_integer()

  @doc """
  What a message says about the plan that was just uploaded; `opaque_id` is the vehicle's id for it (W7), or nil:

    * `:valid` - it can be flown
    * `{:invalid, reason}` - the vehicle rejected it later
    * `{:doubtful, reason}` - it cannot be flown at the moment; if that does not change, the vehicle rejected it
  """
  @callback plan_verdict(message :: term(), mission_type :: 0..2, opaque_id :: non_neg_integer() | nil) ::
              :ignore | :valid | {:invalid | :doubtful, reason :: String.t()}
end
