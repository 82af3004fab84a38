defmodule Aerie.Control.Policy.Mavlink.Wording do
  @moduledoc """
  What a refusal calls a raw MAVLink message, as its sender knows it: a command by its name, an item of a mission by its
  number and its command. Parameters and files have their names from `Aerie.Control.Policy.Intent`.
  """

  alias MavCodec.Dialects.All
  alias MavCodec.Enums.{MavCmd, MavMissionType}
  alias MavCodec.Messages, as: M

  @items [M.MissionItem, M.MissionItemInt]
  @commands [M.CommandLong, M.CommandInt]
  @aux_function MavCmd.value(:MAV_CMD_DO_AUX_FUNCTION)
  @fence MavMissionType.value(:MAV_MISSION_TYPE_FENCE)
  @rally MavMissionType.value(:MAV_MISSION_TYPE_RALLY)
  @all MavMissionType.value(:MAV_MISSION_TYPE_ALL)

  @doc "The words for a message; nil is one that cannot be read."
  @spec of(struct() | nil) :: String.t()
  def of(nil), do: "a message that cannot be read"
  def of(%M.CommandCancel{command: number}), do: "cancelling #{command(number)}"
  def of(%module{mission_type: @fence, seq: n}) when module in @items, do: "fence item #{n}"
  def of(%module{mission_type: @rally, seq: n}) when module in @items, do: "rally point #{n}"
  def of(%module{seq: n, command: number}) when module in @items, do: "mission item #{n} (#{command(number)})"
  def of(%M.FencePoint{idx: n}), do: "fence point #{n}"
  def of(%M.RallyPoint{idx: n}), do: "rally point #{n}"
  def of(%M.MissionCount{count: 0, mission_type: type}), do: "removing #{stored(type)}"
  def of(%M.MissionClearAll{mission_type: type}), do: "removing #{stored(type)}"
  def of(%M.MissionCount{mission_type: type}), do: "an upload of #{stored(type)}"
  def of(%M.MissionWritePartialList{mission_type: type}), do: "an upload of a part of #{stored(type)}"
  def of(%M.LogErase{}), do: "erasing the logs"

  def of(%module{command: @aux_function, param1: function}) when module in @commands and is_float(function),
    do: "#{command(@aux_function)} #{trunc(function)}"

  def of(%module{command: number}) when module in @commands, do: command(number)
  def of(%module{}), do: message(All.name(module.id()), module.id())

  defp message(nil, id), do: "message #{id}"
  defp message(name, _id), do: name

  @doc "A command by its name, without MAV_CMD."
  @spec command(non_neg_integer()) :: String.t()
  def command(number) do
    case MavCmd.name(number) do
      nil -> "command #{number}"
      name -> name |> Atom.to_string() |> String.replace_prefix("MAV_CMD_", "")
    end
  end

  defp stored(@fence), do: "the fence"
  defp stored(@rally), do: "the rally points"
  defp stored(@all), do: "mission, fence and rally points"
  defp stored(_mission), do: "the mission"
end
