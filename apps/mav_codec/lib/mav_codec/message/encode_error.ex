defmodule MavCodec.Message.EncodeError do
  @moduledoc """
  A message that cannot be encoded: `message` is its module, `field` the struct key (`nil` for the whole
  message), `got` the value, `expected` what would be right.
  """

  defexception [:message, :field, :got, :expected]

  @type t :: %__MODULE__{message: module() | nil, field: atom() | nil, got: term(), expected: String.t()}

  @impl Exception
  def message(%__MODULE__{message: message, field: nil} = error),
    do: "cannot encode #{inspect(message)}: expected #{error.expected}, got: #{format(error.got)}"

  def message(%__MODULE__{message: message, field: field} = error),
    do:
      "cannot encode #{inspect(message)}: expected #{field} to be #{error.expected}, got: #{format(error.got)}"

  defp format(term), do: inspect(term, limit: 20, printable_limit: 80)
end
