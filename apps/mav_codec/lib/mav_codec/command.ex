defmodule MavCodec.Command do
  @moduledoc """
  Numbers of commands: by their names in MAV_CMD, as constants for patterns, guards, maps and attributes, and of frames.

      import MavCodec.Command

      def run(cmd(:NAV_TAKEOFF)), do: :take_off
      def run(id) when id in cmds(~w(NAV_LAND NAV_RETURN_TO_LAUNCH)a), do: :land
  """

  alias MavCodec.Enums.MavCmd
  alias MavCodec.{Frame, MessageId}

  @names Map.new(MavCmd.all(), fn {name, id} ->
           {String.replace_prefix(Atom.to_string(name), "MAV_CMD_", ""), id}
         end)

  @carriers Enum.map(~w(COMMAND_INT COMMAND_LONG), &MessageId.of!/1)
  @offset 28

  @doc "The number of the command `MAV_CMD_NAME`; an unknown name does not compile."
  defmacro cmd(name), do: number(name)

  @doc "The numbers of several commands."
  defmacro cmds(names), do: names |> Macro.expand(__CALLER__) |> Enum.map(&number/1)

  defp number(name), do: Map.fetch!(@names, Atom.to_string(name))

  @doc "The command's number in a COMMAND_LONG or COMMAND_INT, read straight from the payload; nil of any other frame."
  @spec of(Frame.t()) :: 0..65_535 | nil
  def of(%Frame{id: id, payload: payload}) when id in @carriers do
    # Zeros at the end were cut off (F7).
    <<_parameters::binary-size(@offset), command::16-little, _::binary>> = <<payload::binary, 0::240>>
    command
  end

  def of(%Frame{}), do: nil
end
