defmodule MavCodec.CommandId do
  @moduledoc """
  Numbers of commands by their names in MAV_CMD, as constants: for patterns, guards, maps and attributes.

      import MavCodec.CommandId

      def run(cmd(:NAV_TAKEOFF)), do: :take_off
      def run(id) when id in cmds(~w(NAV_LAND NAV_RETURN_TO_LAUNCH)a), do: :land
  """

  alias MavCodec.Enums.MavCmd

  @names Map.new(MavCmd.all(), fn {name, id} ->
           {String.replace_prefix(Atom.to_string(name), "MAV_CMD_", ""), id}
         end)

  @doc "The number of the command `MAV_CMD_NAME`; an unknown name does not compile."
  defmacro cmd(name), do: number(name)

  @doc "The numbers of several commands."
  defmacro cmds(names), do: names |> Macro.expand(__CALLER__) |> Enum.map(&number/1)

  defp number(name), do: Map.fetch!(@names, Atom.to_string(name))
end
