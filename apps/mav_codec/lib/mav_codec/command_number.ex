defmodule MavCodec.CommandNumber do
  @moduledoc "The MAV_CMD of a COMMAND_LONG or COMMAND_INT, read straight from the payload."

  alias MavCodec.MessageName
  alias MavCodec.Frame

  @carriers Enum.map(~w(COMMAND_INT COMMAND_LONG), &MessageName.id!/1)
  @offset 28

  @doc "The command's number; nil of any other frame."
  @spec of(Frame.t()) :: 0..65_535 | nil
  def of(%Frame{id: id, payload: payload}) when id in @carriers do
    # Zeros at the end were cut off (F7).
    <<_parameters::binary-size(@offset), command::16-little, _::binary>> = <<payload::binary, 0::240>>
    command
  end

  def of(%Frame{}), do: nil
end
