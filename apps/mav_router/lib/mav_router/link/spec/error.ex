defmodule MavRouter.Link.Spec.Error do
  @moduledoc """
  Why a connection string was refused: what was given, what is wrong with it, what was expected, and one that works.

      cannot use "udpin:14550" as a link: a port is missing; expected udpin:HOST:PORT, for example udpin:0.0.0.0:14550
  """

  defexception [:input, :reason, :expected, :example, :hint]

  @type t :: %__MODULE__{
          input: term,
          reason: String.t(),
          expected: String.t(),
          example: String.t(),
          hint: String.t() | nil
        }

  @impl Exception
  def message(%__MODULE__{} = error) do
    hint = if error.hint, do: "; #{error.hint}", else: ""

    "cannot use #{inspect(error.input)} as a link: #{error.reason}; " <>
      "expected #{error.expected}, for example #{error.example}#{hint}"
  end
end
