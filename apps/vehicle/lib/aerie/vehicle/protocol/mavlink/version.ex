defmodule Aerie.Vehicle.Protocol.Mavlink.Version do
  @moduledoc """
  Messages that the version of MAVLink which a vehicle speaks does not have. MAVLink 1 has no ids above 255 and no
  extension fields (F2, F9), and a message about a fence that lost its `mission_type` is one about the mission (W4).
  """

  alias Aerie.Vehicle.Command.Refusal
  alias MavCodec.Message

  @plans %{1 => "fence", 2 => "rally points"}

  @doc "Why these messages may not be sent in a version: what it lacks for the first one that it cannot say, or nil."
  @spec refusal([struct()], 1 | 2) :: String.t() | nil
  def refusal(messages, version) do
    Enum.find_value(messages, fn message ->
      lost = Message.unsayable(message, version)

      if lost, do: Refusal.text(:mavlink_1, lacking: lost(message, lost))
    end)
  end

  defp lost(%{mission_type: type}, :mission_type), do: Map.get(@plans, type, "plan of type #{type}")

  defp lost(%module{}, lost) do
    case {module.name(), lost} do
      {"PARAM_EXT_" <> _kind, :id} -> "parameters of cameras, gimbals and other components"
      {name, :id} -> "message #{name}"
      {name, field} -> "field #{field} of the message #{name}"
    end
  end
end
