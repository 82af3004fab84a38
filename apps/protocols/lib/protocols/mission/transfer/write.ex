defmodule Protocols.Mission.Transfer.Write do
  @moduledoc """
  The part of a transfer that sends or clears a plan. The vehicle requests each item (W3); this side sends
  the requested item, so a request out of sequence needs no special handling. Pure.
  """

  alias Protocols.Mission.Item
  alias MavCodec.Enums.MavMissionResult
  alias MavCodec.Messages, as: M

  @accepted MavMissionResult.value(:MAV_MISSION_ACCEPTED)
  @invalid_sequence MavMissionResult.value(:MAV_MISSION_INVALID_SEQUENCE)
  @cancelled MavMissionResult.value(:MAV_MISSION_OPERATION_CANCELLED)

  defstruct [
    :type,
    :target,
    :items,
    :requested,
    ahead: 0,
    repeated?: false,
    strict?: false,
    last_sent?: false
  ]

  @type t :: %__MODULE__{
          type: 0..2,
          target: {0..255, 0..255},
          items: tuple(),
          requested: non_neg_integer() | nil,
          ahead: non_neg_integer(),
          repeated?: boolean(),
          strict?: boolean(),
          last_sent?: boolean()
        }

  @typedoc """
    * `{:next, write, message}` - the answer to a request of the vehicle
    * `{:acked, opaque_id}` - the vehicle acknowledged the plan
    * `{:doubt, result}` - an error after everything was sent, possibly the answer to a repetition
    * `{:refused, result}` - MAV_MISSION_RESULT, before everything was sent
  """
  @type outcome ::
          :ignore
          | {:next, t(), struct()}
          | {:acked, pos_integer() | nil}
          | {:doubt | :refused, non_neg_integer()}

  @doc "A write of these items; an empty list clears the plan."
  @spec new(0..2, {0..255, 0..255}, [Item.t()]) :: t()
  def new(type, target, items), do: %__MODULE__{type: type, target: target, items: List.to_tuple(items)}

  @doc """
  The message to send after `repeats` repetitions without an answer. The request for the next item may have been lost, and a vehicle
  that waits for that item ignores others, so every other time this is the next item.
  """
  @spec again(t(), pos_integer()) :: {t(), struct()}
  def again(%{strict?: false, requested: seq, items: items} = write, tries)
      when seq != nil and seq + 1 < tuple_size(items) and tries > 2 and rem(tries, 2) == 1,
      do: next(write, seq + 1)

  def again(write, _tries), do: {%{write | repeated?: true}, current(write)}

  @doc "The first message, repeated until the vehicle requests something else."
  @spec current(t()) :: struct()
  def current(%{items: {}} = write), do: addressed(%M.MissionClearAll{}, write)

  def current(%{requested: nil} = write),
    do: addressed(%M.MissionCount{count: tuple_size(write.items)}, write)

  def current(write), do: item(write, write.requested + write.ahead)

  @doc "The message that cancels writing (W6)."
  @spec cancel(t()) :: struct()
  def cancel(write), do: addressed(%M.MissionAck{type: @cancelled}, write)

  @doc "How many items the vehicle has requested."
  @spec done(t()) :: non_neg_integer()
  def done(%{requested: nil}), do: 0
  def done(write), do: write.requested

  @doc "Handles a message of the vehicle to the sender."
  @spec handle(t(), struct()) :: outcome()
  def handle(%{type: type, items: items} = write, %module{mission_type: type, seq: seq})
      when module in [M.MissionRequestInt, M.MissionRequest] and seq < tuple_size(items) do
    {write, item} = next(%{write | requested: seq, ahead: 0, repeated?: false}, seq)
    {:next, write, item}
  end

  def handle(%{type: type} = write, %M.MissionAck{mission_type: type, type: result} = ack) do
    case result do
      @accepted -> accepted(write, ack)
      @invalid_sequence -> ahead(write)
      _error when write.last_sent? -> {:doubt, result}
      _error -> {:refused, result}
    end
  end

  def handle(_write, _message), do: :ignore

  # Before the last item was sent, this is a late acknowledgement of something else.
  defp accepted(write, ack) do
    if write.items == {} or write.last_sent?,
      do: {:acked, if(ack.opaque_id == 0, do: nil, else: ack.opaque_id)},
      else: :ignore
  end

  # The repeated item arrived twice: ArduPilot has it, but its request for the next one was lost (W3). It would repeat the request after a
  # second. If the item was sent only once, this is a late answer about another item.
  defp ahead(%{requested: seq, repeated?: true, ahead: ahead, items: items} = write)
       when seq != nil and seq + ahead + 1 < tuple_size(items) do
    {write, item} = next(%{write | ahead: ahead + 1, repeated?: false, strict?: true}, seq + ahead + 1)
    {:next, write, item}
  end

  defp ahead(_write), do: :ignore

  defp next(write, seq), do: {%{write | last_sent?: write.last_sent? or last?(write, seq)}, item(write, seq)}
  defp last?(write, seq), do: seq == tuple_size(write.items) - 1
  defp item(write, seq), do: Item.message(elem(write.items, seq), seq, write.type, write.target)

  defp addressed(message, %{target: {system, component}, type: type}),
    do: %{message | target_system: system, target_component: component, mission_type: type}
end
