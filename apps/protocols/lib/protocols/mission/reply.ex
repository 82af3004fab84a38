defmodule Protocols.Mission.Reply do
  @moduledoc """
  What a vehicle, or the gateway in its place, says to a station about its plans: MISSION_COUNT, MISSION_ACK and the
  requests for items.
  """

  alias MavCodec.Enums.MavMissionResult
  alias MavCodec.Messages, as: M

  @results Map.new(MavMissionResult.all(), fn {name, value} ->
             {name |> to_string() |> String.replace_prefix("MAV_MISSION_", "") |> String.to_atom(), value}
           end)

  @typedoc "A station's system and component."
  @type station :: {0..255, 0..255}

  @doc "The value of a MAV_MISSION_RESULT by its name without the prefix: `:DENIED`."
  @spec result(atom()) :: 0..255
  def result(name), do: Map.fetch!(@results, name)

  @doc "How many items a plan has; `id` is the vehicle's id for it (W7), 0 for none."
  @spec count(0..2, non_neg_integer(), station(), id :: non_neg_integer()) :: struct()
  def count(type, count, to, id \\ 0),
    do: addressed(%M.MissionCount{count: count, mission_type: type, opaque_id: id}, to)

  @doc "What came of a station's message: a MAV_MISSION_RESULT, or its name."
  @spec ack(0..255, 0..255 | atom(), station(), id :: non_neg_integer()) :: struct()
  def ack(type, result, to, id \\ 0)
  def ack(type, name, to, id) when is_atom(name), do: ack(type, result(name), to, id)

  def ack(type, result, to, id),
    do: addressed(%M.MissionAck{type: result, mission_type: type, opaque_id: id}, to)

  @doc "The request for an item: MISSION_REQUEST_INT (W5), or ArduPilot's MISSION_REQUEST."
  @spec request(module(), 0..2, non_neg_integer(), station()) :: struct()
  def request(module, type, seq, to), do: addressed(struct!(module, seq: seq, mission_type: type), to)

  defp addressed(message, {system, component}),
    do: %{message | target_system: system, target_component: component}
end
