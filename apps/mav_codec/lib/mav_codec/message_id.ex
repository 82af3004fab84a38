defmodule MavCodec.MessageId do
  @moduledoc """
  Message ids by the name of the message, as constants: for patterns, guards, maps and attributes.

      import MavCodec.MessageId

      def handle(id(Heartbeat)), do: :alive
      def handle(id) when id in [id(Attitude), id(AttitudeQuaternion)], do: :attitude
  """

  @doc "The id of the message `MavCodec.Messages.NAME`."
  defmacro id({:__aliases__, _meta, name}), do: Module.concat([MavCodec.Messages | name]).id()
end
