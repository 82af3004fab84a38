defmodule Aerie.Authority.Commands do
  @moduledoc false
  alias MavCodec.Enums.MavCmd

  @questions Enum.map(
               ~w(GET_HOME_POSITION GET_MESSAGE_INTERVAL REQUEST_MESSAGE REQUEST_PROTOCOL_VERSION
               REQUEST_AUTOPILOT_CAPABILITIES REQUEST_CAMERA_INFORMATION REQUEST_CAMERA_SETTINGS
               REQUEST_STORAGE_INFORMATION REQUEST_CAMERA_CAPTURE_STATUS REQUEST_FLIGHT_INFORMATION)a,
               &(MavCmd.value(:"MAV_CMD_#{&1}") || raise("no command #{&1}"))
             )
  @spec question?(non_neg_integer()) :: boolean()
  def question?(command), do: command in @questions
end
