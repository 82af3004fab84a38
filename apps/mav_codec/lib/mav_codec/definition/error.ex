defmodule MavCodec.Definition.Error do
  @moduledoc """
  A MAVLink definition that cannot be used: the file, the line (`nil` when the whole file is meant) and the reason.
  """

  defexception [:file, :line, :reason]

  @type t :: %__MODULE__{file: String.t(), line: pos_integer() | nil, reason: String.t()}

  @impl Exception
  def message(%__MODULE__{file: file, line: nil, reason: reason}), do: "#{file}: #{reason}"
  def message(%__MODULE__{file: file, line: line, reason: reason}), do: "#{file}:#{line}: #{reason}"
end
