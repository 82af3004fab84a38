defmodule Aerie.Policy.Rule do
  @moduledoc "One rule of the policy: a pure check of what a command asks for against what is known of its vehicle."

  alias Aerie.Policy
  alias Aerie.Policy.{Context, Facts}

  @doc "`{:deny, sentence}`, with the numbers in it. What is not known and needed denies, and the sentence says what it is."
  @callback check(Policy.t(), Facts.t(), Context.t()) :: :ok | {:deny, String.t()}
end
