defmodule Aerie.Base.Secret do
  @moduledoc """
  A value that never shows in a log, a crash report or an inspected state.

  It is kept in a function, so that Erlang's own formatting (`~p` in a crash report) does not show it either.
  """

  @enforce_keys [:fun]
  defstruct [:fun]

  @opaque t :: %__MODULE__{fun: (-> String.t())}

  @doc "Hides `value`."
  @spec new(String.t()) :: t()
  def new(value) when is_binary(value), do: %__MODULE__{fun: fn -> value end}

  @doc "The hidden value; nil for nil. Called where the value is handed over, never earlier."
  @spec reveal(t() | nil) :: String.t() | nil
  def reveal(nil), do: nil
  def reveal(%__MODULE__{fun: fun}), do: fun.()

  @doc "What a value hides, if it is a secret: for those who take secrets out of a text."
  @spec hidden(term()) :: {:ok, String.t()} | :error
  def hidden(%__MODULE__{fun: fun}), do: {:ok, fun.()}
  def hidden(_other), do: :error

  defimpl Inspect do
    def inspect(_secret, _opts), do: "#Aerie.Base.Secret<hidden>"
  end
end
