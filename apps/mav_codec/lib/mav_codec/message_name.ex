defmodule MavCodec.MessageName do
  @moduledoc "Ids of messages by their names, for module attributes and function heads."

  @doc "The id of a message. A name that is not in the definitions raises, which stops the compilation."
  @spec id!(String.t()) :: non_neg_integer
  def id!(name) do
    case MavCodec.Dialects.All.message_id(name) do
      nil -> raise ArgumentError, "no message #{name} in the definitions"
      id -> id
    end
  end
end
