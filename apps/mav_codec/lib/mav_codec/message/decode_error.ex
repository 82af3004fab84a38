defmodule MavCodec.Message.DecodeError do
  @moduledoc """
  A frame whose message is not in the dialect. This is the only decoding error: every payload of a known message can be decoded
  (F7, F9).
  """

  defexception [:id, :dialect]

  @type t :: %__MODULE__{id: non_neg_integer(), dialect: module()}

  @impl Exception
  def message(%__MODULE__{id: id, dialect: dialect}), do: "message #{id} is not in #{inspect(dialect)}"
end
