defmodule Protocols.Mission.Transfer.Read do
  @moduledoc """
  The part of a transfer that reads a plan: MISSION_REQUEST_LIST, then each item in order. Pure;
  `Protocols.Mission.Transfer.Retry` decides when to repeat.
  """

  alias Protocols.Mission.Item
  alias MavCodec.Enums.MavMissionResult
  alias MavCodec.Messages, as: M

  @accepted MavMissionResult.value(:MAV_MISSION_ACCEPTED)
  # Late answers to an upload, irrelevant to reading.
  @stale [
    MavMissionResult.value(:MAV_MISSION_INVALID_SEQUENCE),
    MavMissionResult.value(:MAV_MISSION_OPERATION_CANCELLED)
  ]
  # How often reading may begin again because the plan changed.
  @restarts 3

  defstruct [:type, :target, :limit, :count, :opaque_id, next: 0, items: [], restarts: 0]

  @type t :: %__MODULE__{
          type: 0..2,
          target: {0..255, 0..255},
          limit: pos_integer(),
          count: non_neg_integer() | nil,
          opaque_id: pos_integer() | nil,
          next: non_neg_integer(),
          items: [Item.t()],
          restarts: non_neg_integer()
        }

  @typedoc """
    * `:ignore` - the message is irrelevant
    * `{:next, read, message}` - progress; `message` requests the next item
    * `{:done, items, opaque_id, message}` - the plan is complete; `message` acknowledges it
    * `{:refused, result}` - MAV_MISSION_RESULT, or a sentence
  """
  @type outcome ::
          :ignore
          | {:next, t(), struct()}
          | {:done, [Item.t()], pos_integer() | nil, struct()}
          | {:refused, non_neg_integer() | String.t()}

  @doc "A read that has not begun; a plan of more than `limit` items is refused."
  @spec new(0..2, {0..255, 0..255}, pos_integer()) :: t()
  def new(type, target, limit), do: %__MODULE__{type: type, target: target, limit: limit}

  @doc "The request for what is missing next."
  @spec request(t()) :: struct()
  def request(%{count: nil} = read), do: addressed(%M.MissionRequestList{}, read)
  def request(read), do: addressed(%M.MissionRequestInt{seq: read.next}, read)

  @doc "The message that cancels reading (W6)."
  @spec stop(t()) :: struct()
  def stop(read), do: addressed(%M.MissionAck{type: Enum.at(@stale, 1)}, read)

  @doc """
  Begins again, because the vehicle does not answer any more: it may have ended the transfer. `:too_often` if that was done before;
  `:not_begun` before it was asked for an item.
  """
  @spec begin_again(t()) :: {:ok, t()} | :too_often | :not_begun
  def begin_again(%{count: nil}), do: :not_begun
  def begin_again(%{restarts: @restarts}), do: :too_often
  def begin_again(read), do: {:ok, fresh(read)}

  @doc "Handles a message of the vehicle to the reader."
  @spec handle(t(), struct()) :: outcome()
  def handle(%{type: type, count: nil} = read, %M.MissionCount{mission_type: type} = m), do: begin(read, m)

  def handle(%{type: type, count: count, opaque_id: id}, %M.MissionCount{
        mission_type: type,
        count: count,
        opaque_id: opaque
      })
      when id == nil or opaque == id,
      do: :ignore

  def handle(%{type: type} = read, %M.MissionCount{mission_type: type} = m),
    do: restart(read, &begin(&1, m))

  def handle(
        %{type: type, count: count, next: next} = read,
        %M.MissionItemInt{mission_type: type, seq: next} = m
      )
      when count != nil do
    read = %{read | next: next + 1, items: [Item.read(m) | read.items]}
    if read.next == count, do: done(read), else: {:next, read, request(read)}
  end

  # The plan's id has changed since the read began (W7).
  def handle(%{type: 0, opaque_id: id} = read, %M.MissionCurrent{mission_id: other})
      when id != nil and other not in [0, id],
      do: restart(read, &{:next, &1, request(&1)})

  def handle(%{type: type} = read, %M.MissionAck{mission_type: type, type: result})
      when result != @accepted and result not in @stale do
    if read.count == nil, do: {:refused, result}, else: restart(read, &{:next, &1, request(&1)})
  end

  def handle(_read, _message), do: :ignore

  defp begin(read, %{count: count}) when count > read.limit,
    do: {:refused, "the vehicle has #{count} items; at most #{read.limit} are read"}

  defp begin(read, m) do
    read = %{read | count: m.count, opaque_id: if(m.opaque_id == 0, do: nil, else: m.opaque_id)}
    if m.count == 0, do: done(read), else: {:next, read, request(read)}
  end

  defp done(read) do
    {:done, Enum.reverse(read.items), read.opaque_id, addressed(%M.MissionAck{type: @accepted}, read)}
  end

  defp restart(%{restarts: @restarts}, _fun),
    do: {:refused, "the plan changed again and again while it was read"}

  defp restart(read, fun), do: read |> fresh() |> fun.()

  defp fresh(read), do: %{read | count: nil, opaque_id: nil, next: 0, items: [], restarts: read.restarts + 1}

  defp addressed(message, %{target: {system, component}, type: type}),
    do: %{message | target_system: system, target_component: component, mission_type: type}
end
