defmodule Aerie.Vehicle.Command.Error do
  @moduledoc "What is wrong with a command that came from outside: which key, what was expected, what was given."

  alias Aerie.Base.Json

  @enforce_keys [:key, :expected, :got]
  defexception [:key, :expected, :got]

  @typedoc "`:got` is a short text, or nil where the expectation says it all."
  @type t :: %__MODULE__{key: String.t(), expected: String.t(), got: String.t() | nil}

  @max_shown 60

  @doc "An error; `:missing`, `:unknown` and `:rule` say what the matter is in place of a value."
  @spec new(String.t(), String.t(), term()) :: t()
  def new(key, expected, got), do: %__MODULE__{key: key, expected: expected, got: got(got)}

  defp got(:missing), do: "nothing"
  defp got(:unknown), do: nil
  defp got(:rule), do: nil

  defp got(value), do: Json.shown(value, @max_shown)

  @doc "A key from outside, short enough to be shown."
  @spec key(term()) :: String.t()
  def key(key) when is_binary(key),
    do: if(String.printable?(key), do: String.slice(key, 0, @max_shown), else: Json.shown(key, @max_shown))

  def key(key), do: Json.shown(key, @max_shown)

  @impl Exception
  def message(%{got: nil} = error), do: "#{error.key}: expected #{error.expected}"
  def message(error), do: "#{error.key}: expected #{error.expected}, got #{error.got}"

  # So that `Enum.join/2` makes one text of several.
  defimpl String.Chars do
    defdelegate to_string(error), to: Aerie.Vehicle.Command.Error, as: :message
  end
end
