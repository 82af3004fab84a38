defmodule MavCodec.MessageId do
  @moduledoc """
  Ids of messages by their names, as constants: for patterns, guards, maps and attributes.

      import MavCodec.MessageId

      def handle(id(Heartbeat)), do: :alive
      def handle(id) when id in [id(Attitude), id(AttitudeQuaternion)], do: :attitude
  """

  @doc "The id of the message `MavCodec.Messages.NAME`."
  defmacro id({:__aliases__, _meta, name}), do: Module.concat([MavCodec.Messages | name]).id()

  @doc """
  The id of a message by its name in the definitions, such as `"HEARTBEAT"`, for attributes and function heads. A name
  that is not in the definitions raises, which stops the compilation.
  """
  @spec of!(String.t()) :: non_neg_integer
  def of!(name) do
    case MavCodec.Dialects.All.message_id(name) do
      nil -> raise ArgumentError, "no message #{name} in the definitions"
      id -> id
    end
  end
end
